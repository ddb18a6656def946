"""What must be seen follows the file, the bed, the cancelled objects and what stands before the camera."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt

from octoprint_moop.core.camera import BedMotion
from octoprint_moop.core.errors import RecordingError, SettingsError
from octoprint_moop.core.expected import views as module
from octoprint_moop.core.expected.hardware import hidden_by
from octoprint_moop.core.expected.raster import CvRenderer
from octoprint_moop.core.expected.views import ExpectedViews
from octoprint_moop.core.head import Box, HeadModel
from octoprint_moop.core.header import Header, Moment, Printer
from octoprint_moop.core.settings import read_value
from octoprint_moop.core.toolpath import Role
from octoprint_moop.core.view.view import View
from tests.made import camera_at, toolpath_of, vase

CAMERA = camera_at((100, -80, 90), (100, 100, 5), "5 coefficients")
LOW = camera_at((100, -80, 9), (100, 100, 2), "5 coefficients")  # so low that near things hide far ones
HERE = (0.0, 0.0, 0.0)


class Counting(CvRenderer):
    """Counts what is drawn."""

    def __init__(self):
        self.drawn = []

    def birth_map(self, toolpath, camera, room_from_print_mm, beads=None):
        self.drawn.append(len(toolpath) if beads is None else len(beads))
        return super().birth_map(toolpath, camera, room_from_print_mm, beads)


def views(toolpath, bed=BedMotion(), **options):
    return ExpectedViews(toolpath, CAMERA, bed, Counting(), **options)


def drawn_alone(toolpath, chosen, shift=HERE, camera=CAMERA):
    """The mask of some beads, drawn from nothing else: another road to the same pixels."""
    return np.where(CvRenderer().birth_map(toolpath, camera, np.asarray(shift), np.flatnonzero(chosen)) > 0, 255, 0)


def test_the_mask_at_a_position_is_that_of_the_beads_that_end_there():
    print_ = vase()
    seen = views(print_)
    for laid in (0, 1, 77, len(print_)):
        wanted = drawn_alone(print_, np.arange(len(print_)) < laid)
        assert np.array_equal(seen.at(10 * laid, HERE).mask, wanted)
        assert np.array_equal(seen.at(10 * laid + 9, HERE).mask, wanted)
    assert len(seen._renderer.drawn) == 1
    assert np.array_equal(seen.at(0, HERE).complete, seen.at(10**9, HERE).mask)


def test_what_is_in_doubt_is_what_may_not_lie_yet():
    seen = views(vase()).at(3000, HERE, sure_pos=2930)
    sure = views(vase()).at(2930, HERE).mask
    assert np.array_equal(seen.ignored, seen.mask & ~sure)
    assert seen.ignored.any()


def test_a_slinger_moves_the_print_and_each_pose_is_drawn_once():
    print_ = vase()
    seen = views(print_, BedMotion("y", (0, 200, 0)))
    for _ in range(3):
        for y in (200, 170):
            wanted = drawn_alone(print_, np.arange(len(print_)) < 300, (0, 200 - y, 0))
            assert np.array_equal(seen.at(3000, (5, y, 9)).mask, wanted)
    assert len(seen._renderer.drawn) == 2


def test_a_long_print_on_a_dropping_bed_does_not_fill_the_memory():
    seen = views(vase(), BedMotion("z", (0, 0, 0)))
    for z in range(30):
        seen.at(3000, (0, 0, z))
    assert len(seen._births) <= module.KEPT_POSES


def test_at_a_passing_pose_only_what_is_seen_from_outside_is_drawn(monkeypatch):
    monkeypatch.setattr(module, "WHOLE_BEADS", 100)
    solid = disc()
    whole = drawn_alone(solid, np.arange(len(solid)) < 700, (0, 0, -2.0)) > 0
    seen = views(solid, BedMotion("z", (0, 0, 0)))
    mask = seen.at(7000, (0, 0, 2.0)).mask > 0
    assert seen._renderer.drawn[0] < 0.5 * len(solid)
    assert (mask ^ whole).sum() < 0.002 * whole.sum()
    seen.at(7000, (0, 0, 2.0))
    assert len(seen._renderer.drawn) == 1  # the confirming frame of the same layer costs nothing


def disc():
    """A filled disc: rings inwards, only the outermost an outer wall, the top a surface."""
    parts = [vase(10, 30, radius_mm=radius).beads_mm.reshape(10, 30, 8) for radius in np.arange(15, 2, -0.4)]
    roles = [np.full((10, 30), Role.OUTER if i == 0 else Role.INFILL) for i in range(len(parts))]
    beads, roles = np.concatenate(parts, axis=1), np.concatenate(roles, axis=1)
    roles[-1] = Role.SURFACE
    layers = np.repeat(np.arange(10), beads.shape[1])
    return toolpath_of(beads.reshape(-1, 8), layers, role=roles.ravel().astype(np.uint8))


def two_posts(first=(100, 80), second=(103, 110), **changes):
    """Two posts in one print, the first (object 0) nearer to the camera, printed layer about."""
    near, far = vase(10, 24, first, 5).beads_mm, vase(10, 24, second, 5).beads_mm
    beads = np.concatenate([near.reshape(10, 24, 8), far.reshape(10, 24, 8)], axis=1).reshape(-1, 8)
    return toolpath_of(beads, np.repeat(np.arange(10), 48), np.tile(np.repeat([0, 1], 24), 10), **changes)


def test_a_cancelled_object_stops_growing_and_the_other_goes_on():
    print_ = two_posts()
    index = np.arange(len(print_))
    cancel_pos = 10 * 48 * 4
    seen = views(print_).at(10 * 48 * 8, HERE, cancelled={1: cancel_pos})
    stays = (print_.object_id == 0) | (print_.end_pos <= cancel_pos)
    assert np.array_equal(seen.mask, drawn_alone(print_, stays & (index < 48 * 8)))
    assert np.array_equal(seen.complete, drawn_alone(print_, stays))
    assert not np.array_equal(seen.mask, views(print_).at(10 * 48 * 8, HERE).mask)


def test_an_object_that_the_file_itself_cancels_is_not_expected_and_the_earlier_cancelling_counts():
    by_file = two_posts(cancelled=((1, 10 * 48 * 4),))
    live = views(two_posts()).at(10**6, HERE, cancelled={1: 10 * 48 * 4}).mask
    assert np.array_equal(views(by_file).at(10**6, HERE).mask, live)
    assert np.array_equal(views(by_file).at(10**6, HERE, cancelled={1: 10 * 48 * 9}).mask, live)


def test_pixels_belong_to_the_object_that_alone_can_cover_them_and_lie_near_one():
    print_ = two_posts()
    whose = ExpectedViews(print_, LOW, BedMotion(), CvRenderer()).map_at(HERE)
    near, far = (drawn_alone(print_, print_.object_id == number, camera=LOW) > 0 for number in (0, 1))
    assert (near & far).any() and whose.objects == 2
    assert np.array_equal(whose.owner == 0, near & ~far) and np.array_equal(whose.owner == 1, far & ~near)
    assert (whose.nearest[far & ~near] == 1).all() and (whose.nearest[near & ~far] == 0).all()
    away = [distance_transform_edt(whose.owner != number) for number in (0, 1)]
    plain = np.abs(away[0] - away[1]) > 0.05 * np.minimum(*away)  # so good is the transform
    assert np.array_equal(whose.nearest[plain], (away[1] < away[0])[plain])


def test_an_unparked_head_may_hide_what_lies_within_its_volume():
    head = HeadModel((Box((-10, -12, 0), (10, 12, 30)),), Box((-50, 10, 15), (250, 30, 40)))
    bed = BedMotion("y", (0, 150, 0))
    position = (90.0, 120.0, 4.0)
    seen = views(vase(), bed, head=head)
    assert not seen.at(3000, position).head.any()
    volume = seen.at(3000, position, parked=False).head
    rng = np.random.default_rng(1)
    nozzle = np.array([90, 150, 4])  # a slinger's nozzle does not move in Y: the bed does
    inside = nozzle + rng.uniform((-10, -12, 0), (10, 12, 30), (400, 3))
    beam = np.array([0, 150, 4]) + rng.uniform((-50, 10, 15), (250, 30, 40), (400, 3))
    for x, y in CAMERA.project(np.concatenate([inside, beam])).round().astype(int):
        if 0 <= x < 640 and 0 <= y < 480:
            assert volume[y, x]
    far = CAMERA.project(np.array([[90.0, 60.0, 0.0]])).round().astype(int)[0]
    assert not volume[far[1], far[0]]


def test_a_beam_that_reaches_behind_the_camera_does_not_turn_inside_out():
    head = HeadModel((), Box((-500, -400, 150), (800, -60, 160)))
    mask = hidden_by(head, (100, 0, 0), BedMotion(), CAMERA)
    assert not mask[-100:].any()


def test_a_head_of_impossible_boxes_is_refused_in_words():
    with pytest.raises(SettingsError, match="must grow"):
        Box((0, 0, 0), (1, -1, 1))
    with pytest.raises(SettingsError, match="low_mm"):
        Box.from_json({"low_mm": [0, 0, 0]})
    with pytest.raises(SettingsError, match="three numbers"):
        Box.from_json({"low_mm": [0, 0], "high_mm": [1, 1, 1]})
    with pytest.raises(SettingsError, match="head"):
        HeadModel.from_json({"gantry": None})
    head = HeadModel.common(250)
    assert HeadModel.from_json(json.loads(json.dumps(head.to_json()))) == head


def test_beyond_the_fold_of_the_lens_nothing_is_expected_and_nothing_is_judged():
    folding = camera_at((100, -80, 90), (100, 100, 5), focal_px=260)
    folding = type(folding)(folding.image_size_px, folding.K, [-0.4, 0, 0, 0, 0], folding.rvec, folding.tvec_mm)
    seen = ExpectedViews(vase(), folding, BedMotion(), CvRenderer()).at(3000, HERE)
    assert seen.ignored[0, 0] and not seen.ignored[240, 320]
    rays = np.array([[np.tan(a), 0, 1.0] for a in np.linspace(0, 1.4, 500)])
    r = rays[:, 0] * (1 - 0.4 * rays[:, 0] ** 2)
    reach_px = folding.K[0, 0] * r.max()
    from_axis = np.hypot(*(np.argwhere(seen.ignored == 0)[:, ::-1] - folding.K[:2, 2]).T / [[1], [1.02]])
    assert from_axis.max() < reach_px


CASES = ["cube-clean", "detach-bedslinger", "dtu-paper", "multi-object"]


@pytest.mark.parametrize("case", CASES)
def test_rendered_truth_is_met(shared, case):
    gcode = pytest.importorskip("octoprint_moop.core.gcode.read")
    folder = shared / "cases" / case
    header = Header.from_json(json.loads((folder / "recording.json").read_text()))
    fault = json.loads((folder / "truth.json").read_text())["fault"]
    onset = fault["onset_layer"] if fault else 10**9
    seen = ExpectedViews(gcode.read_gcode(folder / "job.gcode"), header.camera(), header.printer.bed, CvRenderer())
    ious = []
    for line in (folder / "frames.jsonl").read_text().splitlines()[::4]:
        moment = Moment.from_json(json.loads(line))
        if 5 <= moment.layer < onset:
            truth = cv2.imread(str(folder / moment.frame.replace(".jpg", ".mask.png")), cv2.IMREAD_GRAYSCALE) > 0
            mask = seen.at(moment.file_pos, moment.position_mm).mask > 0
            ious.append((mask & truth).sum() / (mask | truth).sum())
    assert len(ious) >= 5
    # The true masks join the ends of long beads by straight lines where the lens bends them: see docs/rendering.
    assert np.mean(ious) >= (0.985 if case in ("cube-clean", "detach-bedslinger") else 0.97)


def test_the_head_of_the_settings_is_json_or_the_common_one():
    assert HeadModel.from_text(" ", 250) == HeadModel.common(250)
    own = HeadModel((Box((-1, -2, 0), (1, 2, 3)),))
    assert HeadModel.from_text(json.dumps(own.to_json()), 250) == own
    with pytest.raises(SettingsError, match="not JSON"):
        HeadModel.from_text("{head", 250)


def test_a_moment_carries_what_was_cancelled_and_the_view_expects_it_no_more():
    print_ = two_posts()
    cancel_pos = 10 * 48 * 4
    line = {
        "frame": "frames/000001.jpg", "file_pos": 10 * 48 * 8, "layer": 7, "position_mm": {"x": 0, "y": 0, "z": 0},
        "time_s": 1.0, "parked": True, "cancelled": {"part 1": cancel_pos, "of another file": 7},
    }  # fmt: skip
    moment = Moment.from_json(line)
    assert moment.to_json() == line
    assert "cancelled" not in Moment.from_json({**line, "cancelled": None}).to_json()
    with pytest.raises(RecordingError, match="makes no sense"):
        Moment.from_json({**line, "cancelled": ["part 1"]})
    view = View(CAMERA, Printer(250, 210, 210), print_, CvRenderer(), None, "adaptive", None)
    stays = (print_.object_id == 0) | (print_.end_pos <= cancel_pos)
    assert np.array_equal(view.expected(moment).complete, drawn_alone(print_, stays))
    assert (view.print_map(moment).owner >= 0).any()


def test_a_head_that_makes_no_sense_is_refused_where_it_is_entered():
    for wrong, word in (
        ("{head", "not JSON"), ("[" * 99999, "head"), ('{"head": 3}', "list of boxes"),
        ('{"head": [{"low_mm": [0, 0, 0]}]}', "low_mm"),
    ):  # fmt: skip
        with pytest.raises(SettingsError, match=word):
            read_value("head", wrong)
    assert read_value("head", "") == ""
    printer = {**Printer(200, 200, 200).to_json(), "head": {"head": [{"low_mm": [5], "high_mm": [1]}]}}
    with pytest.raises(SettingsError, match="three numbers"):
        Printer.from_json(printer)


def test_each_printer_may_have_a_head_of_its_own():
    own = HeadModel((Box((-1, -2, 0), (1, 2, 3)),), Box((-9, 1, 2), (9, 2, 3)))
    printer = Printer(200, 200, 200, head=own)
    assert Printer.from_json(json.loads(json.dumps(printer.to_json()))) == printer
    assert "head" not in Printer(200, 200, 200).to_json()
