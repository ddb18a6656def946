"""The same machine and room, described with the bed's origin in its corner and in its middle: nothing may look otherwise."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from octoprint_moop.core.camera import BedMotion
from octoprint_moop.core.expected.hardware import hidden_by
from octoprint_moop.core.expected.views import Expected
from octoprint_moop.core.head import HeadModel
from octoprint_moop.core.header import Printer
from octoprint_moop.core.view.backdrop import Backdrop
from octoprint_moop.core.view.glance import Glance
from tests.made import camera_at

MIDDLE = np.array([100.0, 100.0, 0.0])
CORNER = Printer(200, 200, 200, bed=BedMotion("y", (0, 150, 0)))
CAMERA = camera_at((100, -130, 190), (100, 90, 0), "5 coefficients", focal_px=560)


def centred() -> tuple:
    """Camera and printer in coordinates that begin in the bed's middle."""
    camera = replace(CAMERA, tvec_mm=CAMERA.tvec_mm + CAMERA.camera_from_room[:3, :3] @ MIDDLE)
    return camera, replace(CORNER, origin="center", bed=BedMotion("y", (-100, 50, 0)))


@pytest.fixture
def room() -> np.ndarray:
    rng = np.random.default_rng(8)
    coarse = rng.integers(30, 220, (30, 40, 3)).astype(np.uint8)
    return cv2.resize(coarse, CAMERA.image_size_px, interpolation=cv2.INTER_CUBIC)


def moved(camera, printer, room, position) -> Backdrop:
    nothing = Expected(np.zeros(room.shape[:2], np.uint32), 0)
    backdrop = Backdrop(camera, printer, room, printer.bed.reference_mm, nothing)
    backdrop.follow(position, nothing)
    return backdrop


def test_a_bed_that_slid_looks_the_same_wherever_its_origin_is(room):
    camera, printer = centred()
    one, other = moved(CAMERA, CORNER, room, (0, 110, 5)), moved(camera, printer, room, (-100, 10, 5))
    assert np.abs(one.picture().astype(int) - other.picture()).mean() < 0.1
    assert (one.unknown != other.unknown).mean() < 0.001
    frame = Glance(one.picture())
    turns = [one.stabiliser.turn(frame, (0, 110, 5)), other.stabiliser.turn(frame, (-100, 10, 5))]
    assert turns[0].motion_px == pytest.approx(turns[1].motion_px, abs=0.05)


@pytest.mark.parametrize("form", [{"origin": "center"}, {"form_factor": "circular"}])
def test_a_gantry_spans_a_bed_whose_origin_is_in_its_middle(form):
    camera, printer = centred()
    printer = replace(printer, **form)
    truth = hidden_by(HeadModel.common(200), (120.0, 110.0, 5.0), CORNER.bed, CAMERA)
    head = HeadModel.common(printer.width_mm, printer.bed_low_mm[0])
    found = hidden_by(head, (20.0, 10.0, 5.0), printer.bed, camera)
    assert (found != truth).mean() < 0.001


def test_a_bed_that_reaches_behind_the_camera_is_followed(room):
    """A camera that stands over the bed looks along it: two of the bed's corners lie behind it."""
    camera, printer = camera_at((100, 60, 50), (100, 140, 0)), replace(CORNER, bed=BedMotion("z", (0, 0, 0)))
    rng = np.random.default_rng(3)
    spots_mm = np.column_stack([rng.uniform([20, 90], [180, 200], (60, 2)), np.zeros(60)])

    def seen(z_mm: float) -> np.ndarray:
        pixels = camera.project(spots_mm + (0, 0, -z_mm)).round().astype(int)
        picture = np.full((480, 640, 3), 90, np.uint8)
        for x, y in pixels.tolist():
            cv2.circle(picture, (x, y), 6, (200, 210, 220), -1)
        return picture

    backdrop = moved(camera, printer, seen(0.0), (0, 0, 12.0))
    assert np.count_nonzero(backdrop.unknown) < 0.2 * backdrop.unknown.size
    known = cv2.resize(backdrop.unknown, (640, 480), interpolation=cv2.INTER_NEAREST) == 0
    apart = np.abs(backdrop.picture().astype(int) - seen(12.0)).max(axis=2)
    assert (apart[known] > 60).mean() < 0.01
    assert (np.abs(seen(0.0).astype(int) - seen(12.0)).max(axis=2)[known] > 60).mean() > 0.02
