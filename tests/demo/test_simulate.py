"""The simulated webcam shows what has been printed: no more, no less, and in its place."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from octoprint_moop.core.camera import BedMotion
from octoprint_moop.demo.faults import KINDS, Fault
from octoprint_moop.demo.run import BED, demo_camera
from octoprint_moop.demo.simulate import Nuisance, Scene

PARKED = (0.0, 200.0, 6.3)


@pytest.fixture
def scene(toolpath):
    def make(*faults, **options):
        return Scene(toolpath, demo_camera(), BED, faults=faults, **options)

    return make


def end_of(toolpath, layer):
    return int(toolpath.layer_end_pos[layer])


def test_matter_is_where_opencv_projects_the_beads_and_nowhere_else(scene, toolpath):
    mask = scene().truth(end_of(toolpath, 20), PARKED)
    beads = toolpath.beads_mm[: toolpath.layer_start[21]].astype(np.float64)
    camera = demo_camera()
    middles = (beads[:, :3] + beads[:, 3:6]) / 2 - np.column_stack([0 * beads[:, :2], beads[:, 7] / 2])
    pixels, _ = cv2.projectPoints(middles, camera.rvec, camera.tvec_mm, camera.K, camera.distortion)
    columns, rows = np.round(pixels.reshape(-1, 2)).astype(int).T
    seen = (columns >= 0) & (columns < 640) & (rows >= 0) & (rows < 480)
    assert (mask[rows[seen], columns[seen]] > 0).mean() > 0.995
    along = np.concatenate([beads[:, :3] + t * (beads[:, 3:6] - beads[:, :3]) for t in np.linspace(0, 1, 60)])
    ends, _ = cv2.projectPoints(along, camera.rvec, camera.tvec_mm, camera.K, camera.distortion)
    points = np.zeros_like(mask)
    columns, rows = np.round(ends.reshape(-1, 2)).astype(int).T
    inside = (columns >= 0) & (columns < 640) & (rows >= 0) & (rows < 480)
    points[rows[inside], columns[inside]] = 255
    reach = cv2.morphologyEx(points, cv2.MORPH_CLOSE, np.ones((9, 9)))
    assert not (mask & ~cv2.dilate(reach, np.ones((9, 9)))).any()


def test_nothing_is_seen_of_what_was_not_sent(scene, toolpath):
    empty = scene()
    assert not empty.truth(0, PARKED).any()
    counts = [int((empty.truth(end_of(toolpath, layer), PARKED) > 0).sum()) for layer in (0, 10, 20, 66)]
    assert counts == sorted(counts)
    assert counts[0] > 300


def test_the_same_seed_gives_the_same_picture_whatever_was_asked_before(scene, toolpath):
    asked, fresh = scene(seed=5), scene(seed=5)
    for layer in (3, 12, 11, 20):
        asked.frame(end_of(toolpath, layer), PARKED)
    moment = (end_of(toolpath, 20), PARKED, 7)
    difference = cv2.absdiff(asked.frame(*moment), fresh.frame(*moment))
    assert (difference.max(axis=2) > 40).mean() < 0.002
    assert np.array_equal(fresh.frame(*moment), fresh.frame(*moment))
    assert not np.array_equal(fresh.frame(*moment), fresh.frame(*moment[:2], 8))


@pytest.mark.parametrize("kind", KINDS)
def test_a_fault_shows_after_its_layer_and_not_before(scene, toolpath, kind):
    good, bad = scene(), scene(Fault(kind, 20))

    def wrong_px(layer):
        masks = (s.truth(end_of(toolpath, layer), PARKED) for s in (good, bad))
        return int(np.count_nonzero(np.bitwise_xor(*masks)))

    assert wrong_px(19) == 0
    assert wrong_px(30) > 100


def test_a_fault_of_one_object_leaves_the_other_alone(scene, toolpath):
    good, bad = scene(), scene(Fault("detachment", 20, object_id=1))
    wrong = good.truth(end_of(toolpath, 22), PARKED) ^ bad.truth(end_of(toolpath, 22), PARKED)
    mine = toolpath.object_id == 0
    tug = demo_camera().project(toolpath.beads_mm[mine][:, :3].astype(np.float64))
    assert not wrong[:, : int(tug[:, 0].max()) - 40].any()
    assert wrong.any()


def test_the_bed_carries_the_print_through_the_picture(scene, toolpath):
    here, there = (scene().truth(end_of(toolpath, 20), (0.0, y, 6.3)) for y in (200.0, 190.0))
    rows = [np.flatnonzero(mask.any(axis=1)).mean() for mask in (here, there)]
    assert rows[1] < rows[0] - 5  # the bed is farther from the camera, so higher in its picture


def test_a_bed_that_drops_takes_print_and_shadow_down_with_it(toolpath):
    scene = Scene(toolpath, demo_camera(), BedMotion("z", (0.0, 0.0, 0.3)), with_head=False)
    rows = []
    for z in (0.3, 20.3):
        position = (0.0, 200.0, z)
        there, empty = scene.frame(end_of(toolpath, 20), position), scene.frame(0, position)
        rows.append(np.flatnonzero(scene.truth(end_of(toolpath, 20), position).any(axis=1)).mean())
        darker = empty.astype(int).sum(axis=2) - there.astype(int).sum(axis=2) > 25
        darker &= cv2.dilate(scene.truth(end_of(toolpath, 20), position), np.ones((5, 5))) == 0
        shadow = np.flatnonzero(cv2.morphologyEx(darker.astype(np.uint8), cv2.MORPH_OPEN, np.ones((5, 5))).any(axis=1))
        assert abs(np.median(shadow) - rows[-1]) < 60  # on the bed, beside the print
    assert rows[1] > rows[0] + 30


def test_a_head_before_the_print_hides_it_and_a_parked_one_does_not(scene, toolpath):
    for position, hidden in ((PARKED, False), ((122.0, 55.0, 6.3), True)):
        frame = scene().frame(end_of(toolpath, 20), position).astype(int)
        orange = (frame[..., 2] - frame[..., 0] > 90) & (frame[..., 1] < 0.75 * frame[..., 2])
        share = orange[scene().truth(end_of(toolpath, 20), position) > 0].mean()
        assert (share < 0.8) == hidden


@pytest.mark.parametrize("kind", ["dim", "bright", "hand", "white_balance", "black"])
def test_a_nuisance_changes_the_picture_and_not_the_print(scene, toolpath, kind):
    quiet, disturbed = scene(), scene(nuisances=(Nuisance(kind, 20, 1),))
    for layer, differs in ((19, False), (20, True), (21, False)):
        moment = (end_of(toolpath, layer), PARKED)
        assert np.array_equal(quiet.truth(*moment), disturbed.truth(*moment))
        assert np.array_equal(quiet.frame(*moment), disturbed.frame(*moment)) is not differs


def test_a_nudged_camera_sees_everything_displaced(scene, toolpath):
    moment = (end_of(toolpath, 20), PARKED)
    assert (scene(nuisances=(Nuisance("nudge", 20),)).truth(*moment) ^ scene().truth(*moment)).any()
