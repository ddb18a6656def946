"""The segmenter that learns while it watches: drawn prints that grow, fail, and have the bed's own colour."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from octoprint_moop.core.expected.views import Expected
from octoprint_moop.core.segmentation.adaptive import AdaptiveSegmenter
from octoprint_moop.core.segmentation.segment import HsvThresholds

ORANGE, GREY = (40, 120, 235), (60, 58, 62)
LAYERS, LAYER_PX, BED_ROW = 20, 4, 110


def birth_map() -> np.ndarray:
    """A block 50 px wide; each bead is a layer 4 px high, from the bed upwards."""
    birth = np.zeros((120, 160), np.uint32)
    for layer in range(LAYERS):
        birth[BED_ROW - LAYER_PX * (layer + 1) : BED_ROW - LAYER_PX * layer, 60:110] = layer + 1
    return birth


BIRTH = birth_map()


def expected(layers: int) -> Expected:
    return Expected(BIRTH, layers)


def bed(colour=GREY, seed: int = 0) -> np.ndarray:
    frame = np.full((120, 160, 3), colour, np.float64)
    frame[:30] = (120, 125, 130)
    frame += np.random.default_rng(seed).normal(0, 4, frame.shape)
    return np.clip(frame, 0, 255).astype(np.uint8)


def printed(mask: np.ndarray, colour=ORANGE, seed: int = 1, on=GREY) -> np.ndarray:
    frame = bed(on, seed).astype(np.float64)
    rng = np.random.default_rng(seed + 1000)
    frame[mask > 0] = np.array(colour) * rng.normal(1, 0.05, (int((mask > 0).sum()), 1))
    return np.clip(frame + rng.normal(0, 4, frame.shape), 0, 255).astype(np.uint8)


def iou(a: np.ndarray, b: np.ndarray) -> float:
    union = np.count_nonzero((a > 0) | (b > 0))
    return np.count_nonzero((a > 0) & (b > 0)) / union if union else 1.0


def watched(segmenter: AdaptiveSegmenter, layers: int, colour=ORANGE, on=GREY) -> AdaptiveSegmenter:
    """The segmenter after `layers` good layers."""
    for layer in range(1, layers + 1):
        frame = printed(expected(layer).mask, colour, layer, on)
        segmenter.learn(frame, expected(layer), segmenter.observe(frame, expected(layer)))
    return segmenter


def test_without_thresholds_the_reference_and_the_first_layers_teach_the_colour():
    segmenter = watched(AdaptiveSegmenter(None, bed()), 5)
    for layer in (6, 12, 20):
        truth = expected(layer).mask
        assert iou(segmenter.observe(printed(truth, seed=50 + layer), expected(layer)).mask, truth) > 0.95


def test_wrong_thresholds_are_outgrown():
    """Picked for green; the print is orange."""
    segmenter = watched(AdaptiveSegmenter(HsvThresholds(100, 140, 0.5, 0.3), bed()), 6)
    truth = expected(10).mask
    assert iou(segmenter.observe(printed(truth, seed=70), expected(10)).mask, truth) > 0.95


@pytest.mark.parametrize("material", [None, HsvThresholds(15, 45, 0.5, 0.3)])
@pytest.mark.parametrize("reference", [bed(), None])
def test_a_print_that_stops_at_layer_three_is_not_seen_beyond_it(material, reference):
    """Even if each empty layer is taken for good and learned from."""
    segmenter = watched(AdaptiveSegmenter(material, reference), 3)
    truth = expected(3).mask
    for layer in range(4, 13):
        frame = printed(truth, seed=layer)
        seen = segmenter.observe(frame, expected(layer))
        segmenter.learn(frame, expected(layer), seen)
    air = (expected(12).mask > 0) & (truth == 0)
    assert (seen.mask[air] > 0).mean() < 0.1


def test_nothing_printed_at_all_is_never_learned_as_filament():
    segmenter = AdaptiveSegmenter(None, bed())
    for layer in range(1, 8):
        seen = segmenter.observe(bed(seed=layer), expected(layer))
        segmenter.learn(bed(seed=layer), expected(layer), seen)
    assert (seen.mask > 0).sum() < 0.1 * (expected(7).mask > 0).sum()


def test_matter_of_the_filaments_colour_in_the_wrong_place_is_seen():
    segmenter = watched(AdaptiveSegmenter(None, bed()), 8)
    blob = np.zeros((120, 160), np.uint8)
    blob[80:105, 120:150] = 255
    seen = segmenter.observe(printed(cv2.bitwise_or(expected(8).mask, blob), seed=33), expected(8))
    assert (seen.mask[82:103, 122:148] > 0).mean() > 0.95


def test_a_part_that_slid_away_is_seen_where_it_is_and_not_where_it_was():
    segmenter = watched(AdaptiveSegmenter(None, bed()), 10)
    truth = np.roll(expected(10).mask, 12, axis=1)
    assert iou(segmenter.observe(printed(truth, seed=5), expected(11)).mask, truth) > 0.85


def test_a_thing_of_the_filaments_colour_that_was_there_before_the_print_is_not_the_print():
    """A small orange clip on the bed, in the picture of the empty bed already."""

    def with_clip(frame: np.ndarray) -> np.ndarray:
        frame[85:105, 125:145] = np.clip(np.array(ORANGE) + np.random.default_rng(3).normal(0, 4, (20, 20, 3)), 0, 255)
        return frame

    segmenter = AdaptiveSegmenter(HsvThresholds(15, 45, 0.5, 0.3), with_clip(bed()))
    for layer in range(1, 9):
        frame = with_clip(printed(expected(layer).mask, seed=layer))
        seen = segmenter.observe(frame, expected(layer))
        segmenter.learn(frame, expected(layer), seen)
    assert segmenter.separability > 0.8
    assert iou(seen.mask, expected(8).mask) > 0.95


def test_a_print_of_the_beds_own_colour_leaves_the_segmenter_unsure_and_it_says_why():
    segmenter = watched(AdaptiveSegmenter(None), 8, colour=GREY)
    seen = segmenter.observe(printed(expected(8).mask, GREY, 9), expected(8))
    assert (seen.unsure[expected(8).mask > 0] > 0).mean() > 0.3
    assert segmenter.separability < 0.6


def test_where_the_bed_cannot_be_told_from_filament_its_absence_is_not_claimed():
    """Filament of the bed's own shade on it: whether it lies there cannot be seen, and must not be called missing."""
    dark, bedlike = (52, 52, 54), (60, 58, 62)
    segmenter = watched(AdaptiveSegmenter(None, bed(bedlike)), 6, dark, bedlike)
    seen = segmenter.observe(printed(expected(8).mask, dark, 8, bedlike), expected(8))
    wanted = expected(8).mask > 0
    missed = wanted & (seen.mask == 0) & (seen.unsure == 0)
    assert missed.sum() < 0.1 * wanted.sum() and (seen.unsure > 0)[wanted].mean() > 0.4


def test_doubt_about_the_bed_ends_when_matter_is_clearly_seen():
    dark, bedlike = (52, 52, 54), (60, 58, 62)
    segmenter = watched(AdaptiveSegmenter(None, bed(bedlike)), 4, dark, bedlike)
    for layer in (6, 7):
        seen = segmenter.observe(printed(expected(layer).mask, ORANGE, layer, bedlike), expected(layer))
    assert (seen.unsure > 0)[expected(7).mask > 0].mean() < 0.3


def test_matter_of_another_colour_that_is_gone_is_missed_and_not_doubted():
    segmenter = watched(AdaptiveSegmenter(None, bed()), 8)
    seen = segmenter.observe(bed(seed=5), expected(9))
    wanted = expected(9).mask > 0
    assert (wanted & (seen.mask == 0) & (seen.unsure == 0)).sum() > 0.9 * wanted.sum()


def test_a_camera_without_colour_is_served_by_brightness_alone():
    grey = [cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY) for frame in (bed(),)]
    segmenter = AdaptiveSegmenter(HsvThresholds(15, 45, 0.5, 0.3), cv2.cvtColor(grey[0], cv2.COLOR_GRAY2BGR))

    def infrared(layer: int) -> np.ndarray:
        frame = printed(expected(layer).mask, (190, 190, 190), layer)
        return cv2.cvtColor(cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR)

    for layer in range(1, 7):
        segmenter.learn(infrared(layer), expected(layer), segmenter.observe(infrared(layer), expected(layer)))
    assert iou(segmenter.observe(infrared(12), expected(12)).mask, expected(12).mask) > 0.9


def test_the_same_frames_give_the_same_answer():
    answers = [watched(AdaptiveSegmenter(None, bed()), 4).observe(bed(), expected(4)).mask for _ in range(2)]
    assert np.array_equal(*answers)


@pytest.mark.parametrize("on", [(120, 125, 118), (150, 150, 150)])
def test_thresholds_that_fit_the_bed_as_well_do_not_blind_it_to_a_black_print(on):
    """Black has no hue, so all that can be picked for it is any hue and a small value; and the machine is black, too."""
    black = (38, 36, 38)

    def with_machine(frame: np.ndarray) -> np.ndarray:
        frame[:24] = frame[:24] // 3
        return frame

    segmenter = AdaptiveSegmenter(HsvThresholds(0, 360, 0.0, 0.1), with_machine(bed(on)))
    for layer in range(3, 7):
        truth = expected(layer)
        frame = with_machine(printed(truth.mask, black, layer, on))
        seen = segmenter.observe(frame, truth)
        assert iou(seen.mask, truth.mask) > 0.9
        segmenter.learn(frame, truth, seen)


def test_a_head_that_stands_before_the_print_again_and_again_is_not_learned_as_filament():
    """At each layer it hides the newest part of what must be seen; what it hides is not seen."""
    segmenter, volume = AdaptiveSegmenter(None, bed()), np.zeros(BIRTH.shape, np.uint8)
    black = (18, 18, 20)
    for layer in range(6, 14):
        frame, top = printed(expected(layer).mask, seed=layer), BED_ROW - LAYER_PX * layer
        frame[max(top - 10, 30) : top + 2 * layer, 58:112] = black
        volume[:], volume[: top + 2 * layer] = 0, 255
        told = Expected(BIRTH, layer, layer - 1, volume=volume)
        segmenter.learn(frame, told, segmenter.observe(frame, told))
    frame = printed(expected(13).mask, seed=90)
    frame[top : top + 26, 60:110] = black
    seen = segmenter.observe(frame, expected(13)).mask
    assert not seen[top + 4 : top + 22, 64:106].any() and seen[top + 30 : BED_ROW - 4, 64:106].all()


RED = (40, 40, 200)
BLACK, STEEL = (18, 18, 20), (125, 125, 128)


def behind_a_head(layer: int, left: int, filament=RED, head=(BLACK, STEEL)) -> tuple[np.ndarray, Expected, np.ndarray]:
    """A picture in which a head of two colours stands over all but a quarter of the print, what must be seen there, and
    where the head is. It may be anywhere in the picture."""
    stands = np.zeros(BIRTH.shape, np.uint8)
    stands[20 : BED_ROW - 2, left : left + 60] = 255
    frame = printed(expected(layer).mask, filament, layer)
    rng = np.random.default_rng(layer)
    for rows, colour in zip((slice(0, 75), slice(75, None)), head):
        part = np.zeros_like(stands, bool)
        part[rows] = stands[rows] > 0
        frame[part] = np.clip(np.array(colour) + rng.normal(0, 4, (int(part.sum()), 3)), 0, 255)
    return frame, Expected(BIRTH, layer, volume=np.full(BIRTH.shape, 255, np.uint8)), stands


@pytest.mark.parametrize("reference", [bed(), None])
def test_a_print_that_is_seen_within_a_heads_reach_alone_is_told_from_the_head(reference):
    """From the first look on: what the head shows beside the print are its colours, and none of the filament's."""
    segmenter = AdaptiveSegmenter(None, reference)
    for layer, left in zip(range(8, 16), (20, 90, 24, 86, 30, 82, 20, 90)):
        frame, told, stands = behind_a_head(layer, left)
        seen = segmenter.observe(frame, told)
        matter = (told.mask > 0) & (stands == 0)
        assert (seen.mask[matter] > 0).mean() > 0.9
        assert (seen.mask[(told.mask > 0) & (stands > 0)] > 0).mean() < 0.1
        segmenter.learn(frame, told, seen)


def test_a_head_that_fills_the_prints_place_is_not_taken_for_it_once_the_print_was_seen():
    """Before anything was learned: of two looks that offer other colours neither is believed yet."""
    segmenter = AdaptiveSegmenter(None, bed())
    frame, told, _ = behind_a_head(8, 90)
    segmenter.observe(frame, told)
    frame[40:BED_ROW, 45:125] = np.clip(
        np.array((170, 170, 172)) + np.random.default_rng(1).normal(0, 4, (70, 80, 3)), 0, 255
    )
    seen = segmenter.observe(frame, told)
    assert (seen.mask[told.mask > 0] > 0).mean() < 0.1


def test_filament_of_the_heads_own_colour_is_not_claimed_within_its_reach():
    """A black print, and a black head before it: which of them is seen cannot be told."""
    segmenter = AdaptiveSegmenter(None, bed())
    for layer, left in zip(range(8, 14), (20, 90, 24, 86, 30, 82)):
        frame, told, stands = behind_a_head(layer, left, BLACK, (BLACK, BLACK))
        seen = segmenter.observe(frame, told)
        hidden = (told.mask > 0) & (stands > 0)
        assert ((seen.mask > 0) & (seen.unsure == 0))[hidden].mean() < 0.1
        segmenter.learn(frame, told, seen)
