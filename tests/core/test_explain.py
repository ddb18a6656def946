"""Which story about the expected mask the evidence supports; the truth is how the evidence was drawn."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from octoprint_moop.core.segmentation.appearance import ColourModel, count_colours, evidence, opponent
from octoprint_moop.core.segmentation.explain import explain
from octoprint_moop.core.segmentation.weigh import Look, weigh


def block(top: int = 60, left: int = 100, bottom: int = 160, right: int = 180) -> np.ndarray:
    mask = np.zeros((200, 300), np.uint8)
    mask[top:bottom, left:right] = 255
    return mask


PLAIN = np.full((200, 300, 3), 128, np.uint8)  # a picture without any border


def seen(mask: np.ndarray, strength: float = 0.4, noise: float = 1.5) -> np.ndarray:
    """Evidence far too weak to be believed pixel by pixel."""
    evidence = np.where(mask > 0, strength, -strength)
    return (evidence + np.random.default_rng(2).normal(0, noise, mask.shape)).astype(np.float32)


def test_what_is_as_expected_is_left_as_it_is():
    story = explain(seen(block()), block(), PLAIN)
    assert story.moved_px == (0, 0) and story.missing_px == 0 and np.array_equal(story.mask, block())


def test_where_all_of_it_is_plainly_seen_an_edge_nearby_tells_no_other_story():
    picture = PLAIN.copy()
    cv2.rectangle(picture, (116, 60), (196, 160), (255, 255, 255), 2)  # a border just where the block might have gone
    wide = seen(block(right=200), strength=3.5, noise=0.3)  # and beside it something of its colour
    story = explain(wide, block(), picture)
    assert story.moved_px == (0, 0) and story.missing_px == 0 and story.support > 2.5


@pytest.mark.parametrize("x_px", [-16, 16, 24])
def test_a_part_that_moved_is_found_by_all_its_weak_pixels_together(x_px):
    story = explain(seen(block(left=100 + x_px, right=180 + x_px)), block(), PLAIN)
    assert abs(story.moved_px[0] - x_px) <= 2 and abs(story.moved_px[1]) <= 3


def test_a_calibration_that_is_two_pixels_off_is_not_a_story():
    story = explain(seen(block(left=102, right=182)), block(), PLAIN)
    assert story.moved_px == (0, 0)


@pytest.mark.parametrize("missing_px", [15, 30, 50])
def test_a_missing_top_is_cut_off_the_expectation(missing_px):
    story = explain(seen(block(top=60 + missing_px)), block(), PLAIN)
    assert abs(story.missing_px - missing_px) <= 4 and not story.mask[60 : 60 + missing_px - 5].any()


def test_a_black_print_that_ends_before_a_black_head_is_cut_at_the_edge_that_catches_the_light():
    rng = np.random.default_rng(4)
    picture = rng.integers(20, 28, (200, 300, 3), dtype=np.uint8)  # the head is as dark as the print, and above it
    picture[90:, :100], picture[90:, 180:], picture[160:] = 150, 150, 150
    picture[88:90, 100:180] += 14
    blind = np.where(np.arange(200)[:, None] < 90, 0.1, 0.5) * np.ones((1, 300))
    blind[90:, :100], blind[90:, 180:], blind[160:] = -1, -1, -1
    story = explain(blind.astype(np.float32), block(), opponent(picture))
    assert abs(story.missing_px - 30) <= 3 and story.moved_px == (0, 0)


def test_borders_within_the_print_are_no_story():
    rng = np.random.default_rng(4)
    picture = np.full((200, 300, 3), 60, np.uint8)
    picture[block() > 0] = 130
    picture[95:98, 100:180] = 200  # a seam, a change of layer height
    picture = np.clip(picture + rng.normal(0, 3, picture.shape), 0, 255).astype(np.uint8)
    story = explain(seen(block()), block(), opponent(picture))
    assert story.missing_px == 0 and story.moved_px == (0, 0)


def test_nothing_there_is_told_by_the_support():
    assert explain(seen(np.zeros((200, 300), np.uint8)), block(), PLAIN).support < -0.2


def test_an_empty_expectation_is_an_empty_story():
    story = explain(seen(block()), np.zeros((200, 300), np.uint8), PLAIN)
    assert not story.mask.any() and story.support == 0


def test_a_strand_one_pixel_wide_is_seen_where_its_colour_is_decisive():
    frame = np.full((100, 120, 3), (60, 58, 62), np.uint8)
    truth = np.zeros((100, 120), np.uint8)
    cv2.line(truth, (10, 20), (110, 70), 255, 1)
    truth[75:95, 20:60] = 255
    frame[truth > 0] = (40, 120, 235)
    colours = opponent(frame)
    model = ColourModel(count_colours(colours, truth > 0), count_colours(colours, truth == 0))
    observed = weigh(frame, model, Look.without_label(None, truth.shape, model))
    assert np.count_nonzero((observed.mask > 0) != (truth > 0)) < 0.05 * np.count_nonzero(truth)


def test_colours_never_seen_are_evidence_of_nothing():
    rng = np.random.default_rng(5)
    known = rng.integers(40, 60, (40, 40, 3), dtype=np.uint8)
    half = np.zeros((40, 40), bool)
    half[:20] = True
    model = ColourModel(count_colours(opponent(known), half), count_colours(opponent(known), ~half))
    strange = np.full((10, 10, 3), (250, 20, 20), np.uint8)
    assert np.abs(evidence(opponent(strange), model)).max() < 0.1
