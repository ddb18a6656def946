"""Which way the bed moves, from two drawn pictures."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from octoprint_moop.core.calibration.bedmotion import measure_bed_motion
from octoprint_moop.core.calibration.plate import PlateSettings, place_markers
from octoprint_moop.core.errors import CalibrationError
from octoprint_moop.core.header import Printer
from tests.drawn import draw_plate
from tests.made import camera_at

PRINTER = Printer(200, 200, 200)
PLATE = place_markers(PRINTER, PlateSettings())
CAMERA = camera_at((100, -130, 190), (100, 90, 0), "5 coefficients", focal_px=560)
FIRST, SECOND = (0, 150, 20), (0, 120, 55)


def picture(shift_mm=(0, 0, 0), seed=3):
    """The plate on a bed that moved by `shift_mm`, with a dark head that did not."""
    moved = replace(CAMERA, tvec_mm=CAMERA.tvec_mm + CAMERA.camera_from_room[:3, :3] @ np.asarray(shift_mm, float))
    image = draw_plate(np.random.default_rng(seed), moved, PLATE, PRINTER, 20.0)
    cv2.rectangle(image, (260, 40), (380, 160), (30, 60, 30), -1)
    cv2.putText(image, "HEAD", (270, 110), cv2.FONT_HERSHEY_SIMPLEX, 1.2, (200, 200, 200), 2)
    return image


@pytest.mark.parametrize(("kind", "shift"), [("fixed", (0, 0, 0)), ("y", (0, 30, 0)), ("z", (0, 0, -35))])
def test_the_motion_of_each_kind_of_printer_is_told(kind, shift):
    found = measure_bed_motion(picture(), picture(shift), CAMERA, PRINTER, FIRST, SECOND)
    assert found.motion.kind == kind
    assert found.motion.reference_mm == FIRST
    assert found.to_json()["bed_motion"] == kind


def test_a_bed_that_moves_against_its_axis_is_told():
    with pytest.raises(CalibrationError, match="against"):
        measure_bed_motion(picture(), picture((0, -30, 0)), CAMERA, PRINTER, FIRST, SECOND)


def test_positions_that_do_not_differ_are_refused():
    with pytest.raises(CalibrationError, match="too little"):
        measure_bed_motion(picture(), picture(), CAMERA, PRINTER, FIRST, (50, 150, 55))


def test_an_empty_picture_is_refused():
    black = np.zeros((480, 640, 3), np.uint8)
    with pytest.raises(CalibrationError, match="cannot be told"):
        measure_bed_motion(black, black, CAMERA, PRINTER, FIRST, SECOND)
