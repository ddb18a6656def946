"""The whole road from frame to verdict, on prints painted by the demo's simulated webcam."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from octoprint_moop.core import inspection
from octoprint_moop.core.decision.memory import Memory
from octoprint_moop.core.decision.telling import unseen_and_unmissed
from octoprint_moop.core.expected.raster import CvRenderer
from octoprint_moop.core.gcode.read import read_gcode
from octoprint_moop.core.header import Moment
from octoprint_moop.core.inspection import Inspector
from octoprint_moop.core.segmentation.segment import HsvThresholds
from octoprint_moop.core.settings import Settings
from octoprint_moop.core.view.stabilise import Stabiliser
from octoprint_moop.demo.faults import Fault
from octoprint_moop.machine.recording import Recording

from ..recordings import make_recording

FAULT_LAYER = 7


def checks(folder: Path, after_failure: str = ""):
    """All checks; after the first that failed the user does what `after_failure` names."""
    recording = Recording.open(folder)
    inspector = Inspector(
        recording.header, read_gcode(folder / "job.gcode"), CvRenderer(), reference_bgr=recording.reference()
    )
    found = []
    for moment in recording.moments:
        found.append(inspector.check(recording.frame(moment), moment))
        if after_failure and found[-1].verdict == "failed" and sum(one.verdict == "failed" for one in found) == 1:
            getattr(inspector, after_failure)()
    return found


@pytest.fixture(scope="module")
def clogged(tmp_path_factory) -> Path:
    fault = Fault("extrusion_stop", FAULT_LAYER, object_id=0)
    return make_recording(tmp_path_factory.mktemp("clogged") / "print", layers=18, faults=(fault,), seed=6)


def test_a_clog_is_caught_once_it_shows_and_stays_a_failure_while_nobody_says_otherwise(clogged):
    verdicts = [check.verdict for check in checks(clogged)]
    first = verdicts.index("failed")
    assert FAULT_LAYER <= first <= FAULT_LAYER + 3
    assert set(verdicts[first:]) == {"failed"}


def test_once_the_view_was_lost_nothing_fails_until_something_tells_where_the_camera_stands(clogged, monkeypatch):
    frames, measure = iter(range(99)), Stabiliser.turn
    lost_at, found_at = FAULT_LAYER - 1, FAULT_LAYER + 6

    def turn(self, *look):
        found, frame = measure(self, *look), next(frames)
        self.lost, self.sure = frame == lost_at, not lost_at <= frame < found_at
        return found

    monkeypatch.setattr(Stabiliser, "turn", turn)
    verdicts = [check.verdict for check in checks(clogged)]
    assert verdicts[lost_at] == "camera_moved" and verdicts.index("failed") >= found_at


def test_dark_filament_on_a_dark_sheet_is_unusable_with_the_reason(tmp_path):
    """It cannot be seen whether such a print is there, so neither "all is well" nor "it is gone" would be true."""
    folder = make_recording(tmp_path / "print", layers=8, seed=6, material_bgr=(48.0, 45.0, 45.0), surface="sheet")
    recording = Recording.open(folder)
    inspector = Inspector(
        replace(recording.header, material=None), read_gcode(folder / "job.gcode"), CvRenderer(),
        reference_bgr=recording.reference(),
    )  # fmt: skip
    found = [inspector.check(recording.frame(moment), moment) for moment in recording.moments]
    assert "failed" not in {check.verdict for check in found}
    assert found[-1].verdict == "unusable" and "look alike" in found[-1].reason


@pytest.mark.parametrize("faults, said", [((), "unusable"), ((Fault("extrusion_stop", 0),), "failed")])
def test_filament_hardly_brighter_than_the_bed_is_told_from_nothing_at_all(tmp_path, faults, said):
    """No single pixel of either differs from the bare bed by more than noise and light may; all of them together do."""
    folder = make_recording(
        tmp_path / "print", layers=4, faults=faults, material_bgr=(64.0, 64.0, 64.0), surface="sheet"
    )
    recording = Recording.open(folder)
    inspector = Inspector(
        replace(recording.header, material=None), read_gcode(folder / "job.gcode"), CvRenderer(),
        reference_bgr=recording.reference(),
    )  # fmt: skip
    verdicts = {inspector.check(recording.frame(moment), moment).verdict for moment in recording.moments}
    assert said in verdicts and not verdicts & {"failed", "suspect", "unusable"} - {said, "suspect" if faults else said}


@pytest.mark.parametrize("what", ["accept", "pardon"])
def test_after_the_user_goes_on_the_same_state_does_not_fail_again(clogged, what):
    found = checks(clogged, after_failure=what)
    assert [check.verdict for check in found].count("failed") == 1
    assert found[-1].verdict == "ok"


def test_after_the_user_goes_on_a_new_failure_of_another_object_is_still_caught(tmp_path):
    faults = (Fault("extrusion_stop", 5, object_id=0), Fault("detachment", 13, object_id=1))
    folder = make_recording(tmp_path / "print", layers=16, faults=faults, seed=6)
    found = checks(folder, after_failure="accept")
    later = [check for check in found[13:] if check.verdict == "failed"]
    assert later and later[0].moment.layer <= 14
    assert [one["name"] for one in later[0].objects if one["verdict"] == "failed"] == [found[0].objects[1]["name"]]


def test_accepting_before_anything_was_checked_changes_nothing(clogged):
    recording = Recording.open(clogged)
    inspector = Inspector(recording.header, read_gcode(clogged / "job.gcode"), CvRenderer())
    inspector.accept()
    inspector.pardon()
    assert inspector.check(recording.frame(recording.moments[0]), recording.moments[0]).verdict == "ok"


def test_two_cameras_each_have_a_past_of_their_own(tmp_path):
    """Their frames come in turn; what is usual for the one would be a jump for the other."""
    fault = Fault("detachment", 9)
    near, far = (make_recording(tmp_path / name, layers=12, faults=(fault,), seed=6) for name in ("near", "far"))
    recording = Recording.open(near)
    camera = recording.header.camera()
    aside = replace(camera, tvec_mm=camera.tvec_mm + [6.0, 4.0, 0.0])  # of which nobody told the inspector: a misfit
    header = replace(recording.header, cameras=((None, camera), ("second", aside)))
    inspector = Inspector(header, read_gcode(near / "job.gcode"), CvRenderer(), reference_bgr=recording.reference())
    verdicts = []
    for moment, other in zip(recording.moments, Recording.open(far).moments):
        verdicts.append(inspector.check(recording.frame(moment), moment).verdict)
        inspector.check(Recording.open(far).frame(other), replace(other, camera="second"))
    assert verdicts[:9] == ["ok"] * 9
    assert verdicts[9] == "failed"


@pytest.fixture(scope="module")
def detached(tmp_path_factory) -> Path:
    return make_recording(
        tmp_path_factory.mktemp("detached") / "print", layers=14, faults=(Fault("detachment", 10),), seed=2
    )


def inspected(folder: Path, upto: int) -> tuple[Inspector, Recording]:
    recording = Recording.open(folder)
    inspector = Inspector(
        recording.header, read_gcode(folder / "job.gcode"), CvRenderer(), reference_bgr=recording.reference()
    )
    for moment in recording.moments[:upto]:
        inspector.check(recording.frame(moment), moment)
    return inspector, recording


def noisy(frame, seed):
    """The same state, another exposure."""
    noise = np.random.default_rng(seed).normal(0, 2.0, frame.shape)
    return np.clip(frame + noise, 0, 255).astype(np.uint8)


def test_a_failure_that_a_second_frame_shows_too_is_confirmed(detached):
    inspector, recording = inspected(detached, 10)
    moment = recording.moments[10]
    first = inspector.check(recording.frame(moment), moment)
    second = inspector.confirm(noisy(recording.frame(moment), 1), moment)
    assert (first.verdict, second.verdict, second.mode) == ("failed", "failed", "detachment")


def test_a_failure_that_a_second_frame_does_not_show_is_taken_back_and_the_print_goes_on_as_if_it_had_not_been(clogged):
    """For one frame the print looks as it did eight layers ago: as if all since had not come."""
    inspector, recording = inspected(clogged, 7)
    moment, old = recording.moments[6], recording.moments[0]
    state = replace(moment, frame="again.jpg")
    first = inspector.check(noisy(recording.frame(old), 1), state)
    assert first.verdict in ("failed", "suspect")
    assert inspector.confirm(noisy(recording.frame(moment), 2), state).verdict == "ok"
    assert inspector.check(noisy(recording.frame(moment), 3), moment).verdict == "ok"


def test_a_failure_whose_second_frame_is_black_is_suspect_and_the_next_layer_tells(detached):
    inspector, recording = inspected(detached, 10)
    moment, following = recording.moments[10:12]
    assert inspector.check(recording.frame(moment), moment).verdict == "failed"
    second = inspector.confirm(np.zeros_like(recording.frame(moment)), moment)
    assert (second.verdict, second.mode) == ("suspect", None)
    assert inspector.check(recording.frame(following), following).verdict == "failed"


def test_a_line_that_says_again_is_a_second_look_in_a_replay_too(detached):
    """A recording keeps both frames of a hold; what follows from them must be what followed live."""
    live, recording = inspected(detached, 10)
    offline, _ = inspected(detached, 10)
    moment = recording.moments[10]
    frames = recording.frame(moment), noisy(recording.frame(moment), 4)
    live.check(frames[0], moment)
    offline.check(frames[0], moment)
    line = json.loads(json.dumps({**moment.to_json(), "again": True}))
    assert replace(offline.check(frames[1], Moment.from_json(line)), ms=0) == replace(
        live.confirm(frames[1], moment), ms=0
    )


def test_what_seems_hidden_check_after_check_is_judged_in_the_end(detached, monkeypatch):
    """A hand does not rest at one spot for layers: what was taken for hidden may as well be gone."""

    inspector, recording = inspected(detached, 8)
    found = inspection.find
    monkeypatch.setattr(inspection, "find", lambda *seen: replace(found(*seen), hidden_px=100_000))
    verdicts = [inspector.check(recording.frame(moment), moment).verdict for moment in recording.moments[8:14]]
    assert verdicts == ["unusable"] * 5 + ["suspect"]  # it has come off at layer 10


def test_once_a_camera_is_known_to_be_pixels_off_filament_is_looked_for_where_it_lies(tmp_path):
    """Colours that are learned where the print is not would spoil all that follows."""
    recording = Recording.open(make_recording(tmp_path / "print", layers=3, seed=6))
    toolpath = read_gcode(recording.folder / "job.gcode")
    camera = recording.header.camera()
    off = replace(camera, K=camera.K + [[0, 0, 3.0], [0, 0, -2.0], [0, 0, 0]])
    header = replace(recording.header, material=None, cameras=((None, off),))
    inspector, true = (
        Inspector(one, toolpath, CvRenderer(), reference_bgr=recording.reference())
        for one in (header, recording.header)
    )
    for moment in recording.moments:
        assert inspector.check(recording.frame(moment), moment).verdict == "ok"
    lies, seen = true.expected(moment).mask > 0, inspector.pictures.observed > 0
    assert np.count_nonzero(lies != seen) < 0.05 * np.count_nonzero(lies)


@pytest.mark.parametrize("thresholds", [HsvThresholds(100, 140, 0.5, 0.3), HsvThresholds(0, 360, 0.0, 0.0)])
def test_a_print_that_cannot_be_told_from_the_bed_is_not_said_to_be_well(clogged, thresholds):
    """Thresholds that no filament here meets, and ones that everything meets."""
    recording = Recording.open(clogged)
    inspector = Inspector(
        replace(recording.header, material=thresholds), read_gcode(clogged / "job.gcode"), CvRenderer(),
        Settings(segmentation="thresholds"), recording.reference(),
    )  # fmt: skip
    found = [inspector.check(recording.frame(moment), moment) for moment in recording.moments[:4]]
    assert {check.verdict for check in found} == {"unusable"}
    assert "look alike" in found[-1].reason


@pytest.mark.parametrize(
    "seen_rows, lost_px, unknown",
    [(9, 0, False), (1, 0, True), (1, 400, False)],
    ids=["most is seen", "hardly any is seen and nothing says that it is gone", "it is known to be gone"],
)
def test_what_is_neither_seen_nor_missed_is_not_known_to_be_well(seen_rows, lost_px, unknown):
    wanted, seen = np.zeros((40, 40), bool), np.zeros((40, 40), bool)
    wanted[10:30, 10:30] = True
    seen[10 : 10 + 2 * seen_rows, 10:30] = True
    window = (slice(0, 40), slice(0, 40))
    whole = SimpleNamespace(lost_px=lost_px, stray_px=0, unseen_px=0, barren_px=0)
    findings = SimpleNamespace(wanted=wanted, seen=seen, known=np.ones_like(wanted), window=window, whole=whole)
    assert unseen_and_unmissed(findings, Memory(None, (40, 40))) is unknown


def test_a_print_that_lies_beside_the_picture_is_not_said_to_be_well(clogged):
    recording = Recording.open(clogged)
    (name, camera), *_ = recording.header.cameras
    away = replace(camera, tvec_mm=camera.tvec_mm + [1000.0, 0.0, 0.0])
    header = replace(recording.header, cameras=((name, away),))
    inspector = Inspector(header, read_gcode(clogged / "job.gcode"), CvRenderer(), reference_bgr=recording.reference())
    for moment in recording.moments[:3]:
        check = inspector.check(recording.frame(moment), moment)
        assert (check.verdict, check.comparison.total_px) == ("unusable", 0)
        assert check.reason.startswith("Nothing of the print is in view")


def test_what_lies_above_a_layer_is_drawn_once_whichever_of_the_objects_is_asked_about(tmp_path):
    folder = make_recording(tmp_path / "shifted", layers=11, faults=(Fault("layer_shift", 8, object_id=None),), seed=2)
    recording, drawn = Recording.open(folder), []

    class Counting(CvRenderer):
        def birth_map(self, toolpath, camera, room_from_print_mm, beads=None):
            drawn.append(None if beads is None else beads.tobytes())
            return super().birth_map(toolpath, camera, room_from_print_mm, beads)

    inspector = Inspector(
        recording.header, read_gcode(folder / "job.gcode"), Counting(), reference_bgr=recording.reference()
    )
    wrong = 0
    for moment in recording.moments:
        drawn.clear()
        check = inspector.check(recording.frame(moment), moment)
        wrong = max(wrong, sum(one["verdict"] != "ok" for one in check.objects))
        assert len(drawn) == len(set(drawn))
    assert wrong > 1


def test_a_camera_that_was_turned_away_says_so_at_every_layer_until_it_is_back(clogged):
    """What it shows then is another part of the room; no failure follows from that."""
    recording = Recording.open(clogged)
    inspector = Inspector(
        recording.header, read_gcode(clogged / "job.gcode"), CvRenderer(), reference_bgr=recording.reference()
    )
    verdicts = []
    for number, moment in enumerate(recording.moments[:FAULT_LAYER]):
        frame = recording.frame(moment)
        away = number in (3, 4)
        verdicts.append(inspector.check(frame[::-1, ::-1] if away else frame, moment).verdict)
    assert verdicts == ["ok", "ok", "ok", "camera_moved", "camera_moved", "ok", "ok"]


def test_a_verdict_waits_for_nothing_that_it_teaches(clogged, monkeypatch):
    recording, learned = Recording.open(clogged), []
    inspector = Inspector(recording.header, read_gcode(clogged / "job.gcode"), CvRenderer())
    monkeypatch.setattr(Memory, "learn", lambda self, *seen: learned.append(self))
    assert inspector.check(recording.frame(recording.moments[0]), recording.moments[0]).verdict == "ok"
    assert not learned
    inspector.learn()
    inspector.learn()
    assert len(learned) == 1


def test_whoever_is_asked_next_has_learned_first_what_the_last_check_taught(clogged):
    """Whether somebody had it learned in between, as the live print has, or nobody, as in a replay, is all one."""
    recording, found = Recording.open(clogged), []
    for at_once in (False, True):
        inspector = Inspector(recording.header, read_gcode(clogged / "job.gcode"), CvRenderer())
        found.append([])
        for number, moment in enumerate(recording.moments[:9]):
            found[-1].append(replace(inspector.check(recording.frame(moment), moment), ms=0))
            if at_once:
                inspector.learn()
            if number == 4:
                inspector.accept()
                found[-1].append(replace(inspector.confirm(recording.frame(moment), moment), ms=0))
    assert found[0] == found[1]
