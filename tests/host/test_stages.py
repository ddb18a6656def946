"""A check that is interrupted, at each of its stages: the user and the printer come first, and nothing is left held."""

from __future__ import annotations

import os
import signal
import time

import pytest

from .room import SLOWLY, box_gcode
from .test_faults import eye_pids


class Stage:
    """Brings a check to one of its stages and keeps it there until `end`."""

    def __init__(self, room, name: str) -> None:
        self.room, self.name, self._asked = room, name, []

    def begin(self) -> None:
        """Returns when a check has come so far."""
        room, before = self.room, len(self.room.sent())
        if self.name == "standing still":
            room.save(settle_s=2.5)
            room.wait("M114", lambda: any(command == "M114" for command, _ in room.sent()[before:]))
            return
        held = []
        room.webcam.before = lambda: self._keep(held)
        room.wait(self.name, lambda: held)
        time.sleep(0.5 if self.name == "looking" else 0.0)  # until the picture has reached the eye

    def _keep(self, held: list) -> None:
        webcam, file_pos = self.room.webcam, self.room.sent_pos()
        if self.name == "looking":
            for pid in eye_pids(self.room) if not held else ():
                os.kill(pid, signal.SIGSTOP)
        elif self.name == "looking again" and file_pos not in self._asked:
            self._asked.append(file_pos)
            webcam.slides_at = 0
            return
        else:
            webcam.answer = "slow"
        held.append(file_pos)

    def end(self) -> None:
        self.room.webcam.reset()
        if self.name == "standing still":
            self.room.save(settle_s=0.0)


@pytest.mark.parametrize("name", ["standing still", "taking a picture", "looking", "looking again"])
def test_a_check_gives_way_at_each_of_its_stages(room, saved, name):
    saved(check_timeout_s=2)
    path = room.print("G4 P1500\n" + box_gcode(layers=12, feed_mm_min=SLOWLY))
    room.wait_checks(3)
    stage = Stage(room, name)
    stage.begin()
    room.command(command="pause", action="pause")
    if name != "looking":  # an eye that hangs is waited for until its time is over
        stage.end()
    room.server.wait_state({"Paused"}, 15)
    stage.end()
    lines, sent = path.read_text().splitlines(), room.sent_of_file()
    assert sent == lines[: len(sent)], "not a line is lost"
    room.command(command="pause", action="resume")
    count = len(room.checks)
    room.wait_checks(count + 1)
    stage.begin()
    room.command(command="cancel")
    room.server.wait_state({"Operational"}, 5)
    stage.end()
    room.wait("told", lambda: room.status["blind"] == "No print is running.")
    watched_again(room, warming_up_s=5 if name == "looking" else 0.5)


@pytest.mark.parametrize(
    ("fault", "state"), [("reset", "Operational"), ("drop_connection", "Offline"), ("action_disconnect", "Offline")]
)
def test_a_printer_that_goes_away_while_held_leaves_nothing_held(room, fault, state):
    room.print("G4 P1500\n" + box_gcode(layers=12, feed_mm_min=SLOWLY))
    room.wait_checks(2)
    stage = Stage(room, "taking a picture")
    stage.begin()
    room.server.api("POST", "/api/printer/command", json={"command": f"!!DEBUG:{fault}"})
    room.wait(state, lambda: room.server.job_state().startswith((state, "Offline", "Error")), 20)
    stage.end()
    room.wait("told", lambda: room.status["blind"] == "No print is running.")
    if not room.server.job_state().startswith("Operational"):
        room.server.api("POST", "/api/connection", json={"command": "connect"})
        room.server.wait_state({"Operational"}, 30)
    watched_again(room)


def watched_again(room, warming_up_s: float = 0.5) -> None:
    room.print(f"G4 P{warming_up_s * 1000:.0f}\n" + box_gcode(layers=2))
    room.wait_done()
    assert [check["layer"] for check in room.wait_checks(2)] == [0, 1]
