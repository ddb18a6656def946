"""The routes under /plugin/moop/ for the calibrations that are kept, and for the bed's motion, measured."""

from __future__ import annotations

import json
import threading
import time
from typing import Any

import flask
from octoprint.access.permissions import Permissions
from octoprint.plugin import BlueprintPlugin

from ..core.errors import CalibrationError
from ..core.settings import Settings
from ..machine.calibrations import Calibrations, Seen
from ..machine.homing import Homing, short_move_mm
from ..machine.link import EyeLink
from ..machine.watch import Watch
from ..machine.webcam import Webcam, octoprint_turns
from .routes import body, picture_response

MOVE_TIMEOUT_S = 60.0
SPEED_Y_MM_MIN, SPEED_Z_MM_MIN = 3000, 300


class MoopCalibrationsApi(BlueprintPlugin):
    """Mixed into the plugin, whose attributes it uses."""

    _watch: Watch
    _webcam: Webcam
    _bench_eye: EyeLink
    _setups: Calibrations
    _homing: Homing
    _moop_settings: Settings
    _pose_picture: bytes
    _pose_position_mm: tuple[float, float, float] | None
    _bed_lock: threading.Lock

    # --- what is kept ---------------------------------------------------------------------------------------------

    @BlueprintPlugin.route("/calibrations", methods=["GET"])
    @Permissions.PLUGIN_MOOP_VIEW.require(403)
    def get_calibrations(self) -> Any:
        """Those of the current printer profile and webcam, the newest first, and how the webcam's pictures come now."""
        return flask.jsonify(self._told_calibrations())

    @BlueprintPlugin.route("/calibrations/<int:number>.json", methods=["GET"])
    @Permissions.PLUGIN_MOOP_VIEW.require(403)
    def get_calibration(self, number: int) -> Any:
        """One of them whole, as a file: what `POST setup` reads."""
        profile, webcam = self._setup_key()
        found = self._setups.find(profile, webcam, number)
        data = {
            "format": "moop-recording", "version": 1, **found.parts,
            "name": found.name, "made_at": found.made_at, "error_px": found.error_px,
        }  # fmt: skip
        response = picture_response(json.dumps(data, indent=1).encode() + b"\n", "application/json")
        response.headers["Content-Disposition"] = f'attachment; filename="moop-calibration-{number}.json"'
        return response

    @BlueprintPlugin.route("/calibrations/<int:number>/use", methods=["POST"])
    @Permissions.PLUGIN_MOOP_CALIBRATE.require(403)
    def post_use(self, number: int) -> Any:
        profile, webcam = self._setup_key()
        self._setups.use(profile, webcam, number)
        return flask.jsonify(self._told_calibrations())

    @BlueprintPlugin.route("/calibrations/revert", methods=["POST"])
    @Permissions.PLUGIN_MOOP_CALIBRATE.require(403)
    def post_revert(self) -> Any:
        """Back to the one that was used before."""
        self._setups.revert(*self._setup_key())
        return flask.jsonify(self._told_calibrations())

    @BlueprintPlugin.route("/calibrations/<int:number>", methods=["POST"])
    @Permissions.PLUGIN_MOOP_CALIBRATE.require(403)
    def post_name(self, number: int) -> Any:
        """Another name. Body: `name`."""
        profile, webcam = self._setup_key()
        self._setups.rename(profile, webcam, number, str(body().get("name", "")))
        return flask.jsonify(self._told_calibrations())

    @BlueprintPlugin.route("/calibrations/<int:number>", methods=["DELETE"])
    @Permissions.PLUGIN_MOOP_CALIBRATE.require(403)
    def delete_calibration(self, number: int) -> Any:
        profile, webcam = self._setup_key()
        self._setups.remove(profile, webcam, number)
        return flask.jsonify(self._told_calibrations())

    def _told_calibrations(self) -> dict[str, Any]:
        profile, webcam = self._setup_key()
        now = self._seen_now()
        current = self._setups.current(profile, webcam)
        return {
            "profile": profile, "webcam": webcam, "current": None if current is None else current.id,
            "calibrations": [each.told(now) for each in self._setups.all(profile, webcam)],
            "now": now.__dict__,
        }  # fmt: skip

    def _seen_now(self) -> Seen:
        """How the webcam's pictures come now; their size only where one was taken since the server started."""
        return Seen(self._webcam.size_px(self._setup_key()[1]), **octoprint_turns(self._moop_settings.webcam))

    # --- the bed's motion -----------------------------------------------------------------------------------------

    @BlueprintPlugin.route("/calibrate/bed-motion", methods=["GET"])
    @Permissions.PLUGIN_MOOP_CALIBRATE.require(403)
    def get_bed_motion(self) -> Any:
        """What measuring would do: `can`, or `why` not; `from_mm`, `to_mm`. Nothing moves, but the printer is asked."""
        try:
            position_mm, (dy, dz) = self._short_move()
        except CalibrationError as error:
            return flask.jsonify({"can": False, "why": str(error), "from_mm": None, "to_mm": None})
        x, y, z = position_mm
        to_mm = {"x": x, "y": round(y + dy, 3), "z": round(z + dz, 3)}
        return flask.jsonify({"can": True, "why": "", "from_mm": {"x": x, "y": y, "z": z}, "to_mm": to_mm})

    @BlueprintPlugin.route("/calibrate/bed-motion", methods=["POST"])
    @Permissions.PLUGIN_MOOP_CALIBRATE.require(403)
    @Permissions.CONTROL.require(403)
    def post_bed_motion(self) -> Any:
        """Which way the bed moves, from two pictures at two positions.

        Body: `camera` as just found from the last pose picture, and `printer` (else the profile's); `confirmed`: true,
        the user has agreed to the move that GET tells of. With `moved`: true nothing is moved: the user has moved the
        printer since the pose picture. Answers `bed_motion`, `bed_reference_mm`, `votes`.
        """
        wanted = body()
        if not wanted.get("moved") and wanted.get("confirmed") is not True:
            raise CalibrationError("Nothing is moved before you have agreed to it. Confirm the move, and try again.")
        if not self._bed_lock.acquire(blocking=False):
            raise CalibrationError("The bed's motion is being measured already. Wait for it.")
        try:
            return flask.jsonify(self._measured_motion(wanted))
        finally:
            self._bed_lock.release()

    def _measured_motion(self, wanted: dict[str, Any]) -> dict[str, Any]:
        camera = wanted.get("camera") or (self._setups.get(*self._setup_key()) or {}).get("camera")
        if camera is None:
            raise CalibrationError("The camera's place is not known yet. Find it first, then measure the bed's motion.")
        printer = wanted.get("printer") or self._printer_geometry()
        first, first_mm = self._pose_picture, self._pose_position_mm
        if not first or first_mm is None:
            raise CalibrationError(
                "It is not known where the printer stood when the camera's place was found. Connect and home it, take "
                "that picture again, and then measure."
            )
        if wanted.get("moved"):
            second, second_mm = self._look_at_bed()
        else:
            (_, y, z), (dy, dz) = self._short_move()
            try:
                self._move(y + dy, z + dz, rising=dz > 0)
                second, second_mm = self._look_at_bed()
            finally:
                if self._printer.get_state_id() == "OPERATIONAL":  # a print that has begun meanwhile moves by itself
                    self._move(y, z, rising=dz < 0)
        found, _ = self._bench_eye.ask(
            "bed_motion", first, second, timeout_s=MOVE_TIMEOUT_S, camera=camera, printer=printer,
            first_mm=list(first_mm), second_mm=list(second_mm),
        )  # fmt: skip
        return found

    def _short_move(self) -> tuple[tuple[float, float, float], tuple[float, float]]:
        """(where the printer stands, (dy, dz)). Raises CalibrationError where it may not be moved."""
        position_mm = self._stands_at_mm()
        if position_mm is None:
            raise CalibrationError("The printer does not say where it stands. Connect it, and let no print run.")
        if not self._homing.known:
            raise CalibrationError(
                "The printer was not homed since it was connected, so nobody knows where it stands. Home all axes, take "
                "the picture for the camera's place again, and then measure."
            )
        return position_mm, short_move_mm(position_mm, self._printer_geometry())

    def _look_at_bed(self) -> tuple[bytes, tuple[float, float, float]]:
        """A picture, and where the printer stood."""
        position_mm = self._stands_at_mm(MOVE_TIMEOUT_S)
        if position_mm is None:
            raise CalibrationError("The printer did not say where it stands after the move. Look at it, and try again.")
        time.sleep(self._moop_settings.settle_s + 1.0)  # a picture that the camera had in store passes
        return self._webcam.grab(self._moop_settings.check_timeout_s), position_mm

    def _move(self, y_mm: float, z_mm: float, rising: bool) -> None:
        """Sideways only in the upper of both heights. Absolute: a relative move that gets lost would add up."""
        moves = [({"z": z_mm}, SPEED_Z_MM_MIN), ({"y": y_mm}, SPEED_Y_MM_MIN)]
        for axes, speed in moves if rising else reversed(moves):
            self._printer.jog(axes, relative=False, speed=speed)
