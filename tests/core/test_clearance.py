"""What the print has shown beneath the nozzle, carried to where the nozzle is now; the truth is projected from the room."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from octoprint_moop.core.camera import BedMotion, Camera
from octoprint_moop.core.view.clearance import Clearance
from octoprint_moop.core.view.window import Window

WINDOW = Window((640, 480), 0, 0, 640, 480)


@pytest.fixture
def camera() -> Camera:
    """Looks at the origin from 400 mm in front and 200 mm above."""
    ahead = np.array([0, 400.0, -200.0]) / np.hypot(400, 200)
    right = np.array([1.0, 0, 0])
    rotation = np.stack([right, np.cross(ahead, right), ahead])
    K = np.array([[600.0, 0, 319.5], [0, 600, 239.5], [0, 0, 1]])
    rvec = cv2.Rodrigues(rotation)[0].ravel()
    return Camera((640, 480), K, np.zeros(5), rvec, -rotation @ np.array([0, -400.0, 200.0]))


def beneath(camera: Camera, nozzle: tuple[float, float, float]) -> np.ndarray:
    """(480, 640) uint8: a board 40 mm wide and 20 mm high that hangs under the nozzle and faces the camera."""
    corners = np.array(nozzle) + [[-20, 0, 0], [20, 0, 0], [20, 0, -20], [-20, 0, -20]]
    mask = np.zeros((480, 640), np.uint8)
    return cv2.fillConvexPoly(mask, camera.project(corners).round().astype(np.int32), 255)


PLACES = [(0.0, 0.0, 10.0), (12.0, -8.0, 10.3), (-15.0, 10.0, 10.6)]


def learned(camera: Camera, places: list, bed: BedMotion = BedMotion()) -> Clearance:
    clearance = Clearance(camera, bed)
    for place in places:
        clearance.learn(WINDOW, place, beneath(camera, place + bed.room_from_print_mm(place)))
    return clearance


def test_where_matter_was_seen_twice_there_is_no_head_wherever_the_nozzle_goes(camera):
    clearance, now = learned(camera, PLACES), (20.0, 15.0, 11.0)
    truth, free = beneath(camera, now) > 0, clearance.free(WINDOW, now) > 0
    assert not (free & ~truth).any()
    assert np.count_nonzero(free) > 0.6 * np.count_nonzero(truth)


def test_one_look_is_not_enough(camera):
    assert not learned(camera, PLACES[:1]).free(WINDOW, PLACES[1]).any()


def test_from_another_side_the_head_looks_otherwise(camera):
    assert not learned(camera, PLACES).free(WINDOW, (150.0, 0.0, 11.0)).any()


def test_before_a_slinger_the_nozzle_stays_where_the_bed_passes_under_it(camera):
    bed = BedMotion("y", (0, 0, 0))
    clearance = learned(camera, [(0.0, 5.0, 10.0), (3.0, 90.0, 10.0)], bed)
    free = clearance.free(WINDOW, (-5.0, -60.0, 10.0)) > 0
    truth = beneath(camera, (-5.0, 0.0, 10.0)) > 0
    assert free.any() and not (free & ~truth).any()
