"""Whatever fails around us, the print goes on, no hold is left, and the status says why nobody is watching."""

from __future__ import annotations

import os
import signal

import pytest

from .room import SLOWLY, box_gcode, huge_jpeg


@pytest.mark.parametrize(
    ("answer", "told"),
    [
        ("404", "404"),
        ("refused", "no picture"),
        ("html", "not a JPEG; it begins with '<html>"),
        ("empty", "empty"),
        ("truncated", "breaks off after 9000 bytes"),
        ("slow", "gave no picture"),
        ("same", "same picture again"),
        ("huge", "megapixels"),
    ],
)
def test_a_webcam_without_a_usable_picture_never_stops_the_print(room, answer, told):
    assert len(huge_jpeg()) > 100_000  # made before anybody waits for it
    path = room.print(box_gcode(layers=4, feed_mm_min=SLOWLY))
    room.wait_checks(1)
    room.webcam.answer = answer
    status = room.wait("blind", lambda: room.status["blind"] and room.status)
    assert told in status["blind"]
    room.webcam.answer = "picture"
    room.wait_done()
    assert room.sent_of_file() == path.read_text().splitlines()
    assert room.status["action"] == "none"


def test_a_webcam_that_comes_back_is_looked_through_again(room):
    room.print(box_gcode(layers=6, feed_mm_min=SLOWLY))
    room.wait_checks(1)
    room.webcam.answer = "404"
    room.wait("blind", lambda: room.status["blind"])
    room.webcam.answer = "picture"
    room.wait("seeing again", lambda: room.status["blind"] is None and room.status["checks"] >= 2)
    room.wait_done()


def eye_pids(room) -> list[int]:
    found = []
    for pid in filter(str.isdigit, os.listdir("/proc")):
        try:
            with open(f"/proc/{pid}/cmdline", "rb") as file:
                command = file.read().split(b"\0")
            with open(f"/proc/{pid}/stat") as file:
                parent = int(file.read().rsplit(")", 1)[1].split()[1])
        except OSError:
            continue
        if b"octoprint_moop.machine.eye" in command and parent == room.server._process.pid:
            found.append(int(pid))
    return found


def test_an_eye_that_is_killed_in_mid_check_is_started_again_and_the_print_goes_on(room):
    path = room.print(box_gcode(layers=12, feed_mm_min=SLOWLY))
    room.wait_checks(3)
    victims = []

    def kill_while_the_picture_is_taken() -> None:
        if not victims:
            victims.extend(eye_pids(room))
            for pid in victims:
                os.kill(pid, signal.SIGKILL)

    room.webcam.before = kill_while_the_picture_is_taken
    room.wait("the eye is told to be gone", lambda: "started again" in (room.status["blind"] or ""))
    room.wait("watched again", lambda: room.status["checks"] >= 5 and room.status["blind"] is None)
    room.wait_done()
    assert room.sent_of_file() == path.read_text().splitlines()
    assert {check["verdict"] for check in room.checks} == {"ok"}


def test_a_stopped_eye_costs_one_check_its_time_limit(room, saved):
    saved(check_timeout_s=2)
    path = room.print(box_gcode(layers=8, feed_mm_min=SLOWLY))
    room.wait_checks(2)

    def stop_eye() -> None:
        room.webcam.before = lambda: None
        for pid in eye_pids(room):
            os.kill(pid, signal.SIGSTOP)

    room.webcam.before = stop_eye
    room.wait("given up", lambda: "longer than" in (room.status["blind"] or ""))
    room.wait_done()
    assert room.sent_of_file() == path.read_text().splitlines()


def test_cancelling_during_a_check_is_not_held_up(room):
    room.print(box_gcode(layers=8, feed_mm_min=SLOWLY))
    room.wait_checks(2)
    room.webcam.answer = "slow"
    served = room.webcam.served
    room.wait("a picture is asked for", lambda: room.webcam.served > served)
    room.command(command="cancel")
    room.server.wait_state({"Operational"}, 4)
    room.wait("told", lambda: room.status["blind"] == "No print is running.")


def test_pausing_and_resuming_during_a_check_loses_no_line(room):
    path = room.print(box_gcode(layers=6, feed_mm_min=SLOWLY))
    room.wait_checks(2)
    room.webcam.answer = "slow"
    served = room.webcam.served
    room.wait("a picture is asked for", lambda: room.webcam.served > served)
    room.command(command="pause", action="pause")
    room.webcam.answer = "picture"
    room.server.wait_state({"Paused"}, 15)
    room.command(command="pause", action="resume")
    room.wait_done()
    assert room.sent_of_file() == path.read_text().splitlines()


def test_a_printer_that_disconnects_while_held_is_watched_again_after_reconnecting(room):
    room.print(box_gcode(layers=6, feed_mm_min=SLOWLY))
    room.wait_checks(1)
    room.webcam.answer = "slow"
    served = room.webcam.served
    room.wait("a picture is asked for", lambda: room.webcam.served > served)
    room.server.api("POST", "/api/connection", json={"command": "disconnect"})
    room.wait("offline", lambda: room.server.job_state().startswith("Offline"), 20)
    room.webcam.answer = "picture"
    room.server.api("POST", "/api/connection", json={"command": "connect"})
    room.server.wait_state({"Operational"}, 30)
    room.print(box_gcode(layers=2))
    room.wait_done()
    assert room.checks[-1]["layer"] == 1


def test_a_job_from_the_printers_own_storage_is_said_not_to_be_watched(room):
    room.print_stored(*room.store(box_gcode(2), "from_the_card.gcode"))
    room.wait("said so", lambda: "own storage" in (room.status["blind"] or ""))
