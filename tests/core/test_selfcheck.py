"""A print that goes well corrects a camera that is off; a print that fails finds the camera where it was."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from octoprint_moop.core.expected.raster import CvRenderer
from octoprint_moop.core.gcode.read import read_gcode
from octoprint_moop.core.inspection import Inspector
from octoprint_moop.demo.faults import Fault
from octoprint_moop.machine.recording import Recording

from ..recordings import make_recording

NUDGE = np.array([0.0012, -0.0017, 0.0008])  # a pixel or two at this size


def nudged(camera):
    return replace(camera, rvec=camera.rvec + NUDGE, tvec_mm=camera.tvec_mm + [0.5, -0.4, 0.6])


def inspect(folder: Path, change=nudged):
    """(checks, inspector) of a recording whose camera is thought to be where `change` has it."""
    recording = Recording.open(folder)
    header = replace(recording.header, cameras=((None, change(recording.header.camera())),))
    toolpath = read_gcode(folder / "job.gcode")
    inspector = Inspector(header, toolpath, CvRenderer(), reference_bgr=recording.reference())
    return [inspector.check(recording.frame(moment), moment) for moment in recording.moments], inspector


def off_px(camera, folder: Path) -> float:
    """How far from the camera that took the pictures it sees the print so far, px, in the median."""
    recording = Recording.open(folder)
    moment = recording.moments[-1]
    toolpath = read_gcode(folder / "job.gcode")
    shift_mm = recording.header.printer.bed.room_from_print_mm(moment.position_mm)
    points_mm = toolpath.beads_mm[: toolpath.laid_at(moment.file_pos) : 50, :3].astype(float) + shift_mm
    apart_px = np.linalg.norm(camera.project(points_mm) - recording.header.camera().project(points_mm), axis=1)
    return float(np.median(apart_px))


@pytest.fixture(scope="module")
def clean(tmp_path_factory) -> Path:
    return make_recording(tmp_path_factory.mktemp("clean") / "print", layers=10, seed=3)


def test_a_camera_that_is_off_is_told_and_corrected_for_this_print(clean):
    checks, inspector = inspect(clean)
    assert all(check.verdict == "ok" for check in checks)
    recording = Recording.open(clean)
    before_px = off_px(nudged(recording.header.camera()), clean)
    assert before_px > 1
    assert off_px(inspector.camera(recording.moments[-1]), clean) < 0.6 * before_px
    assert checks[-1].comparison.error_ratio < 0.6 * checks[2].comparison.error_ratio
    first, last = checks[2].to_json(), checks[-1].to_json()
    assert first["calibration_error_px"] is None and first["calibration"] == ""
    assert 0 <= last["calibration_error_px"] < 1 and "Corrected for this print" in last["calibration"]


def test_a_good_camera_is_told_to_fit_and_left_alone(clean):
    checks, inspector = inspect(clean, lambda camera: camera)
    assert off_px(inspector.camera(Recording.open(clean).moments[-1]), clean) < 0.1
    assert checks[-1].to_json()["calibration"].startswith("The calibration fits to 0.")


@pytest.mark.parametrize("kind", ["detachment", "extrusion_stop"])
def test_a_print_that_fails_at_once_is_caught_and_not_chased(tmp_path, kind):
    """The fault comes just when the calibration is judged."""
    folder = make_recording(tmp_path / "print", layers=10, faults=(Fault(kind, 4),), seed=3)
    checks, inspector = inspect(folder, lambda camera: camera)
    assert any(check.verdict == "failed" for check in checks)
    assert off_px(inspector.camera(Recording.open(folder).moments[-1]), folder) < 0.2
