"""The whole road from frame to verdict, on prints painted by the demo's simulated webcam."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from octoprint_moop.core.expected.raster import CvRenderer
from octoprint_moop.core.gcode.read import read_gcode
from octoprint_moop.core.inspection import Inspector
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
