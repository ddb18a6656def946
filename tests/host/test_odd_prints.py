"""Printers, files and disks that are not as they should be: the print goes on, and the next one is watched again."""

from __future__ import annotations

import json
import math
import os
import resource
import shutil
import signal
import time
from pathlib import Path

import pytest

from octoprint_moop.core.gcode.read import read_gcode

from .conftest import NO_HEAD
from .room import SLOWLY, box_gcode
from .test_faults import eye_pids


def watched_well(room, layers: int) -> None:
    """A print like any other is watched from its first layer to its last."""
    path = room.print(box_gcode(layers=layers))
    room.wait_done()
    assert [check["layer"] for check in room.wait_checks(layers)] == list(range(layers))
    assert room.sent_of_file() == path.read_text().splitlines()


def test_a_printer_that_never_reports_its_position_prints_on_unwatched(room):
    room.reconnect(m114FormatString="no position")
    room.save(settle_timeout_s=1)
    try:
        path = room.print(box_gcode(layers=3))
        room.wait("said", lambda: "did not report its position" in (room.status["blind"] or ""))
        room.wait_done()
        assert room.checks == []
        assert room.sent_of_file() == path.read_text().splitlines()
        ours = {command for command, tags in room.sent() if any(tag.startswith("moop:") for tag in tags)}
        assert ours == {"M400", "M114"}, "nothing is moved while nobody knows from where"
    finally:
        room.save(settle_timeout_s=5)
        room.reconnect(m114FormatString="X:{x} Y:{y} Z:{z} E:{e[current]} Count: A:{a} B:{b} C:{c}")
    watched_well(room, 2)


def test_lines_that_the_printer_asks_for_again_are_watched_all_the_same(room):
    room.reconnect(simulated_errors=["60:resend", "90:resend", "150:resend"])
    try:
        room.print(box_gcode(layers=3))
        room.wait_done()
        assert [check["layer"] for check in room.checks] == [0, 1, 2]
        assert {check["verdict"] for check in room.checks} == {"ok"}
    finally:
        room.reconnect(simulated_errors=[])


def test_bytes_that_are_no_utf_8_do_not_shift_the_layers(room):
    text = box_gcode(layers=4).encode()
    lines = text.split(b"\n")
    for n in range(3, len(lines), 7):
        lines[n] += " ; Düsenprüfung ±5°".encode("latin-1")
    room.print(b"\n".join(lines))
    room.wait_done()
    assert [check["layer"] for check in room.checks] == [0, 1, 2, 3]
    assert {check["verdict"] for check in room.checks} == {"ok"}


def test_a_print_that_starts_in_the_middle_of_its_file_is_watched_from_there(room):
    text = box_gcode(layers=6)
    pos = text.index("\n", text.index("Z0.900")) + 1  # within layer 2
    room.print(text, from_pos=pos)
    room.wait_done()
    assert [check["layer"] for check in room.checks] == [2, 3, 4, 5]


def test_a_pause_that_the_file_asks_for_is_not_ours_and_loses_nothing(room):
    lines = box_gcode(layers=4).splitlines()
    at = next(n for n, line in enumerate(lines) if "Z0.900" in line)
    room.print("\n".join([*lines[:at], "@pause", *lines[at:]]) + "\n")
    room.server.wait_state({"Paused"}, 30)
    assert room.status["action"] == "none"
    room.command(command="pause", action="resume")
    room.wait_done()
    assert [check["layer"] for check in room.checks] == [0, 1, 2, 3]
    assert room.sent_of_file() == lines


@pytest.mark.parametrize("by", ["replaced", "deleted"])
def test_a_file_that_is_replaced_or_deleted_while_it_is_printed_is_still_watched_even_by_a_new_eye(room, by):
    path = room.print(box_gcode(layers=40, feed_mm_min=SLOWLY))
    room.wait_checks(2)
    printed = room.server.basedir / "uploads" / path.name
    if by == "replaced":
        (room.folder / "other.gcode").write_text("; something else by now\n")
        os.replace(room.folder / "other.gcode", printed)
    else:
        printed.unlink()
    for pid in eye_pids(room):
        os.kill(pid, signal.SIGKILL)
    count = len(room.checks)
    room.wait_checks(count + 2)
    assert {check["verdict"] for check in room.checks} == {"ok"}


def test_a_file_that_is_written_over_while_it_is_printed_is_said_to_be_another(room):
    """What is sent then are lines that nobody has read, at positions that mean nothing."""
    text = box_gcode(layers=40, feed_mm_min=SLOWLY)
    path = room.print(text)
    room.wait_checks(2)
    with (room.server.basedir / "uploads" / path.name).open("r+") as file:
        half = text.index("\n", len(text) // 4) + 1
        file.seek(half)
        file.write(text[half:].replace("\n", " \n"))
    room.wait("said", lambda: room.status["blind_code"] == "file_changed")
    assert "do not match the file" in room.status["blind"] and room.status["action"] == "none"
    room.command(command="cancel")
    room.server.wait_state({"Operational"}, 10)


def test_a_recording_that_cannot_be_written_costs_the_recording_alone(room):
    recordings = room.server.basedir / "data" / "moop" / "recordings"
    aside = recordings.with_name("aside")
    recordings.mkdir(parents=True, exist_ok=True)
    shutil.move(recordings, aside)
    recordings.write_text("a file where a folder should be")
    try:
        room.print(box_gcode(layers=2))
        room.wait_done()
        assert len(room.checks) == 2
        assert room.status["not_recorded"].startswith("This print is not recorded: ")
    finally:
        recordings.unlink()
        shutil.move(aside, recordings)


def test_settings_saved_in_the_middle_of_a_check_hold_for_the_next(room):
    path = room.print(box_gcode(layers=5, feed_mm_min=SLOWLY))
    room.wait_checks(1)
    room.webcam.answer = "slow"
    served = room.webcam.served
    room.wait("a picture is asked for", lambda: room.webcam.served > served)
    room.save(sensitivity="low", settle_s=0.1)
    room.webcam.answer = "picture"
    room.wait_done()
    room.save(sensitivity="medium", settle_s=0.0)
    assert room.sent_of_file() == path.read_text().splitlines()
    assert {check["verdict"] for check in room.checks} == {"ok"}
    assert room.checks[-1]["layer"] == 4


def test_a_timelapse_that_takes_its_pictures_at_the_same_moments_does_not_matter(room):
    room.server.api("POST", "/api/timelapse", json={"type": "zchange", "fps": 25, "postRoll": 0})
    try:
        watched_well(room, 5)
    finally:
        room.server.api("POST", "/api/timelapse", json={"type": "off"})


@pytest.mark.parametrize("text", ["", "; nothing but a comment\n", "M105\nM105\n", "G28\nG1 X10 Y10 F3000\n"])
def test_a_file_that_extrudes_nothing_is_printed_and_said_not_to_be_watched(room, text):
    room._prints += 1
    path = room.folder / f"odd_{room._prints}.gcode"
    path.write_text(text)
    answer = room.server.request("POST", "/api/files/local", files={"file": (path.name, text or " ")}, data={
        "select": "true", "print": "true"})  # fmt: skip
    assert answer.ok
    time.sleep(1)
    room.server.wait_state({"Operational"}, 20)
    assert room.status["checks"] == 0
    assert not room.status["watching"]


def test_another_plugin_that_holds_the_print_for_its_own_pictures_does_not_matter(room):
    """As Octolapse makes stabilised timelapses: it swallows lines, moves the head, asks where it is, sends the lines again."""
    room.server.api("POST", "/api/plugin/spy", json={"command": "stabilise", "on": True})
    try:
        path = room.print(box_gcode(layers=5))
        room.wait_done()
        assert [check["layer"] for check in room.wait_checks(5)] == list(range(5))
        assert {check["verdict"] for check in room.checks} == {"ok"}
        assert room.server.api("GET", "/api/plugin/spy")["snapped"] >= 5
        of_file = [
            command
            for command, tags in room.sent()
            if "spy:again" in tags or ("source:file" in tags and not any(tag.startswith("moop:") for tag in tags))
        ]
        assert of_file == path.read_text().splitlines()
    finally:
        room.server.api("POST", "/api/plugin/spy", json={"command": "stabilise", "on": False})


def test_other_plugins_are_helped(room):
    helped = room.server.api("GET", "/api/plugin/spy")
    assert helped["status"]["blind_code"] == "idle" and helped["check_now"] is False


def test_layers_of_less_than_a_second_are_each_looked_at(room):
    began_s = time.monotonic()
    path = room.print("G4 P1500\n" + box_gcode(layers=8, side_mm=8, lines_per_side=1))
    room.wait_done()
    assert time.monotonic() - began_s < 30
    assert [check["layer"] for check in room.wait_checks(8)] == list(range(8))
    times_s = [moment["time_s"] for moment in moments(room)]
    assert min(late - early for early, late in zip(times_s, times_s[1:])) < 1.0
    assert room.sent_of_file() == path.read_text().splitlines()


def test_a_tool_change_and_a_filament_change_in_the_file_lose_nothing(room):
    """M600 makes the firmware pause and wait for its user, whom M876 is told by."""
    lines = box_gcode(layers=6).splitlines()
    ends = [n for n, line in enumerate(lines) if " Z" in line and "F12000" in line]
    lines.insert(ends[4], "M600")
    lines[ends[2] : ends[2]] = ["T1", "T0"]
    room.print("\n".join(lines) + "\n")
    room.server.wait_state({"Paused"}, 30)
    assert room.status["action"] == "none"
    room.server.api("POST", "/api/printer/command", json={"command": "M876 S0"})
    room.server.api("POST", "/api/printer/command", json={"command": "!!DEBUG:unbusy"})
    room.command(command="pause", action="resume")
    room.wait_done()
    assert [check["layer"] for check in room.checks] == list(range(6))
    assert {check["verdict"] for check in room.checks} == {"ok"}
    lines.remove("T1")  # of which OctoPrint knows that this printer has none
    assert room.sent_of_file() == lines


def test_one_layer_that_takes_long_is_looked_at_by_the_clock(room, saved):
    """A vase, or one layer over the whole bed: there is no layer's end to look at, but each line's state is known."""
    saved(longest_s=1, every_layers=1000)
    turns, lines = 6, ["G21", "G90", "M83", "G28", "G4 P1500", "G1 X120.000 Y100.000 Z0.300 F6000"]
    steps = 40 * turns
    for step in range(1, steps + 1):
        angle, z = 2 * math.pi * step / 40, 0.3 + 0.3 * step / 40
        lines.append(f"G1 X{100 + 20 * math.cos(angle):.3f} Y{100 + 20 * math.sin(angle):.3f} Z{z:.4f} E0.15 F300")
    path = room.print("\n".join(lines) + "\n")
    room.wait_done(120)
    between = [moment for moment in moments(room) if moment["file_pos"] not in layer_ends(path)]
    assert len(between) >= 2
    assert {check["verdict"] for check in room.checks} <= {"ok", "suspect"}
    assert room.status["action"] == "none"
    assert room.sent_of_file() == path.read_text().splitlines()


def moments(room) -> list[dict]:
    """Those of the newest recording."""
    name = room.moop("GET", "recordings")["recordings"][0]["name"]
    lines = (room.server.basedir / "data/moop/recordings" / name / "frames.jsonl").read_text().splitlines()
    return [json.loads(line) for line in lines]


def layer_ends(path: Path) -> set[int]:
    return set(read_gcode(path).layer_end_pos.tolist())


def test_an_eye_without_memory_ends_and_another_one_goes_on(room):
    from benchmarks.host_stall import large_gcode

    path = room.folder / "memory.gcode"
    path.write_text("; one more\n" + large_gcode(60_000))
    room.webcam.look_at(path)
    before = set(eye_pids(room))
    for pid in before:
        resource.prlimit(pid, resource.RLIMIT_AS, (1 << 20, resource.RLIM_INFINITY))
    room.server.upload(path)
    room.wait("watched", lambda: room.status["watching"] and room.status["job"] == path.name, 120)
    now = set(eye_pids(room))
    for pid in before & now:  # that of the set-up
        resource.prlimit(pid, resource.RLIMIT_AS, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    assert before - now and now - before, "it is another one"
    assert room.wait_checks(1)[0]["verdict"] == "ok"
    assert "MemoryError" in room.server.log_text()


def test_an_eye_that_is_killed_while_it_reads_is_started_again(room):
    from benchmarks.host_stall import large_gcode

    path = room.folder / "killed.gcode"
    path.write_text("; another\n" + large_gcode(250_000))
    room.webcam.look_at(path)
    room.server.upload(path)
    room.wait("reading", lambda: room.status["reading"] is not None)
    for pid in eye_pids(room):
        os.kill(pid, signal.SIGKILL)
    room.wait("watched", lambda: room.status["watching"] and room.status["job"] == path.name, 120)


def test_many_prints_in_a_row_leave_nothing_behind(room):
    process = Path(f"/proc/{room.server._process.pid}")

    def counted() -> tuple[int, int]:
        return len(list((process / "fd").iterdir())), len(list((process / "task").iterdir()))

    one_layer = box_gcode(layers=1, side_mm=12)
    for _ in range(3):
        room.print(one_layer)
        room.wait_done()
    files, threads = counted()
    for _ in range(10):
        room.print(one_layer)
        room.wait_done()
    files_after, threads_after = counted()
    assert files_after <= files + 5
    assert threads_after <= threads + 3


def test_an_eye_does_not_outlive_its_server(room):
    """Last in this file: it takes the server away, and brings it back."""
    room.print(box_gcode(layers=8, feed_mm_min=SLOWLY))
    room.wait_checks(1)
    pids = eye_pids(room)
    assert pids
    os.kill(room.server._process.pid, signal.SIGKILL)
    room.server._process.wait()
    deadline = time.monotonic() + 15
    while any(Path(f"/proc/{pid}/cmdline").exists() for pid in pids) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert not any(Path(f"/proc/{pid}/cmdline").exists() for pid in pids)
    room.server.start()
    room.server.wait_operational()
    room.save(capture="park", head=NO_HEAD)  # a server that is started anew has its first settings
    room.warm_up()
    cut_short = room.moop("GET", "recordings")["recordings"][0]
    assert "ended" not in cut_short and cut_short["checks"] >= 0
    watched_well(room, 2)
