"""Lines painted over a bed by a known share: is the share found?"""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from octoprint_moop.core.decision.coverage import coverage

HEIGHT, WIDTH, TOP = 80, 120, 30
ORANGE, GREY = np.array([30, 120, 230], float), np.array([70, 75, 80], float)
LYING = np.zeros((HEIGHT, WIDTH), bool)
LYING[TOP:, 20:100] = True
NEW = np.zeros_like(LYING)
NEW[TOP - 2 : TOP, 20:100] = True


def painted(
    share: float, filament: np.ndarray = ORANGE, light: float = 1.0, noise: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """(3, h, w) uint8: a block of filament on a bed with a grain, whose newest lines cover that share of their pixels, and
    the bare bed."""
    rng = np.random.default_rng(3)
    bed = GREY + rng.normal(0, 4, (HEIGHT, WIDTH, 1))
    amount = np.where(LYING, 1.0, np.where(NEW, share, 0.0))[..., None]
    seen = amount * filament + (1 - amount) * bed + rng.normal(0, noise, bed.shape)
    return tuple(
        np.clip(np.round(picture), 0, 255).astype(np.uint8).transpose(2, 0, 1).copy() for picture in (seen, bed)
    )


@pytest.mark.parametrize("share", [0.0, 0.25, 0.5, 1.0])
def test_the_share_of_a_line_that_is_covered_is_found(share):
    tells, found = coverage(*painted(share, noise=3.0), LYING, NEW)
    assert np.array_equal(tells, NEW)
    assert found.mean() == pytest.approx(share, abs=0.04)


def test_filament_like_the_bed_tells_nothing():
    look, bare = painted(0.5, filament=GREY + 2)
    tells, found = coverage(look, bare, LYING, NEW)
    assert not tells.any() and not len(found)


def test_where_no_filament_lies_near_nothing_tells_how_it_looks():
    look, bare = painted(1.0)
    far = LYING & (np.arange(HEIGHT) > TOP + 15)[:, None]
    assert not coverage(look, bare, far, NEW)[0].any()
    assert not coverage(look, bare, np.zeros_like(LYING), NEW)[0].any()


def test_no_line_is_no_error():
    look, bare = painted(1.0)
    tells, found = coverage(look, bare, LYING, np.zeros_like(NEW))
    assert not tells.any() and not len(found)


def test_blur_that_carries_the_colour_a_pixel_far_covers_less_than_half():
    """As a camera blurs a block whose last two lines never came: a mask sees the first of them as filament."""
    look, bare = painted(0.0)
    soft = np.stack([cv2.GaussianBlur(plane, (0, 0), 0.9) for plane in look])
    assert coverage(soft, bare, LYING, NEW)[1].mean() < 0.3
    full, _ = painted(1.0)
    soft = np.stack([cv2.GaussianBlur(plane, (0, 0), 0.9) for plane in full])
    assert coverage(soft, bare, LYING, NEW)[1].mean() > 0.6
