"""Prints from the printer's own storage: which file here is the same, and how far it is."""

from __future__ import annotations

import os

import pytest

from octoprint_moop.core.gcode.read import read_gcode
from octoprint_moop.machine.blindness import OtherFile
from octoprint_moop.machine.copies import find_copy, is_same_name
from octoprint_moop.machine.passing import Place, Reported, place

LINES = [
    "G21", "G90", "M83", "G1 Z0.3 F3000", "G1 X10 Y10", "G1 X50 Y10 E2", "G1 X50 Y30 E1", "G1 Z1.3",
    "G0 X5 Y60 ; aside", "G1 X10", "G1 Z0.3", "G1 X30 Y60 E1", "G1 X10 Y10 Z0.6", "G1 X50 Y10 E2",
]  # fmt: skip


def end_of(line: int) -> int:
    return len("\n".join(LINES[: line + 1])) + 1


@pytest.fixture
def job(tmp_path):
    path = tmp_path / "job.gcode"
    path.write_text("\n".join(LINES) + "\n")
    return path


def placed(job, done: int, most: int, position_mm, total: int | None = None) -> Place:
    total = job.stat().st_size if total is None else total
    return place(read_gcode(job), job, Reported(done, most, total, position_mm))


@pytest.mark.parametrize(
    ("done", "most", "position_mm"),
    [
        (5, 5, (50, 10, 0.3)),  # at rest at a bead's end
        (5, 7, (50, 30, 1.3)),  # lifted above one
        (5, 10, (10, 60, 0.3)),  # before the next one begins
        (6, 9, (49.96, 30.04, 0.3)),  # rounded by the firmware
        (8, 8, (5, 60, 1.3)),  # aside
    ],
)
def test_what_was_done_before_and_read_afterwards_is_known_where_the_nozzle_stands_in_the_file(
    job, done, most, position_mm
):
    found = placed(job, end_of(done), end_of(most), position_mm)
    assert found == Place(end_of(most), end_of(done), 0, True)


def test_a_printer_that_stands_where_the_file_lays_nothing_is_not_taken_for_printing_it(job):
    for elsewhere in ((50, 10, 7.0), (48, 10, 0.3), (50, 12, 0.3), (50, 10, 0.1)):
        assert not placed(job, end_of(5), end_of(6), elsewhere).known


def test_a_firmware_that_tells_what_it_has_read_in_blocks_is_not_taken_to_have_done_it(job):
    found = placed(job, end_of(13), end_of(13), (50, 30, 0.3))
    assert found.known and (found.sure_pos, found.file_pos) == (end_of(6), end_of(13))


def test_bytes_that_are_no_utf_8_are_counted_by_the_printer_as_they_are(tmp_path):
    lines = [LINES[0] + " ; Düse ±5°", *LINES[1:]]
    raw = ("\n".join(lines) + "\n").encode("latin-1")
    job = tmp_path / "latin.gcode"
    job.write_bytes(raw)
    at = raw.index(b"G1 X50 Y30 E1")
    found = placed(job, at, at, (50, 10, 0.3))
    assert found.known and found.file_pos == at + 3 * 2, "each such byte counts three in OctoPrint"
    with pytest.raises(OtherFile, match=f"{len(raw) + 1} bytes, the one of the same name here {len(raw)}"):
        placed(job, at, at, (50, 10, 0.3), total=len(raw) + 1)


def test_a_copy_has_the_size_and_a_name_that_a_printer_may_give_it(tmp_path):
    for name in ("Großer Würfel_PLA.gcode", "below/cube_of_two_colours.gcode", "cube.gco"):
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(name)
        os.utime(path, (1e9, 1e9))
    cube = tmp_path / "below/cube_of_two_colours.gcode"
    size = cube.stat().st_size
    for told in ("CUBE_O~1.GCO", "/models/cubeof~2.gco", "cube_of_two_colours.gcode", "cubeoftw.gco"):
        assert find_copy(tmp_path, told, size) == find_copy(tmp_path, told, None) == cube
    assert find_copy(tmp_path, "cube_o~1.gco", size + 1) is None
    assert find_copy(tmp_path, "tube_o~1.gco", size) is None
    newer = tmp_path / "cube_old.gcode"
    newer.write_bytes(cube.read_bytes())
    assert find_copy(tmp_path, "cube_o~1.gco", size) == newer
    assert not is_same_name("cube.gcode", "cubes.gcode") and not is_same_name("cube.gcode", "cube.txt")
