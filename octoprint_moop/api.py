"""The plugin's routes under /plugin/moop/: check the permission, parse, call, answer."""

from __future__ import annotations

import tempfile
import zipfile
from pathlib import Path
from typing import Any

import flask
from octoprint.access.permissions import Permissions
from octoprint.plugin import BlueprintPlugin

from .core.errors import MoopError, RecordingError
from .machine import recorder
from .machine.ledger import Ledger
from .machine.watch import Watch
from .machine.webcam import Webcam

BENCH_TIMEOUT_S = 30.0
PICTURES = {"frame.jpg": "image/jpeg", "seen.png": "image/png", "expected.png": "image/png", "ignored.png": "image/png"}
MATERIAL = ("hue_min_deg", "hue_max_deg", "saturation_min", "value_min")


class MoopApi(BlueprintPlugin):
    """Mixed into the plugin, whose attributes it uses. Every route names the permission that it needs."""

    _watch: Watch
    _ledger: Ledger
    _webcam: Webcam
    _recordings: Path

    def is_blueprint_protected(self) -> bool:
        return False  # a session is not the measure: each route asks for its own permission

    def is_blueprint_csrf_protected(self) -> bool:
        return True

    @BlueprintPlugin.errorhandler(MoopError)
    def on_moop_error(self, error: MoopError) -> Any:
        return flask.jsonify(code=error.code, message=str(error)), 400

    # --- watching -------------------------------------------------------------------------------------------------

    @BlueprintPlugin.route("/status", methods=["GET"])
    @Permissions.PLUGIN_MOOP_VIEW.require(403)
    def get_status(self) -> Any:
        return flask.jsonify(self._ledger.status)

    @BlueprintPlugin.route("/checks", methods=["GET"])
    @Permissions.PLUGIN_MOOP_VIEW.require(403)
    def get_checks(self) -> Any:
        return flask.jsonify(checks=self._ledger.checks)

    @BlueprintPlugin.route("/checks/<int:check_id>/<kind>", methods=["GET"])
    @Permissions.PLUGIN_MOOP_VIEW.require(403)
    def get_picture(self, check_id: int, kind: str) -> Any:
        picture = self._ledger.picture(check_id, kind) if kind in PICTURES else None
        if picture is None:
            flask.abort(404, "This picture is not kept any more.")
        return _picture(picture, PICTURES[kind])

    @BlueprintPlugin.route("/check", methods=["POST"])
    @Permissions.PLUGIN_MOOP_CONTROL.require(403)
    def post_check(self) -> Any:
        if not self._watch.check_now():
            flask.abort(409, "Nothing is being watched just now, or a check is under way.")
        return flask.jsonify({})

    @BlueprintPlugin.route("/watch", methods=["POST"])
    @Permissions.PLUGIN_MOOP_CONTROL.require(403)
    def post_watch(self) -> Any:
        watching = _body().get("watching")
        if not isinstance(watching, bool):
            flask.abort(400, "Send {\"watching\": true} or {\"watching\": false}.")
        self._watch.watch_this_print(watching)
        return flask.jsonify({})

    @BlueprintPlugin.route("/pardon", methods=["POST"])
    @Permissions.PLUGIN_MOOP_CONTROL.require(403)
    def post_pardon(self) -> Any:
        self._watch.pardon()
        return flask.jsonify({})

    # --- set-up ---------------------------------------------------------------------------------------------------

    @BlueprintPlugin.route("/frame", methods=["GET"])
    @Permissions.PLUGIN_MOOP_VIEW.require(403)
    def get_frame(self) -> Any:
        return _picture(self._webcam.grab(self._moop_settings.check_timeout_s), "image/jpeg")

    @BlueprintPlugin.route("/segment/preview", methods=["POST"])
    @Permissions.PLUGIN_MOOP_VIEW.require(403)
    def post_segment_preview(self) -> Any:
        """The mask, PNG, of a fresh frame, or of check number `check`, with thresholds not yet saved."""
        wanted = _body()
        check_id = wanted.get("check")
        jpeg = self._ledger.picture(check_id, "frame.jpg") if isinstance(check_id, int) else None
        if jpeg is None:
            jpeg = self._webcam.grab(self._moop_settings.check_timeout_s)
        material = wanted if "hue_deg" in wanted else self._material(wanted)
        _, masks = self._bench_eye.ask("segment", jpeg, timeout_s=BENCH_TIMEOUT_S, material=material)
        return _picture(masks[0], "image/png")

    @BlueprintPlugin.route("/setup", methods=["GET"])
    @Permissions.PLUGIN_MOOP_VIEW.require(403)
    def get_setup(self) -> Any:
        found = self._setups.get(*self._setup_key())
        if found is None:
            raise MoopError("Nothing is set up for this printer profile and webcam. Run the set-up.")
        header = {"format": "moop-recording", "version": 1, **found, "material": self._material({})}
        return flask.jsonify(header)

    @BlueprintPlugin.route("/setup", methods=["POST"])
    @Permissions.PLUGIN_MOOP_CALIBRATE.require(403)
    def post_setup(self) -> Any:
        header, _ = self._bench_eye.ask("validate", timeout_s=BENCH_TIMEOUT_S, header=_body())
        profile, webcam = self._setup_key()
        changed = self._setups.put(profile, webcam, header)
        material = header.get("material")
        if material is not None and material != self._material({}):
            low, high = material["hue_deg"]
            values = (low, high, material["saturation_min"], material["value_min"])
            self.on_settings_save(dict(zip(MATERIAL, values)))
            self._settings.save(trigger_event=True)
            changed.append("material")
        return flask.jsonify(changed=changed, profile=profile, webcam=webcam)

    def _material(self, over: dict[str, Any]) -> dict[str, Any]:
        """The filament's thresholds as a recording's header has them: as saved, or as `over` says."""
        low, high, saturation, value = (over.get(name, getattr(self._moop_settings, name)) for name in MATERIAL)
        return {"hue_deg": [low, high], "saturation_min": saturation, "value_min": value}

    # --- recordings -----------------------------------------------------------------------------------------------

    @BlueprintPlugin.route("/recordings", methods=["GET"])
    @Permissions.PLUGIN_MOOP_VIEW.require(403)
    def get_recordings(self) -> Any:
        newest_first = reversed(recorder.kept(self._recordings))
        return flask.jsonify(recordings=[recording.to_json() for recording in newest_first])

    @BlueprintPlugin.route("/recordings/<name>.zip", methods=["GET"])
    @Permissions.PLUGIN_MOOP_VIEW.require(403)
    def get_recording(self, name: str) -> Any:
        """One recording, packed; without its pictures where `?pictures=0`."""
        folder = self._recording(name)
        packed = tempfile.TemporaryFile()
        with zipfile.ZipFile(packed, "w", zipfile.ZIP_STORED) as target:  # JPEG and gzip do not shrink again
            for path in sorted(folder.rglob("*")):
                if path.is_file() and (path.suffix != ".jpg" or flask.request.args.get("pictures") != "0"):
                    target.write(path, str(Path(name) / path.relative_to(folder)))
        packed.seek(0)
        return flask.send_file(packed, "application/zip", as_attachment=True, download_name=f"{name}.zip")

    @BlueprintPlugin.route("/recordings/<name>", methods=["DELETE"])
    @Permissions.PLUGIN_MOOP_CONTROL.require(403)
    def delete_recording(self, name: str) -> Any:
        recorder.remove(self._recording(name))
        return flask.jsonify({})

    def _recording(self, name: str) -> Path:
        folder = recorder.find(self._recordings, name)
        if folder is None:
            raise RecordingError(f"There is no recording {name!r}. It may have been removed to make room.")
        return folder


def _body() -> dict[str, Any]:
    data = flask.request.get_json(silent=True)
    if not isinstance(data, dict):
        flask.abort(400, "A JSON object is needed.")
    return data


def _picture(data: bytes, mimetype: str) -> Any:
    response = flask.Response(data, mimetype=mimetype)
    response.headers["Cache-Control"] = "no-store"
    return response
