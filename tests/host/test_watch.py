"""A watched print, from upload to verdict, on a real server."""

from __future__ import annotations

from .room import box_gcode


def test_a_good_print_is_checked_at_every_layer_and_never_paused(room):
    path = room.print(box_gcode(layers=12))
    room.wait_done()
    room.wait("the end is told", lambda: room.status["blind"] == "No print is running.")
    checks = room.checks
    assert [check["layer"] for check in checks] == list(range(12))
    assert [(check["layer"], check["reason"]) for check in checks if check["verdict"] != "ok"] == []
    assert max(check["E"] for check in checks) < 0.05
    assert [check["id"] for check in checks] == list(range(12))
    # Not a line of the file is lost, doubled or moved by all the holding.
    assert room.sent_of_file() == path.read_text().splitlines()


def test_a_check_is_made_with_the_printer_at_rest_after_the_layers_last_command(room):
    room.save(capture="stand")
    try:
        room.print(box_gcode(layers=3))
        room.wait_done()
    finally:
        room.save(capture="park")
    sent = room.sent()
    ours = [n for n, (_, tags) in enumerate(sent) if any(tag.startswith("moop:settle") for tag in tags)]
    assert [sent[n][0] for n in ours] == ["M400", "M114"] * 3
    for n, check in zip(ours[::2], room.checks):
        assert f"filepos:{check['file_pos']}" in sent[n - 1][1]
    for n in ours[:-2:2]:
        assert " E" in sent[n - 1][0] and " Z" in sent[n + 2][0]


def test_a_print_that_comes_off_the_bed_is_paused_at_that_layer_before_another_line_is_sent(room):
    text = box_gcode(layers=14)
    room.webcam.slides_at = text.index("Z2.700")  # layer number 8 begins
    path = room.print(text)
    room.server.wait_state({"Paused"}, 40)
    status = room.wait("told", lambda: room.status["last_check"]["verdict"] == "failed" and room.status)
    assert status["action"] == "pause"
    assert 8 <= status["layer"] <= 9
    assert status["last_check"]["verdict"] == "failed" and status["last_check"]["age_s"] < 20
    lines = path.read_text().splitlines()
    sent = room.sent_of_file()
    assert sent == lines[: len(sent)]
    assert " Z" in lines[len(sent)], "the print stands between two layers"
    # The user looks, finds nothing wrong, and goes on: the same thing is not told twice.
    room.command(command="pause", action="resume")
    room.wait_done()
    assert room.sent_of_file() == lines
    assert len(room.checks) == 14


def test_a_head_over_the_print_is_parked_for_the_picture_and_comes_back(room):
    room.print(box_gcode(layers=3))
    room.wait_done()
    sent = [(command, next((t for t in tags if t.startswith("moop:settle")), "")) for command, tags in room.sent()]
    first = next(n for n, (_, tag) in enumerate(sent) if tag and " E" in sent[n - 1][0] and not sent[n - 1][1])
    ours = [command for command, tag in sent[first:] if tag]
    last_of_layer = sent[first - 1][0]
    assert ours[:2] == ["M400", "M114"]
    back_at = last_of_layer.split(" E")[0].replace("G1 ", "")
    assert ours[2:12] == [
        "G1 E-1 F2100", "G1 Z1.300 F600", "G1 X2.000 Y198.000 F9000", "M400", "M114",
        f"G1 {back_at} F9000", "G1 Z0.300 F600", "G1 E1 F2100", "G1 F9000", "M400",
    ]  # fmt: skip
    name = room.moop("GET", "recordings")["recordings"][0]["name"]
    frames = (room.server.basedir / "data/moop/recordings" / name / "frames.jsonl").read_text()
    assert frames.count('"parked": true') == 3 and frames.count('"x": 2.0, "y": 198.0') >= 2


def test_the_pictures_of_a_check_can_be_fetched(room):
    room.print(box_gcode(layers=3))
    room.wait_checks(2)
    for kind, begins in (("frame.jpg", b"\xff\xd8"), ("seen.png", b"\x89PNG"), ("expected.png", b"\x89PNG"),
                         ("ignored.png", b"\x89PNG")):  # fmt: skip
        answer = room.server.request("GET", f"/plugin/moop/checks/1/{kind}")
        assert answer.status_code == 200 and answer.content.startswith(begins), kind
    assert room.server.request("GET", "/plugin/moop/checks/1/passwd").status_code == 404
    assert room.server.request("GET", "/plugin/moop/checks/99/frame.jpg").status_code == 404
    room.wait_done()
