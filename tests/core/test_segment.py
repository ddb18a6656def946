"""The paper's thresholds: exact, pickable by clicks, and honest about what they cannot do."""

from __future__ import annotations

import colorsys

import numpy as np

from octoprint_moop.core.segmentation.segment import (
    HsvThresholds,
    ThresholdSegmenter,
    segment_hsv,
    thresholds_of,
)


def picture(*colours_bgr: tuple[int, int, int]) -> np.ndarray:
    """Upright stripes 40 pixels wide and 60 high, with a little noise."""
    stripes = np.concatenate([np.full((60, 40, 3), colour, np.uint8) for colour in colours_bgr], axis=1)
    noise = np.random.default_rng(0).integers(-4, 5, stripes.shape)
    return np.clip(stripes.astype(int) + noise, 0, 255).astype(np.uint8)


def test_the_thresholds_agree_with_the_standard_librarys_hsv():
    rng = np.random.default_rng(3)
    frame = rng.integers(0, 256, (40, 50, 3), dtype=np.uint8)
    seen = segment_hsv(frame, HsvThresholds(30, 200, 0.3, 0.4))
    for row, column in rng.integers(0, 40, (200, 2)):
        blue, green, red = (frame[row, column] / 255).tolist()
        hue, saturation, value = colorsys.rgb_to_hsv(red, green, blue)
        edges = (abs(hue * 360 - 30), abs(hue * 360 - 200), abs(saturation - 0.3) * 360, abs(value - 0.4) * 360)
        if min(edges) > 0.1:
            wanted = 30 <= hue * 360 <= 200 and saturation > 0.3 and value > 0.4
            assert bool(seen[row, column]) == wanted


def test_a_band_of_reds_wraps_through_zero():
    frame = picture((30, 20, 220), (30, 40, 220), (40, 20, 220), (200, 60, 40))
    seen = segment_hsv(frame, HsvThresholds(345, 15, 0.4, 0.3))
    assert seen[:, :120].all() and not seen[:, 120:].any()


def test_a_band_learned_from_a_label_holds_nine_tenths_of_each_limit():
    frame = picture((40, 120, 240), (60, 60, 65))
    mask = np.zeros(frame.shape[:2], np.uint8)
    mask[:, :40] = 1
    seen = segment_hsv(frame, thresholds_of(frame, mask))
    assert 0.7 < (seen[:, :40] > 0).mean() < 1 and not seen[:, 40:].any()


def test_the_threshold_segmenter_is_equation_12_and_never_unsure():
    frame, thresholds = picture((40, 120, 240), (60, 60, 65)), HsvThresholds(10, 50, 0.4, 0.3)
    seen = ThresholdSegmenter(thresholds).observe(frame)
    assert np.array_equal(seen.mask, segment_hsv(frame, thresholds)) and not seen.unsure.any()
