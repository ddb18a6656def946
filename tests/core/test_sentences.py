"""The millimetres in the sentences, against where the demo's painter really put the matter."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from octoprint_moop.core.checks import Check
from octoprint_moop.core.expected.raster import CvRenderer
from octoprint_moop.core.gcode.read import read_gcode
from octoprint_moop.core.inspection import Inspector
from octoprint_moop.demo.faults import Fault, matter_at
from octoprint_moop.machine.recording import Recording

from ..recordings import make_recording

ONSET = 10
WAYS = {"right": (0, 1), "left": (0, -1), "back": (1, 1), "front": (1, -1)}


def failed(folder: Path, fault: Fault, seed: int) -> tuple[Check, np.ndarray]:
    """The first failed check, and by how much (x, y mm) what moved has truly moved."""
    make_recording(folder, layers=13, faults=(fault,), seed=seed)
    recording, toolpath = Recording.open(folder), read_gcode(folder / "job.gcode")
    inspector = Inspector(recording.header, toolpath, CvRenderer(), reference_bgr=recording.reference())
    checks = [inspector.check(recording.frame(moment), moment) for moment in recording.moments]
    first = next(check for check in checks if check.verdict == "failed")
    matter = matter_at(toolpath, (fault,), toolpath.laid_at(first.moment.file_pos), seed)
    before = matter.bead < toolpath.layer_start[ONSET]
    kept = before if fault.kind == "detachment" else ~before
    moved_mm = (matter.ends_mm - toolpath.beads_mm[matter.bead, :6])[kept]
    moved_mm = (moved_mm[:, :2] + moved_mm[:, 3:5]) / 2
    return first, moved_mm[np.abs(moved_mm).max(axis=1) > 0.05].mean(axis=0)


@pytest.mark.parametrize(("kind", "seed"), [("layer_shift", 2), ("layer_shift", 11), ("detachment", 2)])
def test_how_far_and_where_to_is_what_the_painter_drew(tmp_path, kind, seed):
    fault = Fault(kind, ONSET, object_id=None if kind == "layer_shift" else 0, strength=1.4)
    check, truth_mm = failed(tmp_path / "print", fault, seed)
    assert (check.mode, check.moment.layer) == (kind, ONSET)
    said_mm = float(re.search(r"about ([\d.]+) mm", check.reason)[1])
    assert said_mm == pytest.approx(np.hypot(*truth_mm), rel=0.25)
    ways = re.findall("right|left|back|front", check.reason)
    axis = int(np.abs(truth_mm).argmax())
    assert (axis, int(np.sign(truth_mm[axis]))) in [WAYS[way] for way in ways]
    assert all(truth_mm[WAYS[way][0]] * WAYS[way][1] > 0 for way in ways)
    if kind == "layer_shift":
        assert f"above layer {ONSET} " in check.reason
