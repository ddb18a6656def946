from __future__ import annotations

import cv2
import numpy as np
import pytest

from octoprint_moop.core.view.light import Light


@pytest.fixture
def scene() -> np.ndarray:
    """A grey bench with coloured patches, and an orange print in the middle of it."""
    rng = np.random.default_rng(3)
    patches = rng.integers(60, 180, (12, 16, 3)).astype(np.uint8)
    picture = cv2.resize(patches, (320, 240), interpolation=cv2.INTER_NEAREST)
    picture[90:160, 130:200] = (20, 120, 230)
    return picture


@pytest.fixture
def print_mask() -> np.ndarray:
    mask = np.zeros((240, 320), np.uint8)
    mask[90:160, 130:200] = 255
    return mask


def error(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.abs(a.astype(int) - b.astype(int)).mean())


def test_a_dimmed_lamp_and_a_drift_of_white_balance_are_taken_out(scene, print_mask):
    dimmed = (scene * np.array([0.5, 0.6, 0.7])).astype(np.uint8)
    change = Light(scene, print_mask).change(dimmed)
    levelled = change.undone(dimmed)
    assert error(levelled, scene) < 3 < error(dimmed, scene)
    assert change.brightness_ratio == pytest.approx(0.6, abs=0.02)


def test_light_that_falls_off_to_one_side_is_taken_out_where_the_print_is_too(scene, print_mask):
    slope = np.linspace(1.1, 0.6, 320)[None, :, None]
    uneven = np.clip(scene * slope, 0, 255).astype(np.uint8)
    change = Light(scene, print_mask).change(uneven)
    levelled = change.undone(uneven)
    inside = print_mask > 0
    assert change.field is not None
    assert error(levelled[inside], scene[inside]) < 0.35 * error(uneven[inside], scene[inside])


def test_a_frame_in_the_same_light_is_handed_back_untouched(scene, print_mask):
    noisy = np.clip(scene + np.random.default_rng(1).normal(0, 2, scene.shape), 0, 255).astype(np.uint8)
    assert Light(scene, print_mask).change(noisy).undone(noisy) is noisy


def test_a_print_that_grows_bright_does_not_darken_the_picture(scene, print_mask):
    grown = scene.copy()
    grown[90:160, 130:200] = (250, 250, 250)
    change = Light(scene, print_mask).change(grown)
    levelled = change.undone(grown)
    assert change.brightness_ratio == pytest.approx(1.0, abs=0.01)
    assert error(levelled[print_mask == 0], scene[print_mask == 0]) < 1


def test_a_frame_without_background_is_left_as_it_is(scene):
    everywhere = np.full((240, 320), 255, np.uint8)
    dimmed = scene // 2
    assert Light(scene, everywhere).change(dimmed).undone(dimmed) is dimmed


def test_a_part_of_the_picture_is_levelled_as_the_whole_is(scene, print_mask):
    uneven = np.clip(scene * np.linspace(1.1, 0.6, 320)[None, :, None], 0, 255).astype(np.uint8)
    change = Light(scene, print_mask).change(uneven)
    part = change.undone(uneven[60:180, 80:240], (80 / 320, 60 / 240, 240 / 320, 180 / 240))
    assert np.abs(part.astype(int) - change.undone(uneven)[60:180, 80:240]).max() <= 2


def test_a_hand_no_brighter_than_the_bench_is_not_taken_for_light_upon_it(scene, print_mask):
    """Half of its difference from the bench would be gone if what is pink were light."""
    frame = scene.copy()
    frame[170:, 200:] = (90, 115, 165)
    levelled = Light(scene, print_mask).change(frame).undone(frame)
    assert error(levelled[180:, 210:], frame[180:, 210:]) < 0.2 * error(scene[180:, 210:], frame[180:, 210:])
