"""When to look, and what to do: the choices of the settings, on a real server."""

from __future__ import annotations

import pytest

from .room import box_gcode


@pytest.fixture
def saved(room):
    """Save settings for one test."""
    now = room.server.api("GET", "/api/settings")["plugins"]["moop"]
    names = ("capture", "on_failed", "longest_s", "every_layers", "cool_after_min", "min_interval_s", "watch_prints")
    before = {name: now[name] for name in names}
    yield room.save
    room.save(**before)


def test_where_the_slicer_marks_the_spot_the_print_is_looked_at_there_and_nowhere_else(room, saved):
    saved(capture="slicer")
    lines = []
    for line in box_gcode(layers=5).splitlines():
        if " Z" in line and "F12000" in line and lines[-1] != "M104 S200":
            lines += ["G1 X5 Y190 F12000", "@moop"]
        lines.append(line)
    path = room.print("\n".join(lines) + "\n")
    room.wait_done()
    assert [check["layer"] for check in room.checks] == [0, 1, 2, 3]
    assert {check["verdict"] for check in room.checks} == {"ok"}
    assert room.sent_of_file() == [line for line in path.read_text().splitlines() if line != "@moop"]
    name = room.moop("GET", "recordings")["recordings"][0]["name"]
    frames = (room.server.basedir / "data/moop/recordings" / name / "frames.jsonl").read_text()
    assert frames.count('"parked": true') == 4 and '"x": 5.0, "y": 190.0' in frames


def test_a_layer_that_takes_long_is_looked_at_in_between(room, saved):
    saved(every_layers=1000, longest_s=1)
    path = room.print(box_gcode(layers=14))
    room.wait_done()
    assert len(room.checks) >= 1
    assert {check["verdict"] for check in room.checks} == {"ok"}
    assert room.sent_of_file() == path.read_text().splitlines()


def test_at_most_one_look_in_the_set_time(room, saved):
    saved(min_interval_s=60)
    room.print(box_gcode(layers=6))
    room.wait_done()
    assert len(room.checks) == 1


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
    for line in box_gcode(layers=10).splitlines():
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


def test_watching_can_be_switched_off_altogether_and_says_so(room, saved):
    saved(watch_prints=False)
    room.print(box_gcode(layers=2))
    room.wait("said", lambda: "switched off in the settings" in (room.status["blind"] or ""))
    room.wait_done()
    assert room.checks == []
