"""What the plugin makes of OctoPrint's events and requests, without a server."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from octoprint_moop.core.settings import DEFAULTS, Settings
from octoprint_moop.host import plugin as host
from octoprint_moop.host.plugin import MoopPlugin


class Told:
    """Keeps what is called, whatever it is."""

    def __init__(self):
        self.calls = []

    def __getattr__(self, name):
        return lambda *given, **named: self.calls.append((name, given, named))


@pytest.fixture
def plugin():
    made = MoopPlugin()
    made._identifier, made._watch, made._homing = "moop", Told(), Told()
    made._plugin_manager, made._event_bus, made._moop_settings = Told(), Told(), Settings()
    return made


def test_a_print_that_begins_right_after_a_cancelled_one_is_watched(plugin):
    """OctoPrint tells of a cancelled print twice, the second time from a thread that first writes to disk."""
    plugin._job = lambda payload: "job"
    plugin.on_event("PrintCancelled", {"name": "a"})
    plugin.on_event("PrintStarted", {"name": "b"})
    plugin.on_event("PrintFailed", {"name": "a", "reason": "cancelled"})
    assert [name for name, *_ in plugin._watch.calls] == ["job_over", "job_started"]
    plugin.on_event("PrintFailed", {"name": "b", "reason": "error"})
    assert plugin._watch.calls[-1][:2] == ("job_over", ("failed",))


def test_what_is_told_goes_only_to_who_may_see_it(plugin):
    plugin._tell("check", {"E": 0.1})
    plugin._tell("failed", {"check": {}, "action": "pause"})
    for _, _, named in plugin._plugin_manager.calls:
        assert [str(permission.key) for permission in named["permissions"]] == ["PLUGIN_MOOP_VIEW"]
    assert len(plugin._plugin_manager.calls) == 2


def test_a_print_is_looked_at_through_the_webcam_that_it_began_with(plugin, monkeypatch):
    monkeypatch.setattr(host, "webcam_name", lambda name: name or "front")
    plugin._file_manager = SimpleNamespace(
        get_metadata=lambda *_: {"hash": "abc"}, path_on_disk=lambda origin, path: f"/uploads/{path}"
    )
    plugin._printer_profile_manager = SimpleNamespace(get_current_or_default=lambda: {"id": "_default"})
    plugin._meshes = SimpleNamespace(get=lambda key: None)
    plugin._setups = SimpleNamespace(get=lambda profile, webcam: {"camera": webcam})
    job = plugin._job({"name": "a.gcode", "path": "a.gcode", "origin": "local"})
    assert (job.webcam, job.header) == ("front", {"camera": "front"})


def test_a_setting_sent_as_null_is_as_by_default(plugin, monkeypatch):
    kept = {}
    plugin._logger = Told()
    plugin._settings = SimpleNamespace(get=lambda path: kept.get(path[0], DEFAULTS[path[0]]))
    monkeypatch.setattr(
        host.octoprint.plugin.SettingsPlugin, "on_settings_save", lambda self, data: kept.update(data) or data
    )
    plugin.on_settings_save({"webcam": None, "every_layers": None, "on_failed": "notify"})
    assert plugin._moop_settings == Settings(on_failed="notify")
    assert not plugin._plugin_manager.calls
