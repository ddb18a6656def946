"""What is done about a failure, a suspicion and being blind, on a real server: as the settings say, and once."""

from __future__ import annotations

import numpy as np
import pytest

from .room import SLOWLY, box_gcode, slid, two_boxes_gcode


@pytest.mark.parametrize(("action", "state"), [("none", "Operational"), ("notify", "Operational"), ("pause", "Paused")])
def test_a_failure_is_answered_as_the_settings_say(room, saved, action, state):
    saved(on_failed=action)
    text = box_gcode(layers=8)
    room.webcam.slides_at = text.index("Z1.500")
    room.print(text)
    assert room.server.wait_state({"Paused", "Operational"}, 40) == state
    failed = room.wait("told", lambda: [check for check in room.checks if check["verdict"] == "failed"])
    assert failed[0]["action"] == action
    assert all(check["action"] == "none" for check in failed[1:])


def test_a_failure_cancels_the_print_where_that_is_set(room, saved):
    saved(on_failed="cancel")
    text = box_gcode(layers=8)
    room.webcam.slides_at = text.index("Z1.500")
    room.print(text)
    room.server.wait_state({"Operational"}, 40)
    assert len(room.sent_of_file()) < len(text.splitlines())
    recording = room.wait("ended", lambda: room.moop("GET", "recordings")["recordings"][0])
    assert recording["verdict"] == "failed" and recording["layer"] in (4, 5)


def test_a_hot_end_that_was_turned_off_in_a_long_pause_is_hot_before_the_next_move(room, saved):
    saved(on_failed="pause", cool_after_min=0.02)
    text = box_gcode(layers=8).replace("M104 S200", "M104 S60")
    room.webcam.slides_at = text.index("Z1.500")
    room.print(text)
    room.server.wait_state({"Paused"}, 40)
    before = room.wait("turned off", lambda: "turned off tool0" in room.server.log_tail(4) and len(room.sent()))
    assert [command for command, _ in room.sent() if command.startswith("M104")][-1].endswith("S0")
    room.command(command="pause", action="resume")
    room.wait_done()
    after = [command for command, _ in room.sent()[before:]]
    moves = [n for n, command in enumerate(after) if command.startswith("G1")]
    assert after.index("M109 S60") < moves[0]


def test_an_object_that_anybody_cancels_is_known_to_be_cancelled_from_then_on(room, saved):
    saved(on_failed="none")  # the webcam knows nothing of cancelled objects and goes on painting it
    lines, layer = [], 0
    for line in box_gcode(layers=10, feed_mm_min=SLOWLY).splitlines():
        if " Z" in line and "F12000" in line:
            if layer:
                lines += ["EXCLUDE_OBJECT_END NAME=box"]
            lines += ["EXCLUDE_OBJECT_START NAME=box"]
            layer += 1
        lines.append(line)
    lines = ["EXCLUDE_OBJECT_DEFINE NAME=box", *lines[:-3], "EXCLUDE_OBJECT_END NAME=box", *lines[-3:]]
    room.print("\n".join(lines) + "\n")
    room.wait_checks(2)
    room.server.api("POST", "/api/printer/command", json={"command": "EXCLUDE_OBJECT NAME=box"})
    count = len(room.checks)
    room.wait_checks(count + 3)
    room.wait_done()
    name = room.moop("GET", "recordings")["recordings"][0]["name"]
    frames = (room.server.basedir / "data/moop/recordings" / name / "frames.jsonl").read_text()
    assert '"cancelled": {"box": ' in frames.splitlines()[-1] and "cancelled" not in frames.splitlines()[0]


def test_only_the_object_that_failed_is_cancelled_and_the_rest_is_printed_and_watched(room, saved):
    saved(on_failed="cancel_object")
    text = two_boxes_gcode(layers=14)
    falls_at = text.index("Z1.800")

    def mask(file_pos: int) -> np.ndarray:
        """The right box comes off, and nothing is added to it once the firmware was told to skip it."""
        printed_pos, cancelled_pos = 0, None
        for command, tags in room.sent():
            printed_pos = next((int(tag[8:]) for tag in tags if tag.startswith("filepos:")), printed_pos)
            if command == "EXCLUDE_OBJECT NAME=right" and cancelled_pos is None:
                cancelled_pos = printed_pos
        gone = {} if cancelled_pos is None else {1: cancelled_pos}
        views, here = room.webcam.views, (0.0, 0.0, 0.0)
        seen, left = views.at(file_pos, here, gone).mask, views.map_at(here, file_pos, gone).nearest == 0
        right = np.where(left, np.uint8(0), seen)
        return np.where(left, seen, np.uint8(0)) | (slid(right) if file_pos > falls_at else right)

    room.webcam.mask = mask
    path = room.print(text)
    room.wait_done()
    failed = [check for check in room.checks if check["verdict"] == "failed"]
    assert failed[0]["action"] == "cancel_object"
    assert [one["name"] for one in failed[0]["objects"] if one["verdict"] == "failed"] == ["right"]
    ours = [command for command, tags in room.sent() if "moop:mismatch" in tags]
    assert ours == ["EXCLUDE_OBJECT NAME=right"], "once"
    assert room.sent_of_file() == path.read_text().splitlines()
    after = [check for check in room.checks if check["id"] > failed[0]["id"]]
    assert len(after) >= 4 and {check["verdict"] for check in after} == {"ok"}
    assert [check["layer"] for check in room.checks] == list(range(14))
    assert room.status["action"] == "cancel_object"


def test_a_suspicion_is_told_where_that_is_set_and_nothing_is_done(room, saved):
    """A first layer in the wrong place is only suspected: there is nothing yet to compare it with."""
    saved(on_suspect="notify")
    text = box_gcode(layers=5)
    room.webcam.slides_at = 0
    room.print(text)
    suspected = room.wait_checks(1)[0]
    room.webcam.slides_at = 10**9
    assert (suspected["verdict"], suspected["action"]) == ("suspect", "notify")
    room.wait_done()
    assert not [command for command, tags in room.sent() if "moop:mismatch" in tags]


def test_a_print_that_nobody_could_watch_for_long_is_paused_where_that_is_wanted(room, saved):
    saved(on_blind="pause", blind_min=0.1, every_layers=1000)
    room.webcam.answer = "404"
    room.print("G4 P1500\n" + box_gcode(layers=60, feed_mm_min=SLOWLY))
    room.wait("blind", lambda: room.status["blind_code"] == "frame", 20)
    room.server.wait_state({"Paused"}, 60)
    status = room.status
    assert status["action"] == "pause" and "Nobody has watched" in status["reason"] and "404" in status["reason"]


def test_the_users_own_commands_are_sent_around_a_pause_of_ours_and_around_no_other(room, saved):
    saved(gcode_paused="M117 look at me ; now\n\nM300 S440", gcode_resumed="G1 E5 F300\n")
    text = box_gcode(layers=8, feed_mm_min=SLOWLY)
    room.webcam.slides_at = text.index("Z1.500")
    room.print(text)
    room.server.wait_state({"Paused"}, 40)
    room.wait("sent", lambda: [command for command, _ in room.sent()][-2:] == ["M117 look at me", "M300 S440"])
    before = len(room.sent())
    room.command(command="pause", action="resume")
    room.wait("goes on", lambda: len(room.sent_of_file()) and len(room.sent()) > before + 3)
    assert room.sent()[before][0] == "G1 E5 F300"
    room.command(command="pause", action="pause")
    room.server.wait_state({"Paused"}, 20)
    room.command(command="pause", action="resume")
    room.wait_done()
    commands = [command for command, _ in room.sent()]
    assert commands.count("M300 S440") == commands.count("G1 E5 F300") == 1
