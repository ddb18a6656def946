"""The routes: permissions, set-up, settings, recordings."""

from __future__ import annotations

import io
import json
import re
import threading
import zipfile

import pytest
import requests

from octoprint_moop.host.api import MoopApi
from octoprint_moop.host.api_calibrations import MoopCalibrationsApi
from octoprint_moop.host.api_jobs import MoopJobsApi
from octoprint_moop.host.api_past import MoopPastApi
from octoprint_moop.host.api_setup import MoopSetupApi
from octoprint_moop.machine.recording import Recording

from .room import SLOWLY, box_gcode, header


def routes() -> list[tuple[str, str]]:
    """Every route that the plugin has, with something put in for its variables."""
    found = []
    for mixin in (MoopApi, MoopJobsApi, MoopSetupApi, MoopPastApi, MoopCalibrationsApi):
        for member in vars(mixin).values():
            for rules in getattr(member, "_blueprint_rules", {}).values():
                for rule, options in rules:
                    path = re.sub("<int:[a-z_]+>", "0", rule).replace("<kind>", "frame.jpg").replace("<name>", "x")
                    found += [(method, path) for method in options["methods"]]
    return [*found, ("GET", "/recordings/x.zip")]


def test_no_route_lets_anybody_in_without_a_permission(room):
    assert len(routes()) > 20
    for method, route in routes():
        answer = requests.request(method, f"{room.server.url}/plugin/moop{route}", json={}, timeout=10)
        assert answer.status_code in ((403,) if method == "GET" else (400, 403)), (route, answer.text)
        if answer.status_code == 400:
            assert "CSRF" in answer.text, (route, answer.text)


def test_who_may_only_look_can_change_nothing(room):
    user = {"name": "guest", "password": "guest", "active": True, "admin": False, "groups": ["readonly"]}
    room.server.request("POST", "/api/access/users", json=user)
    room.server.api("PUT", "/api/access/users/guest", json={"active": True, "admin": False, "groups": ["readonly"]})
    key = room.server.api("POST", "/api/access/users/guest/apikey")["apikey"]
    for method, route in routes():
        answer = requests.request(
            method, f"{room.server.url}/plugin/moop{route}", json={}, timeout=10, headers={"X-Api-Key": key}
        )
        changes = (
            method in ("POST", "DELETE") and route != "/segment/preview"
        )  # a replay changes nothing, and takes minutes
        assert (answer.status_code == 403) == (changes or route.startswith("/calibrate")), (route, answer.text)


def test_a_set_up_can_be_carried_from_one_machine_to_another(room):
    given = header()
    room.moop("POST", "setup", json=given)
    found = room.moop("GET", "setup")
    for part in ("format", "version", "printer", "camera", "material"):
        assert found[part] == given[part], part
    assert room.moop("POST", "setup", json=found)["changed"] == []


def test_a_set_up_that_makes_no_sense_is_refused_with_a_sentence(room):
    answer = room.server.request("POST", "/plugin/moop/setup", json={**header(), "camera": {"K": [[1]]}})
    assert answer.status_code == 400
    assert answer.json()["code"] == "camera" and "image_size_px" in answer.json()["message"]
    assert room.moop("GET", "setup")["camera"] == header()["camera"]


def test_settings_are_kept_and_a_senseless_one_is_not(room):
    saved = room.save(every_layers="2", sensitivity="high")
    assert (saved["every_layers"], saved["sensitivity"]) == (2, "high")
    saved = room.save(every_layers=-3, settle_s=0.25)
    assert (saved["every_layers"], saved["settle_s"]) == (2, 0.25)
    room.save(every_layers=1, sensitivity="medium", settle_s=0.0)


def test_every_second_layer_only_is_checked_where_that_is_set(room):
    room.save(every_layers=2)
    try:
        room.print(box_gcode(layers=6))
        room.wait_done()
        assert [check["layer"] for check in room.checks] == [1, 3, 5]
    finally:
        room.save(every_layers=1)


def test_a_preview_is_a_mask_and_nonsense_a_sentence(room):
    answer = room.server.request("POST", "/plugin/moop/segment/preview", json=header()["material"])
    assert answer.status_code == 200 and answer.content.startswith(b"\x89PNG")
    answer = room.server.request("POST", "/plugin/moop/segment/preview", json={"hue_deg": [1, 999]})
    assert answer.status_code == 400 and "message" in answer.json()


def test_a_print_that_is_not_wanted_watched_is_left_alone_and_says_so(room):
    room.print(box_gcode(layers=8, feed_mm_min=SLOWLY))
    room.wait_checks(1)
    room.moop("POST", "watch", json={"watching": False})
    status = room.wait("off", lambda: room.status["blind"] and room.status)
    assert "switched off" in status["blind"] and not status["watching"]
    before = len(room.checks)
    room.moop("POST", "watch", json={"watching": True})
    room.wait_checks(before + 1)
    room.wait_done()


def test_a_check_can_be_asked_for_between_two_layers(room):
    room.save(every_layers=100)
    try:
        room.print(box_gcode(layers=4, feed_mm_min=SLOWLY))
        room.wait("watching", lambda: room.status["watching"])
        room.moop("POST", "check", json={})
        (check, *_) = room.wait_checks(1)
        assert check["verdict"] == "ok"
        room.wait_done()
    finally:
        room.save(every_layers=1)
    answer = room.server.request("POST", "/plugin/moop/check", json={})
    assert answer.status_code == 409


def test_two_people_who_press_the_same_buttons_do_no_harm(room):
    """A second browser, or a script: each sees the same, and what both ask for is done once."""
    path = room.print(box_gcode(layers=10, feed_mm_min=SLOWLY))
    room.wait_checks(2)
    answers: list[int] = []

    def press() -> None:
        for route, sent in (
            ("check", {}),
            ("watch", {"watching": False}),
            ("watch", {"watching": True}),
            ("pardon", {}),
        ):
            answers.append(room.server.request("POST", f"/plugin/moop/{route}", json=sent).status_code)

    people = [threading.Thread(target=press) for _ in range(2)]
    for each in people:
        each.start()
    for each in people:
        each.join()
    assert set(answers) <= {200, 409}
    room.wait_checks(4)
    room.wait_done()
    assert room.sent_of_file() == path.read_text().splitlines()
    assert room.status["action"] == "none"


def test_each_watched_print_leaves_a_recording_that_can_be_replayed_and_fetched(room, tmp_path):
    path = room.print(box_gcode(layers=3), "a b; rm -rf ~.gcode")
    room.wait_done()
    room.wait("ended", lambda: room.moop("GET", "recordings")["recordings"][0].get("ended") == "done")
    kept = room.moop("GET", "recordings")["recordings"][0]
    assert kept["checks"] == 3 and kept["verdict"] == "ok"
    answer = room.server.request("GET", f"/plugin/moop/recordings/{kept['name']}.zip")
    zipfile.ZipFile(io.BytesIO(answer.content)).extractall(tmp_path)
    recording = Recording.open(tmp_path / kept["name"])
    assert [moment.layer for moment in recording.moments] == [0, 1, 2]
    assert recording.frame(recording.moments[0]).shape == (480, 640, 3)
    with recording.job_path() as job:
        assert job.read_bytes() == path.read_bytes()
    live = [json.loads(line) for line in (tmp_path / kept["name"] / "checks.jsonl").read_text().splitlines()]
    assert [check["E"] for check in live] == [check["E"] for check in room.checks]
    past = f"/plugin/moop/recordings/{kept['name']}/pictures"
    frame = room.server.request("GET", f"{past}/2/frame.jpg").content
    assert frame == (tmp_path / kept["name"] / "frames/000002.jpg").read_bytes()
    assert room.server.request("GET", f"{past}/3/frame.jpg").status_code == 404
    without = room.server.request("GET", f"/plugin/moop/recordings/{kept['name']}.zip?pictures=0")
    assert not [name for name in zipfile.ZipFile(io.BytesIO(without.content)).namelist() if name.endswith(".jpg")]
    missing = room.server.request("GET", "/plugin/moop/recordings/nothing.zip")
    assert (missing.status_code, missing.json()["code"]) == (400, "recording")
    room.moop("DELETE", f"recordings/{kept['name']}")
    assert kept["name"] not in [r["name"] for r in room.moop("GET", "recordings")["recordings"]]


def test_the_recording_of_the_print_that_runs_is_not_deleted_under_it(room):
    room.print(box_gcode(layers=3, feed_mm_min=SLOWLY))
    name = room.wait("recorded", lambda: room.status["recording"])
    refused = room.server.request("DELETE", f"/plugin/moop/recordings/{name}")
    assert (refused.status_code, refused.json()["code"]) == (400, "recording")
    assert "when the print is over" in refused.json()["message"]
    room.wait_done()
    room.wait("ended", lambda: room.status["recording"] is None)
    assert len(room.moop("GET", f"recordings/{name}/checks")["checks"]) == 3
    room.moop("DELETE", f"recordings/{name}")


@pytest.mark.parametrize("name", ["..", "../data", ".hidden", "%2e%2e", "x/y"])
def test_no_name_leads_out_of_the_recordings(room, name):
    assert room.server.request("DELETE", f"/plugin/moop/recordings/{name}").status_code in (400, 404, 405)
    assert room.status


@pytest.mark.parametrize(
    ("method", "route", "sent"),
    [
        ("GET", "mesh?path=../../../etc/passwd", None),
        ("DELETE", "mesh?path=../x", None),
        ("POST", "mesh/choice", {"path": "../../etc/passwd", "use": True}),
        ("POST", "calibrate/points", {"points": {}, "click_px": "two"}),
        ("POST", "calibrate/points", {"points": {}, "click_px": None}),
        ("POST", "setup", {**header(), "cameras": True}),
        ("POST", "setup", {**header(), "job": "x"}),
        ("POST", "segment/preview", {"hue_deg": [float("nan"), 0], "saturation_min": 0, "value_min": 0}),
    ],
)
def test_what_makes_no_sense_is_answered_with_a_sentence(room, method, route, sent):
    room.moop("POST", "calibrate/points/picture", json={})
    answer = room.server.request(
        method, f"/plugin/moop/{route}", data=json.dumps(sent or {}), headers={"Content-Type": "application/json"}
    )
    assert answer.status_code == 400, answer.text
    assert answer.json()["code"] != "eye" and "Looking failed" not in answer.json()["message"]
