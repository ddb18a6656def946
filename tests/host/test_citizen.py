"""What OctoPrint expects of its plugins: webcams, settings, backups, updates, health."""

from __future__ import annotations

import importlib.metadata
import json

import pytest

from octoprint_moop.core import settings as formats
from octoprint_moop.core.settings import VERSION, migrate

from .room import box_gcode, header


def test_another_webcam_can_be_chosen_and_has_a_set_up_of_its_own(room, saved):
    saved(webcam="second")
    assert room.moop("GET", "setup").get("camera") is None
    try:
        assert room.server.request("GET", "/plugin/moop/frame").content.startswith(b"\xff\xd8")
        assert room.server.api("GET", "/api/plugin/spy")["taken"] == 1
        room.moop("POST", "setup", json=header())
        room.print(box_gcode(layers=2))
        room.wait_done()
        assert len(room.checks) == 2
        assert room.server.api("GET", "/api/plugin/spy")["taken"] >= 3
    finally:
        saved(webcam="")
    assert room.moop("GET", "setup")["camera"] == header()["camera"]


def test_a_webcam_that_is_not_there_is_named(room, saved):
    saved(webcam="upstairs")
    answer = room.server.request("GET", "/plugin/moop/frame")
    assert answer.status_code == 400 and "'upstairs'" in answer.json()["message"]


def test_settings_of_an_older_format_are_carried_over(monkeypatch):
    monkeypatch.setattr(formats, "VERSION", VERSION + 2)
    steps = {VERSION: lambda old: {"b": old["a"], "c": old["c"]}, VERSION + 1: lambda old: {**old, "b": old["b"] * 2}}
    monkeypatch.setattr(formats, "MIGRATIONS", steps)
    assert migrate({"a": 21, "c": 0}, VERSION) == {"b": 42, "c": 0}
    assert migrate({"b": 21}, VERSION + 1) == {"b": 42}


def test_stored_settings_carry_their_format_and_only_what_differs_from_the_defaults(room, saved):
    saved(every_layers=3)
    stored = (room.server.basedir / "config.yaml").read_text()
    assert "_config_version: 1" in stored and "every_layers: 3" in stored
    assert "park_speed_mm_s" not in stored


def test_the_health_check_names_what_keeps_prints_from_being_watched():
    checks = pytest.importorskip("octoprint.plugins.health_check.checks")
    from octoprint_moop.host.health import health_checks

    problems = ["The camera is away."]
    (kind,) = health_checks(lambda: problems)
    assert issubclass(kind, checks.HealthCheck) and kind.key == "moop"
    result = kind().perform_check()
    assert checks.Result(result.result) == checks.Result.WARNING and result.context == {"problems": problems}
    assert json.loads(result.model_dump_json())["result"] == "warning"
    problems.clear()
    assert checks.Result(kind().perform_check(force=True).result) == checks.Result.OK


def test_recordings_and_caches_stay_out_of_backups_and_updates_come_from_our_own_repository():
    from octoprint_moop.host.plugin import REPOSITORY, MoopPlugin

    plugin = MoopPlugin()
    plugin._identifier, plugin._plugin_name, plugin._plugin_version = "moop", "MOOP", "1.2.3"
    hooks = plugin.hooks()
    assert set(hooks["octoprint.plugin.backup.additional_excludes"](None)) >= {"recordings", "cache"}
    update = hooks["octoprint.plugin.softwareupdate.check_config"]()["moop"]
    assert (update["type"], update["current"]) == ("github_release", "1.2.3")
    assert (update["user"], update["repo"]) == REPOSITORY and "/".join(REPOSITORY) in update["pip"]
    assert "{target_version}" in update["pip"]
    home = importlib.metadata.metadata("octoprint-moop").get_all("Project-URL") or []
    assert all("/".join(REPOSITORY) in line for line in home if "github" in line)
