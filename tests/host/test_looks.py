"""What is looked at, and when: the empty bed, a second time, and never what was before the printer stood still."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest

from octoprint_moop.machine.recording import Recording

from .conftest import NO_HEAD
from .room import FILAMENT_BGR, box_gcode

WARMING_UP = "G4 P1500\n"
"""No printer starts at once, as the virtual one would."""


def recording(room) -> Recording:
    """That of the newest print."""
    name = room.moop("GET", "recordings")["recordings"][0]["name"]
    return Recording.open(room.server.basedir / "data/moop/recordings" / name)


def test_the_empty_bed_is_looked_at_before_anything_lies_on_it(room):
    path = room.print(WARMING_UP + box_gcode(layers=3))
    room.wait_done()
    kept = recording(room)
    bed = kept.reference()
    assert bed is not None
    assert not (np.abs(bed.astype(int) - FILAMENT_BGR).max(axis=2) < 40).any(), "nothing was printed yet"
    assert kept.header.reference_mm == (0, 0, 0), "the printer has homed, and nothing else"
    sent = room.sent()
    ours = [n for n, (_, tags) in enumerate(sent) if any(tag.startswith("moop:settle") for tag in tags)]
    first_bead = next(n for n, (command, _) in enumerate(sent) if " E" in command)
    assert [sent[n][0] for n in ours if n < first_bead] == ["M400", "M114"]
    assert room.sent_of_file() == path.read_text().splitlines()
    assert [check["layer"] for check in room.checks] == [0, 1, 2], "it is no check"


def test_a_head_before_the_bed_is_not_taken_for_the_bed(room):
    room.save(capture="stand", head="")
    try:
        room.print("G28\nG1 X100 Y20 Z0.3 F9000\n" + WARMING_UP + box_gcode(layers=3).replace("G28\n", ""))
        room.wait_done()
    finally:
        room.save(capture="park", head=NO_HEAD)
    assert recording(room).reference() is None
    assert len(room.checks) == 3
    assert "no picture of it was taken here" in room.server.log_text()


def test_what_only_passes_by_is_looked_at_twice_and_taken_back(room):
    """One picture shows the print elsewhere; the next one, in the same hold, shows it in its place."""
    text = box_gcode(layers=8)
    odd = []

    def spoil_one_picture() -> None:
        spoils = not odd and room.sent_pos() > text.index("Z1.500")
        odd.extend([True] * spoils)
        room.webcam.slides_at = 0 if spoils else 10**9

    room.webcam.before = spoil_one_picture
    path = room.print(text)
    room.wait_done()
    assert odd and [check["layer"] for check in room.checks] == list(range(8))
    assert {check["verdict"] for check in room.checks} == {"ok"}
    assert room.sent_of_file() == path.read_text().splitlines()
    kept = recording(room)
    (second,) = [n for n, moment in enumerate(kept.moments) if moment.again]
    assert kept.moments[second - 1].file_pos == kept.moments[second].file_pos
    lines = (kept.folder / "checks.jsonl").read_text().splitlines()
    assert [json.loads(line)["verdict"] for line in lines[second - 1 : second + 1]] in (
        ["suspect", "ok"], ["failed", "ok"],
    )  # fmt: skip
    assert room.moop("GET", "recordings")["recordings"][0]["verdict"] == "ok", "nothing has gone wrong"


def test_a_failure_is_seen_in_two_pictures_before_the_print_is_paused(room):
    text = box_gcode(layers=12)
    room.webcam.slides_at = text.index("Z1.500")
    room.print(text)
    room.server.wait_state({"Paused"}, 40)
    room.wait("told", lambda: room.status["action"] == "pause")
    first, second = recording(room).moments[-2:]
    assert not first.again and second.again and first.file_pos == second.file_pos
    sent = room.sent()
    assert sum(command == "M114" and f"filepos:{second.file_pos}" in tags for command, tags in sent) == 1, "one hold"


def test_a_webcam_that_lags_behind_pauses_nothing(room):
    """Its pictures come late: while the printer stands still they show how it came there."""
    text = box_gcode(layers=6)
    plain, shown_at, late = room.webcam.jpeg, [0, 0], []

    def jpeg() -> bytes:
        file_pos = room.sent_pos()
        shown_at[:] = [file_pos, shown_at[1] + 1 if file_pos == shown_at[0] else 0]
        picture = plain()
        if file_pos < text.index("Z0.900") or shown_at[1] > 3:
            return picture
        late.append(file_pos)
        frame = cv2.imdecode(np.frombuffer(picture, np.uint8), cv2.IMREAD_COLOR)
        moved = np.roll(frame, 25 * (4 - shown_at[1]), axis=1)
        return cv2.imencode(".jpg", moved)[1].tobytes()

    room.webcam.jpeg = jpeg
    path = room.print(text)
    room.wait_done()
    assert len(set(late)) >= 3
    assert room.status["action"] == "none"
    assert room.sent_of_file() == path.read_text().splitlines()


def test_a_second_picture_that_does_not_come_pauses_nothing(room):
    text = box_gcode(layers=8)
    at = text.index("Z1.500")
    asked = []

    def second_does_not_come() -> None:
        file_pos = room.sent_pos()
        if file_pos > at:
            room.webcam.answer = "404" if file_pos in asked else "picture"
            asked.append(file_pos)

    room.webcam.slides_at = at
    room.webcam.before = second_does_not_come
    room.print(text)
    room.wait_done()
    doubted = [check for check in room.checks if "No second picture confirms it" in check["reason"]]
    assert doubted and {check["verdict"] for check in doubted} == {"suspect"}
    assert room.status["action"] == "none"


@pytest.mark.parametrize("select", [False, True])
def test_a_file_is_read_when_it_is_uploaded_and_not_first_when_it_is_printed(room, select):
    from benchmarks.host_stall import large_gcode

    path = room.folder / f"ahead_{select}.gcode"
    path.write_text(f"; {select}\n" + large_gcode(150_000))
    cache = room.server.basedir / "data/moop/cache"
    before = {entry.name for entry in cache.iterdir()}
    with path.open("rb") as file:
        room.server.api(
            "POST", "/api/files/local", files={"file": (path.name, file)}, timeout_s=60.0,
            data={"select": str(select).lower(), "print": "false"},
        )  # fmt: skip
    room.wait(
        "it is read", lambda: {entry.name for entry in cache.iterdir()} - before and room.status["reading"] is None
    )


def test_a_large_file_that_is_printed_at_once_prints_at_once_and_is_watched_when_it_is_read(room):
    from benchmarks.host_stall import large_gcode

    path = room.folder / "large.gcode"
    path.write_text(large_gcode(600_000))
    assert path.stat().st_size > 6_000_000
    room.webcam.look_at(path)
    room.webcam.mask(0)  # drawn before anybody waits for it
    room.server.upload(path)
    room.wait("it is told to be read", lambda: room.status["job"] == path.name and room.status["reading"])
    assert room.status["blind_code"] == "reading"
    before = room.sent_pos()
    room.wait("the print goes on meanwhile", lambda: room.sent_pos() > before)
    room.wait("watched", lambda: room.status["watching"] and room.status["job"] == path.name, 120)
    assert room.wait_checks(1)[0]["verdict"] == "ok"
