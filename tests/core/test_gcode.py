"""Reading G-code: what a file says, and what the printer will do with it."""

from __future__ import annotations

import json

import numpy as np
import pytest

from octoprint_moop.core.errors import GcodeError
from octoprint_moop.core.gcode import read_gcode


@pytest.mark.parametrize("case", ["cube-clean", "detach-bedslinger", "dtu-paper", "multi-object"])
def test_a_layer_ends_where_its_last_bead_ends(shared, case):
    folder = shared / "cases" / case
    truth = json.loads((folder / "truth.json").read_text())
    frames = [json.loads(line) for line in (folder / "frames.jsonl").read_text().splitlines()]
    toolpath = read_gcode(folder / "job.gcode")
    assert toolpath.layers == truth["layers"]
    assert set(toolpath.objects) == set(truth["objects"])
    ends = toolpath.end_pos[toolpath.layer_start[1:] - 1]
    np.testing.assert_array_equal(ends, [frame["file_pos"] for frame in frames])
    assert (toolpath.layer_end_pos >= ends).all()
    assert (toolpath.layer_end_pos[:-1] < toolpath.end_pos[toolpath.layer_start[1:-1]]).all()


@pytest.mark.parametrize(
    ("content", "word"),
    [
        (b"", "empty"),
        (b"GCDE\x01\x00\x00\x00", "binary G-code"),
        (b"PK\x03\x04rest", "zip"),
        (b"\x7fELF\x00\x00", "not a text file"),
        (b"G28\nG1 X10 Y10\nG1 E5\n", "extrudes nothing"),
    ],
)
def test_what_is_no_gcode_is_refused_with_a_sentence(tmp_path, content, word):
    path = tmp_path / "job.gcode"
    path.write_bytes(content)
    with pytest.raises(GcodeError, match=word):
        read_gcode(path)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(GcodeError, match=r"nowhere\.gcode"):
        read_gcode(tmp_path / "nowhere.gcode")


def test_a_layer_that_the_file_parks_after_ends_at_the_park_and_not_at_a_travel_across_the_print(tmp_path):
    square = "G1 X110 Y100 E1\nG1 X110 Y110 E1\nG1 X100 Y110 E1\nG1 X100 Y100 E1\n"
    first = "M83\nG1 X100 Y100 Z0.2\n" + square + "G1 E-1 F2400\n"
    parked = first + "G1 Z0.4\nG1 X0 Y200 F7800\n"
    second = parked + "G1 X100 Y100\nG1 E1\n" + square
    crossed = second + "G1 E-1\n"
    path = tmp_path / "job.gcode"
    path.write_text(crossed + "G1 Z0.6\nG1 X118 Y100\nG1 X100 Y100\nG1 E1\n" + square)
    assert read_gcode(path).layer_end_pos[:2].tolist() == [len(parked), len(crossed)]
