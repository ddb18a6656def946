"""A watched print, from upload to verdict, on a real server."""

from __future__ import annotations

from .room import box_gcode


def test_a_good_print_is_checked_at_every_layer_and_never_paused(room):
    path = room.print(box_gcode(layers=12))
    room.wait_done()
    room.wait("the end is told", lambda: room.status["blind"] == "No print is running.")
    checks = room.checks
    assert [check["layer"] for check in checks] == list(range(12))
    assert {check["verdict"] for check in checks} == {"ok"}
    assert max(check["E"] for check in checks) < 0.05
    assert [check["id"] for check in checks] == list(range(12))
    # Not a line of the file is lost, doubled or moved by all the holding.
    assert room.sent_of_file() == path.read_text().splitlines()


def test_a_check_is_made_with_the_printer_at_rest_after_the_layers_last_command(room):
    room.print(box_gcode(layers=3))
    room.wait_done()
    sent = room.sent()
    ours = [n for n, (_, tags) in enumerate(sent) if any(tag.startswith("moop:settle") for tag in tags)]
    assert [sent[n][0] for n in ours] == ["M400", "M114"] * 3
    for n, check in zip(ours[::2], room.checks):
        assert f"filepos:{check['file_pos']}" in sent[n - 1][1]
    for n in ours[:-2:2]:
        assert " E" in sent[n - 1][0] and " Z" in sent[n + 2][0]


def test_a_print_that_comes_off_the_bed_is_paused_at_that_layer_before_another_line_is_sent(room):
    text = box_gcode(layers=20)
    room.webcam.slides_at = text.index("Z2.700")  # layer number 8 begins
    path = room.print(text)
    room.server.wait_state({"Paused"}, 40)
    status = room.status
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
    assert len(room.checks) == 20


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
