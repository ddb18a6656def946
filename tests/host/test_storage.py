"""Prints that the printer reads from its own storage: looked at by the clock where the same file is here."""

from __future__ import annotations

import pytest

from octoprint_moop.core.gcode.read import read_gcode
from octoprint_moop.machine.recording import Recording

from .room import box_gcode


def stepping_aside(layers: int = 20) -> str:
    """A small box; after each layer the head goes aside, slowly."""
    lines = []
    for line in box_gcode(layers=layers, side_mm=20, lines_per_side=1).splitlines():
        if " Z" in line and "F12000" in line:
            lines += [
                "G1 X195 F400"
            ] * 7  # what is behind a move in the printer's buffer is done before it stands still
        lines.append(line)
    return "\n".join(lines) + "\n"


@pytest.fixture
def by_clock(room, saved):
    """Look as often as can be; what the webcam sees follows what the printer says that it has read."""
    saved(longest_s=0.2, capture="stand")
    told = room.webcam.file_pos
    room.webcam.file_pos = lambda: room.server.api("GET", "/api/job")["progress"]["filepos"] or 0
    yield room
    room.webcam.file_pos = told


def same_here(room, text: str, name: str, printed: str | None = None) -> tuple[str, str]:
    """A file here, and one of its name in the printer's storage."""
    path = room.folder / name
    path.write_text(text)
    room.webcam.look_at(path)
    room.server.upload(path, print=False)
    return room.store(printed or text, name)


def test_a_print_whose_file_is_here_too_is_looked_at_by_the_position_that_the_printer_reports(by_clock):
    room, text = by_clock, stepping_aside()
    room.print_stored(*same_here(room, text, "stored_box.gcode"))
    assert room.status["blind_code"] in ("reading", "not_local")
    checks = room.wait_checks(2)
    assert room.status["road"] == "bytes" and "ok" in [check["verdict"] for check in checks]
    assert {check["verdict"] for check in checks} <= {"ok", "unusable"}, checks  # where the head hides it
    assert max(check["E"] or 0 for check in checks) < 0.08
    assert [check["layer"] for check in checks] == sorted({check["layer"] for check in checks})
    name = room.moop("GET", "recordings")["recordings"][0]["name"]
    moments = Recording.open(room.server.basedir / "data/moop/recordings" / name).moments
    toolpath = read_gcode(room.folder / "stored_box.gcode")
    aside = [moment for moment in moments if moment.position_mm[0] == 195]
    assert aside and {moment.parked for moment in aside} == {True}
    for moment in moments:
        assert 0 <= toolpath.laid_at(moment.file_pos) - toolpath.laid_at(moment.sure_pos) < 8
    room.webcam.slides_at = 0
    room.server.wait_state({"Paused"}, 30)
    assert room.status["action"] == "pause"


def test_another_file_of_the_same_name_and_size_is_found_out_and_nothing_is_judged_by_it(by_clock):
    room, text = by_clock, stepping_aside()
    printed = text.replace("X195", "X194").replace("X90.", "X91.").replace("X110.", "X111.")
    assert len(printed) == len(text)
    room.print_stored(*same_here(room, text, "another_box.gcode", printed))
    room.wait("found out", lambda: "prints another one" in (room.status["blind"] or ""))
    assert room.checks == [] and room.status["blind_code"] == "not_local"
