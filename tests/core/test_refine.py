"""The self-check of a calibration by a print's silhouette."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from octoprint_moop.core.calibration.refine import SilhouetteView, refine_camera, silhouette_edges
from octoprint_moop.core.expected.raster import CvRenderer
from octoprint_moop.core.expected.views import Expected
from tests.made import camera_at, toolpath_of

TRUE = camera_at((100, -60, 120), (100, 100, 10), "5 coefficients")


def tower():
    """Forty layers of a rectangle of four walls, filled, with a step half way."""
    beads, layers = [], []
    for layer in range(40):
        z, right = 0.5 * (layer + 1), 130 if layer < 20 else 115
        for y in np.arange(80, 120.1, 1.0):
            beads.append([80, y, z, right, y, z, 1.1, 0.5])
            layers.append(layer)
    return toolpath_of(beads, layers)


PRINT = tower()


def views(seen_by, thought, change=lambda mask: mask, laid=(8, 16, 24, 32, 40)):
    births = [CvRenderer().birth_map(PRINT, camera, np.zeros(3)) for camera in (thought, seen_by)]
    found = []
    for layers in laid:
        expected, truth = (Expected(birth, int(PRINT.layer_start[layers])) for birth in births)
        found.append(SilhouetteView(expected, change(truth.mask), np.zeros(3)))
    return [silhouette_edges(thought, PRINT, view) for view in found]


def test_a_good_calibration_is_said_to_be_good_and_left_alone():
    result = refine_camera(TRUE, views(TRUE, TRUE))
    assert result.off_px < 0.2
    assert result.camera is None
    assert "gain" in result.why


def test_a_camera_that_was_nudged_is_measured_and_corrected():
    thought = replace(TRUE, rvec=TRUE.rvec + [0.003, -0.004, 0.002])
    result = refine_camera(thought, views(TRUE, thought))
    print_mm = PRINT.beads_mm[::50, :3].astype(float)
    off_px = np.linalg.norm(thought.project(print_mm) - TRUE.project(print_mm), axis=1).mean()
    assert off_px > 1.5
    assert 0.3 * off_px < result.off_px < 1.5 * off_px
    assert result.camera is not None
    assert np.linalg.norm(result.camera.project(print_mm) - TRUE.project(print_mm), axis=1).mean() < 0.3 * off_px


def test_a_mask_that_is_wide_all_round_is_not_taken_for_a_moved_camera():
    wide = views(TRUE, TRUE, lambda mask: cv2.dilate(mask, np.ones((5, 5), np.uint8)))
    result = refine_camera(TRUE, wide)
    assert result.camera is None
    assert result.off_px < 0.6


def test_a_print_that_bends_is_not_chased():
    def bent(mask):
        rows, columns = np.nonzero(mask)
        middle, half = columns.mean(), np.ptp(columns) / 2
        x, y = np.meshgrid(np.arange(mask.shape[1], dtype=np.float32), np.arange(mask.shape[0], dtype=np.float32))
        lifted = (y + 9 * ((x - middle) / half) ** 2).astype(np.float32)
        return cv2.remap(mask, x, lifted, cv2.INTER_NEAREST)

    result = refine_camera(TRUE, views(TRUE, TRUE, bent))
    assert result.camera is None
    assert result.why


def test_a_print_that_moved_in_later_layers_is_not_chased():
    good, moved = views(TRUE, TRUE), views(TRUE, TRUE, lambda mask: np.roll(mask, 5, axis=1))
    result = refine_camera(TRUE, good[:3] + moved[3:])
    assert result.camera is None


def test_an_empty_mask_says_that_nothing_can_be_judged():
    result = refine_camera(TRUE, views(TRUE, TRUE, np.zeros_like))
    assert result.camera is None
    assert "Too little" in result.why
    assert refine_camera(TRUE, []).camera is None


def test_two_layers_are_measured_but_nothing_is_changed():
    thought = replace(TRUE, rvec=TRUE.rvec + [0.003, -0.004, 0.002])
    result = refine_camera(thought, views(TRUE, thought, laid=(20, 30)))
    assert result.camera is None
    assert result.off_px > 0.5
    assert "three are needed" in result.why
