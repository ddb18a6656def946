"""What the plugin makes of OctoPrint's events and requests, without a server."""

from __future__ import annotations

import threading
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


@pytest.mark.parametrize(("state", "moves"), [("OPERATIONAL", [30.0, 80.0, 20.0, 10.0]), ("STARTING", [30.0, 80.0])])
def test_a_bed_is_not_moved_back_into_a_print_that_has_begun_meanwhile(plugin, monkeypatch, state, moves):
    """With positions that are relative by now, or a head that is being homed."""
    at, jogged = {"state": "OPERATIONAL"}, []
    plugin._printer = SimpleNamespace(
        get_state_id=lambda: at["state"], jog=lambda axes, **_: jogged.extend(axes.values())
    )
    plugin._pose_picture, plugin._pose_position_mm = b"jpeg", (10.0, 20.0, 10.0)
    plugin._bench_eye = SimpleNamespace(ask=lambda *_, **__: ({"bed_motion": "y"}, []))
    monkeypatch.setattr(plugin, "_short_move", lambda: ((10.0, 20.0, 10.0), (60.0, 20.0)))

    def look():
        at["state"] = state
        return b"jpeg", (10.0, 80.0, 30.0)

    monkeypatch.setattr(plugin, "_look_at_bed", look)
    assert plugin._measured_motion({"camera": {"K": 1}, "printer": {"origin": "center"}}) == {"bed_motion": "y"}
    assert jogged == moves


def test_thumbnails_go_with_their_recordings(plugin, tmp_path, monkeypatch):
    flask = pytest.importorskip("flask")
    plugin._recordings = tmp_path / "recordings"
    kept = tmp_path / "cache" / "thumbnails"
    kept.mkdir(parents=True)
    folder = plugin._recordings / "2026-11-22_12-00-00_a.b"
    (folder / "frames").mkdir(parents=True)
    (folder / "frames" / "000001.jpg").write_bytes(b"jpeg")
    (folder / "frames.jsonl").write_text('{"frame": "frames/000001.jpg"}\n')
    for name in ("2025-01-01_00-00-00_gone.000009.jpg", f"{folder.name}.000000.jpg"):
        (kept / name).write_bytes(b"old")
    plugin._bench_eye = SimpleNamespace(ask=lambda *_, **__: ({}, [b"small"]))
    with flask.Flask("test").test_request_context():
        monkeypatch.setattr(
            "octoprint_moop.host.api_past.MoopPastApi._recording", lambda self, name: folder, raising=False
        )
        plugin.get_thumbnail.__wrapped__(plugin, folder.name)
    assert [path.name for path in kept.iterdir()] == [f"{folder.name}.000001.jpg"]


def test_a_replay_that_waits_for_its_turn_leaves_the_pictures_of_the_one_that_runs_alone(plugin, tmp_path, monkeypatch):
    flask = pytest.importorskip("flask")
    plugin._recordings, plugin._moop_settings = tmp_path / "recordings", Settings()
    running = tmp_path / "cache" / "replay" / "one"
    running.mkdir(parents=True)
    there = []
    plugin._replay_eye = SimpleNamespace(ask=lambda *_, **__: (there.append(running.is_dir()), ({}, [b"{}"]))[1])
    monkeypatch.setattr(type(plugin), "_recording", lambda self, name: tmp_path / name)
    with flask.Flask("test").test_request_context(json={}):
        type(plugin).post_replay.__wrapped__(plugin, "two")
    assert there == [True]


def test_pictures_of_the_checkerboard_are_those_of_one_webcam(plugin, monkeypatch):
    """A lens from pictures of two cameras would be neither's."""
    flask = pytest.importorskip("flask")
    chosen, asked = ["front"], []
    plugin._lens_pictures, plugin._lens_found, plugin._lens_webcam = {}, {}, ""
    plugin._bench_lock, plugin._found = threading.Lock(), Told()
    found = {"corners_px": [[1, 1]], "image_size_px": [64, 48]}
    plugin._bench_eye = SimpleNamespace(ask=lambda do, *blobs, **_: (asked.append((do, blobs)), (dict(found), []))[1])
    monkeypatch.setattr(plugin, "_setup_key", lambda: ("_default", chosen[0]))
    monkeypatch.setattr(plugin, "_grab", lambda: chosen[0].encode())
    board = {"board": "9x6", "square_mm": 15}
    with flask.Flask("test").test_request_context(json=board, method="POST"):
        plugin.post_lens_picture.__wrapped__(plugin)
        chosen[0] = "side"
        assert plugin.get_lens_pictures.__wrapped__(plugin).get_json()["pictures"] == []
        assert plugin.post_lens_picture.__wrapped__(plugin).get_json()["kept"] == 1
        plugin.post_lens.__wrapped__(plugin)
    assert asked[-1] == ("lens", (b"side",))
