"""The routes under /plugin/moop/ that have to do with watching and recordings."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import flask
from octoprint.access.permissions import Permissions
from octoprint.plugin import BlueprintPlugin

from ..core.errors import MoopError, RecordingError
from ..machine import recorder
from ..machine.ledger import Ledger
from ..machine.watch import Watch
from .downloads import recording_route
from .routes import body, picture_response

PICTURES = {"frame.jpg": "image/jpeg", "seen.png": "image/png", "expected.png": "image/png", "ignored.png": "image/png"}


class MoopApi(BlueprintPlugin):
    """Mixed into the plugin, whose attributes it uses. Every route names the permission that it needs."""

    _watch: Watch
    _ledger: Ledger
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
        return flask.Response(self._ledger.checks_json, mimetype="application/json")

    @BlueprintPlugin.route("/checks/<int:check_id>/<kind>", methods=["GET"])
    @Permissions.PLUGIN_MOOP_VIEW.require(403)
    def get_picture(self, check_id: int, kind: str) -> Any:
        picture = self._ledger.picture(check_id, kind) if kind in PICTURES else None
        if picture is None:
            flask.abort(404, "This picture is not kept any more.")
        return picture_response(picture, PICTURES[kind])

    @BlueprintPlugin.route("/check", methods=["POST"])
    @Permissions.PLUGIN_MOOP_CONTROL.require(403)
    def post_check(self) -> Any:
        if not self._watch.check_now():
            flask.abort(409, "Nothing is being watched just now, or a check is under way.")
        return flask.jsonify({})

    @BlueprintPlugin.route("/watch", methods=["POST"])
    @Permissions.PLUGIN_MOOP_CONTROL.require(403)
    def post_watch(self) -> Any:
        watching = body().get("watching")
        if not isinstance(watching, bool):
            flask.abort(400, 'Send {"watching": true} or {"watching": false}.')
        self._watch.watch_this_print(watching)
        return flask.jsonify({})

    @BlueprintPlugin.route("/pardon", methods=["POST"])
    @Permissions.PLUGIN_MOOP_CONTROL.require(403)
    def post_pardon(self) -> Any:
        self._watch.pardon()
        return flask.jsonify({})

    # --- recordings -----------------------------------------------------------------------------------------------

    @BlueprintPlugin.route("/recordings", methods=["GET"])
    @Permissions.PLUGIN_MOOP_VIEW.require(403)
    def get_recordings(self) -> Any:
        newest_first = reversed(recorder.kept(self._recordings))
        return flask.jsonify(recordings=[recording.to_json() for recording in newest_first])

    def server_routes(self, known: Any, *args: Any, **kwargs: Any) -> list[tuple[str, type, dict[str, Any]]]:
        """What is too large for the routes above: see `downloads`."""
        return [recording_route(self._recording)]

    @BlueprintPlugin.route("/recordings/<name>", methods=["DELETE"])
    @Permissions.PLUGIN_MOOP_CONTROL.require(403)
    def delete_recording(self, name: str) -> Any:
        folder = self._recording(name)
        if name == self._ledger.status["recording"]:
            raise RecordingError("This recording is being written. It can be deleted when the print is over.")
        recorder.remove(folder)
        return flask.jsonify({})

    def _recording(self, name: str) -> Path:
        folder = recorder.find(self._recordings, name)
        if folder is None:
            raise RecordingError(f"There is no recording {name!r}. It may have been removed to make room.")
        return folder
