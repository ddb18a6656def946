"""What the print has shown beneath the nozzle, carried to where the nozzle is now; the truth is projected from the room."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from octoprint_moop.core.camera import BedMotion, Camera
from octoprint_moop.core.view.clearance import Clearance, in_place
from octoprint_moop.core.view.window import Window

WINDOW = Window((640, 480), 0, 0, 640, 480)
NOTHING = np.zeros((480, 640), np.uint8)


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
        clearance.learn(WINDOW, place, beneath(camera, place + bed.room_from_print_mm(place)), NOTHING)
    return clearance


def free_of_matter(clearance: Clearance, now: tuple[float, float, float]) -> np.ndarray:
    """bool; within the reach of a head that is hardly there"""
    return clearance.free(WINDOW, now, NOTHING)[0] > 0


def test_where_matter_was_seen_twice_there_is_no_head_wherever_the_nozzle_goes(camera):
    clearance, now = learned(camera, PLACES), (20.0, 15.0, 11.0)
    truth, free = beneath(camera, now) > 0, free_of_matter(clearance, now)
    assert not (free & ~truth).any()
    assert np.count_nonzero(free) > 0.6 * np.count_nonzero(truth)


def test_one_look_is_not_enough(camera):
    assert not free_of_matter(learned(camera, PLACES[:1]), PLACES[1]).any()


def test_from_another_side_the_head_looks_otherwise(camera):
    assert not free_of_matter(learned(camera, PLACES), (150.0, 0.0, 11.0)).any()


def test_before_a_slinger_the_nozzle_stays_where_the_bed_passes_under_it(camera):
    bed = BedMotion("y", (0, 0, 0))
    clearance = learned(camera, [(0.0, 5.0, 10.0), (3.0, 90.0, 10.0)], bed)
    free = free_of_matter(clearance, (-5.0, -60.0, 10.0))
    truth = beneath(camera, (-5.0, 0.0, 10.0)) > 0
    assert free.any() and not (free & ~truth).any()


def test_where_the_bed_was_seen_something_may_be_too_much_but_nothing_missing(camera):
    clearance, now = Clearance(camera, BedMotion()), (20.0, 15.0, 11.0)
    for place in PLACES:
        clearance.learn(WINDOW, place, NOTHING, beneath(camera, place))
    matter, either = clearance.free(WINDOW, now, NOTHING)
    assert not matter.any()
    assert cv2.countNonZero(either) > 0.6 * cv2.countNonZero(beneath(camera, now))


def test_a_part_of_the_head_that_looks_like_the_bed_is_not_free(camera):
    """It lies all within the head, while what is free hangs together with what lies beyond the head's reach."""
    clearance, now = Clearance(camera, BedMotion()), PLACES[0]
    for _ in range(2):
        clearance.learn(WINDOW, now, NOTHING, beneath(camera, now))
    x, y, width, height = cv2.boundingRect(beneath(camera, now))
    around, above = np.zeros((2, *NOTHING.shape), np.uint8)
    around[y - 20 : y + height + 20, x - 20 : x + width + 20] = 255
    above[: y + 10] = 255
    assert not (clearance.free(WINDOW, now, around)[1] & around).any()
    assert (clearance.free(WINDOW, now, above)[1] & above).any()


def test_what_was_seen_from_a_nozzle_that_stands_at_one_place_hangs_together_with_what_lies_beyond_the_head(camera):
    """Nothing is learned beyond the head's reach, since nothing is in doubt there."""
    clearance, now = Clearance(camera, BedMotion()), PLACES[0]
    head = beneath(camera, now)
    for _ in range(2):
        clearance.learn(WINDOW, now, NOTHING, head)
    assert cv2.countNonZero(clearance.free(WINDOW, now, head)[1] & head) > 0.9 * cv2.countNonZero(head)


def test_matter_that_hangs_together_with_nothing_beyond_the_head_is_believed_where_it_was_seen_often(camera):
    everywhere, places = np.full_like(NOTHING, 255), [*PLACES, (5.0, 6.0, 10.9)]
    for seen, free in ((3, False), (4, True)):
        matter, _ = learned(camera, places[:seen]).free(WINDOW, (0.0, 0.0, 11.0), everywhere)
        assert matter.any() == free


@pytest.mark.parametrize(("beside_px", "counts"), [(0, True), (80, True), (400, False)])
def test_matter_in_its_place_counts_unless_more_of_its_colour_is_seen_about_it(beside_px, counts):
    """Else it is the head that has the filament's colour."""
    expected, observed, head = (np.zeros((40, 60), np.uint8) for _ in range(3))
    expected[10:20, 10:20] = observed[10:20, 10:20] = 255
    observed[20:40, 20:60].flat[:beside_px] = 255
    head[5:] = 255
    assert in_place(observed, expected, head).any() == counts
    head[:] = 0
    assert in_place(observed, expected, head).any()
