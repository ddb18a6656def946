"""When to look, and what to do: the choices of the settings, on a real server."""

from __future__ import annotations

from .room import SLOWLY, box_gcode


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
    path = room.print(box_gcode(layers=14, feed_mm_min=SLOWLY))
    room.wait_done()
    assert len(room.checks) >= 1
    assert {check["verdict"] for check in room.checks} == {"ok"}
    assert room.sent_of_file() == path.read_text().splitlines()


def test_at_most_one_look_in_the_set_time(room, saved):
    saved(min_interval_s=60)
    room.print(box_gcode(layers=6))
    room.wait_done()
    assert len(room.checks) == 1


def test_watching_can_be_switched_off_altogether_and_says_so(room, saved):
    saved(watch_prints=False)
    room.print(box_gcode(layers=2))
    room.wait("said", lambda: "switched off in the settings" in (room.status["blind"] or ""))
    room.wait_done()
    assert room.checks == []
