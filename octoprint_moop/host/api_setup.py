"""The routes under /plugin/moop/ that find out and keep what must be known before a print can be watched."""

from __future__ import annotations

import contextlib
import io
import shutil
import tempfile
import threading
from pathlib import Path
from typing import Any

import flask
from octoprint.access.permissions import Permissions
from octoprint.filemanager.util import StreamWrapper
from octoprint.plugin import BlueprintPlugin

from ..core.errors import CalibrationError
from ..core.settings import Settings
from ..machine.calibrations import Calibrations
from ..machine.homing import Homing
from ..machine.ledger import Ledger
from ..machine.link import EyeLink
from ..machine.setups import Setups
from ..machine.watch import Watch
from ..machine.webcam import Webcam
from .routes import body, picture_response, sent_file

QUICK_S, LONG_S = 30.0, 300.0
MATERIAL = ("hue_min_deg", "hue_max_deg", "saturation_min", "value_min")
MARKERS_FILE = "moop-markers.gcode"
MOST_LENS_PICTURES = 40


class MoopSetupApi(BlueprintPlugin):
    """Mixed into the plugin, whose attributes it uses. Looking is done by an eye of its own, the bench."""

    _watch: Watch
    _ledger: Ledger
    _webcam: Webcam
    _bench_eye: EyeLink
    _setups: Calibrations
    _found: Setups
    _homing: Homing
    _moop_settings: Settings
    _lens_pictures: dict[int, bytes]
    _lens_found: dict[int, dict[str, Any]]
    _lens_webcam: str
    _lens_last: bytes
    _marked_model: Path
    _pose_picture: bytes
    _pose_position_mm: tuple[float, float, float] | None
    _bench_lock: threading.Lock

    # --- the set-up as a whole ------------------------------------------------------------------------------------

    @BlueprintPlugin.route("/setup", methods=["GET"])
    @Permissions.PLUGIN_MOOP_VIEW.require(403)
    def get_setup(self) -> Any:
        """What is set now, as a recording's header; without a camera where none has been set up yet."""
        current = self._setups.current(*self._setup_key())
        parts = {"printer": self._printer_geometry()} if current is None else current.parts
        header = {"format": "moop-recording", "version": 1, **parts, "material": self._material({})}
        return flask.jsonify({**header, "calibration": None if current is None else current.told(self._seen_now())})

    @BlueprintPlugin.route("/setup", methods=["POST"])
    @Permissions.PLUGIN_MOOP_CALIBRATE.require(403)
    def post_setup(self) -> Any:
        """Takes over a header, or a calibration that was exported. Body besides, all optional: `name` and `how` it was
        found ("pose", "points"), `error_px`; `turned`: {"flip_h", "flip_v", "rotate_90"} where the pictures that it
        was found from had been turned so, as OctoPrint's pages do."""
        wanted = body()
        header, _ = self._bench_eye.ask("validate", timeout_s=QUICK_S, header=wanted, turned=wanted.get("turned"))
        profile, webcam = self._setup_key()
        parts: dict[str, Any] = {name: header[name] for name in ("printer", "camera", "cameras") if name in header}
        how = wanted.get("how")
        error_px = wanted.get("error_px")
        changed = self._setups.put(
            profile, webcam, parts, str(wanted.get("name") or ""), how if how in ("pose", "points") else "given",
            self._seen_now(), error_px if isinstance(error_px, dict) else None,
        )  # fmt: skip
        material = header.get("material")
        if material is not None and material != self._material({}):
            low, high = material["hue_deg"]
            values = (low, high, material["saturation_min"], material["value_min"])
            self.on_settings_save(dict(zip(MATERIAL, values)))
            self._settings.save(trigger_event=True)
            changed.append("material")
        if how in ("pose", "points"):  # the camera's place is known: what was made to find it may go
            self._forget_marked_model()
        return flask.jsonify(changed=changed, profile=profile, webcam=webcam)

    # --- pictures and colour --------------------------------------------------------------------------------------

    @BlueprintPlugin.route("/frame", methods=["GET"])
    @Permissions.PLUGIN_MOOP_VIEW.require(403)
    def get_frame(self) -> Any:
        return picture_response(self._grab())

    @BlueprintPlugin.route("/segment/preview", methods=["POST"])
    @Permissions.PLUGIN_MOOP_VIEW.require(403)
    def post_segment_preview(self) -> Any:
        """The mask, PNG, of a fresh frame, or of check number `check`, with thresholds not yet saved."""
        wanted = body()
        check_id = wanted.get("check")
        jpeg = self._ledger.picture(check_id, "frame.jpg") if isinstance(check_id, int) else None
        material = wanted if "hue_deg" in wanted else self._material(wanted)
        _, masks = self._bench_eye.ask("segment", jpeg or self._grab(), timeout_s=QUICK_S, material=material)
        return picture_response(masks[0], "image/png")

    # --- the printer ----------------------------------------------------------------------------------------------

    @BlueprintPlugin.route("/calibrate/printer", methods=["GET"])
    @Permissions.PLUGIN_MOOP_CALIBRATE.require(403)
    def get_printer(self) -> Any:
        """A header's `printer` as OctoPrint's profile has it; how the bed moves is for the user to say."""
        return flask.jsonify(printer=self._printer_geometry())

    @BlueprintPlugin.route("/calibrate/markers", methods=["POST"])
    @Permissions.PLUGIN_MOOP_CALIBRATE.require(403)
    def post_markers(self) -> Any:
        """Puts a marker plate's G-code among OctoPrint's files, ready to be printed. Body: fields of PlateSettings."""
        made, blobs = self._bench_eye.ask(
            "markers", timeout_s=QUICK_S, printer=self._printer_geometry(), plate=body()
        )  # fmt: skip
        file = StreamWrapper(MARKERS_FILE, io.BytesIO(blobs[0]))
        path = self._file_manager.add_file("local", MARKERS_FILE, file, allow_overwrite=True)
        self._found.put("markers", "", made["markers"])
        return flask.jsonify(file=path, markers=made["markers"])

    @BlueprintPlugin.route("/calibrate/markers/model", methods=["POST"])
    @Permissions.PLUGIN_MOOP_CALIBRATE.require(403)
    def post_markers_model(self) -> Any:
        """Puts ring markers around the model in the form's `file`, so that each print of it calibrates anew."""
        name, stream = sent_file()
        with stream, tempfile.TemporaryDirectory() as folder:
            model = Path(folder) / f"model{Path(name).suffix.lower()[:8]}"
            with model.open("wb") as target:
                shutil.copyfileobj(stream, target)
            made, blobs = self._bench_eye.ask(
                "markers_around", timeout_s=LONG_S, printer=self._printer_geometry(), model=str(model)
            )
        try:
            self._marked_model.parent.mkdir(parents=True, exist_ok=True)
            self._marked_model.write_bytes(blobs[0])
        except OSError as error:
            raise CalibrationError(f"There is no room for the model with markers: {error.strerror or error}.") from None
        self._found.put("markers", "", made["markers"])
        return flask.jsonify(markers=made["markers"], bytes=len(blobs[0]))

    @BlueprintPlugin.route("/calibrate/markers/model.stl", methods=["GET"])
    @Permissions.PLUGIN_MOOP_CALIBRATE.require(403)
    def get_markers_model(self) -> Any:
        """The model with markers that was made last, until the camera's place is kept."""
        try:
            response = picture_response(self._marked_model.read_bytes(), "model/stl")
        except FileNotFoundError:
            flask.abort(404, "There is no model with markers any more. Make it anew.")
        response.headers["Content-Disposition"] = 'attachment; filename="model-with-markers.stl"'
        return response

    def _forget_marked_model(self) -> None:
        with contextlib.suppress(OSError):  # it is written over the next time
            self._marked_model.unlink()

    # --- the lens -------------------------------------------------------------------------------------------------

    @BlueprintPlugin.route("/calibrate/board.svg", methods=["GET"])
    @Permissions.PLUGIN_MOOP_CALIBRATE.require(403)
    def get_board(self) -> Any:
        _, blobs = self._bench_eye.ask("board_picture", timeout_s=QUICK_S, **_board(flask.request.args))
        return picture_response(blobs[0], "image/svg+xml")

    @BlueprintPlugin.route("/calibrate/lens/pictures", methods=["POST"])
    @Permissions.PLUGIN_MOOP_CALIBRATE.require(403)
    def post_lens_picture(self) -> Any:
        """Takes one picture of the checkerboard and keeps it where the board is seen whole; never with `keep`: false."""
        wanted = body()
        self._lens_last = jpeg = self._grab()
        found, _ = self._bench_eye.ask("find_board", jpeg, timeout_s=QUICK_S, **_board(wanted))
        picture_id = None
        with self._bench_lock:
            self._forget_other_webcams()
            seen = found["corners_px"] is not None and wanted.get("keep") is not False
            if seen and len(self._lens_pictures) < MOST_LENS_PICTURES:
                picture_id = max(self._lens_pictures, default=-1) + 1
                self._lens_pictures[picture_id] = jpeg
                self._lens_found[picture_id] = found
            return flask.jsonify(**found, id=picture_id, kept=len(self._lens_pictures))

    @BlueprintPlugin.route("/calibrate/lens/pictures", methods=["GET"])
    @Permissions.PLUGIN_MOOP_CALIBRATE.require(403)
    def get_lens_pictures(self) -> Any:
        """Those that are kept, with the corners that were seen in them, and the size of the newest."""
        with self._bench_lock:
            self._forget_other_webcams()
            found = dict(self._lens_found)
        pictures = [{"id": picture_id, "corners_px": each["corners_px"]} for picture_id, each in found.items()]
        size_px = next((each["image_size_px"] for each in reversed(list(found.values()))), None)
        return flask.jsonify(pictures=pictures, image_size_px=size_px)

    @BlueprintPlugin.route("/calibrate/lens/last.jpg", methods=["GET"])
    @Permissions.PLUGIN_MOOP_CALIBRATE.require(403)
    def get_last_lens_picture(self) -> Any:
        """The picture in which the board was looked for last, kept or not."""
        return picture_response(self._lens_last) if self._lens_last else flask.abort(404)

    @BlueprintPlugin.route("/calibrate/lens/pictures/<int:picture_id>.jpg", methods=["GET"])
    @Permissions.PLUGIN_MOOP_CALIBRATE.require(403)
    def get_lens_picture(self, picture_id: int) -> Any:
        picture = self._lens_pictures.get(picture_id)
        return flask.abort(404) if picture is None else picture_response(picture)

    @BlueprintPlugin.route("/calibrate/lens/pictures", methods=["DELETE"])
    @Permissions.PLUGIN_MOOP_CALIBRATE.require(403)
    def delete_lens_pictures(self) -> Any:
        with self._bench_lock:
            self._lens_pictures.clear()
            self._lens_found.clear()
        return flask.jsonify({})

    @BlueprintPlugin.route("/calibrate/lens", methods=["POST"])
    @Permissions.PLUGIN_MOOP_CALIBRATE.require(403)
    def post_lens(self) -> Any:
        """The lens from the pictures kept, as `moop calibrate lens --json`; kept for this webcam."""
        with self._bench_lock:
            self._forget_other_webcams()
            pictures = dict(self._lens_pictures)
        names = [str(picture_id) for picture_id in pictures]
        lens, _ = self._bench_eye.ask("lens", *pictures.values(), timeout_s=LONG_S, names=names, **_board(body()))
        self._found.put("lens", self._setup_key()[1], lens)
        return flask.jsonify(lens)

    @BlueprintPlugin.route("/calibrate/lens", methods=["GET"])
    @Permissions.PLUGIN_MOOP_CALIBRATE.require(403)
    def get_lens(self) -> Any:
        """The lens found last for this webcam."""
        return flask.jsonify(lens=self._known_lens())

    def _forget_other_webcams(self) -> None:
        """Pictures of the checkerboard are those of one lens. Under the bench's lock."""
        _, webcam = self._setup_key()
        if webcam != self._lens_webcam:
            self._lens_webcam = webcam
            self._lens_pictures.clear()
            self._lens_found.clear()

    # --- the camera's place ---------------------------------------------------------------------------------------

    @BlueprintPlugin.route("/calibrate/pose", methods=["POST"])
    @Permissions.PLUGIN_MOOP_CALIBRATE.require(403)
    def post_pose(self) -> Any:
        """The camera's place from a fresh picture of the marker plate, as `moop calibrate pose --json`.

        Body, all optional: `markers` (else the plate made last), `lens` (else the one found last), `material`. Answers
        besides: `bed_reference_mm`, where the printer says it stands, or null.
        """
        wanted = body()
        lens = wanted.get("lens") or self._known_lens()
        markers = wanted.get("markers") or self._found.get("markers", "")
        if lens is None:
            raise CalibrationError("The lens is not known yet. Calibrate it with the checkerboard first.")
        if markers is None:
            raise CalibrationError("It is not known where the markers lie. Make the marker plate, or send its markers.")
        standing = self._take_pose_picture()
        found, _ = self._bench_eye.ask(
            "pose", self._pose_picture, timeout_s=LONG_S, lens=lens, markers=markers, material=wanted.get("material")
        )
        return flask.jsonify(**found, bed_reference_mm=standing)

    @BlueprintPlugin.route("/calibrate/points/picture", methods=["POST"])
    @Permissions.PLUGIN_MOOP_CALIBRATE.require(403)
    def post_points_picture(self) -> Any:
        """Takes the picture that is to be clicked on; answers where the printer says it stands, or null."""
        return flask.jsonify(bed_reference_mm=self._take_pose_picture())

    @BlueprintPlugin.route("/calibrate/points", methods=["POST"])
    @Permissions.PLUGIN_MOOP_CALIBRATE.require(403)
    def post_points(self) -> Any:
        """The camera's place from points clicked on the picture taken last, as `moop calibrate points --json`."""
        wanted = body()
        if not self._pose_picture:
            raise CalibrationError("There is no picture yet that was clicked on. Take one first.")
        found, _ = self._bench_eye.ask(
            "points", self._pose_picture, timeout_s=LONG_S, points=wanted.get("points"),
            lens=wanted.get("lens") or self._known_lens(), click_px=_click_px(wanted.get("click_px", 2.0)),
        )  # fmt: skip
        return flask.jsonify(found)

    @BlueprintPlugin.route("/calibrate/picture.jpg", methods=["GET"])
    @Permissions.PLUGIN_MOOP_CALIBRATE.require(403)
    def get_pose_picture(self) -> Any:
        """The picture that the last place was found on, or is to be clicked on."""
        return picture_response(self._pose_picture) if self._pose_picture else flask.abort(404)

    @BlueprintPlugin.route("/calibrate/guides", methods=["POST"])
    @Permissions.PLUGIN_MOOP_CALIBRATE.require(403)
    def post_guides(self) -> Any:
        """The bed's grid and a box on it, as lines in the picture of `camera`. Body: `printer`, `camera`."""
        wanted = body()
        lines, _ = self._bench_eye.ask(
            "guides", timeout_s=QUICK_S, printer=wanted.get("printer") or {}, camera=wanted.get("camera") or {}
        )
        return flask.jsonify(lines)

    # --- together -------------------------------------------------------------------------------------------------

    def _grab(self) -> bytes:
        return self._webcam.grab(self._moop_settings.check_timeout_s)

    def _known_lens(self) -> dict[str, Any] | None:
        profile, webcam = self._setup_key()
        parts = self._setups.get(profile, webcam) or {}
        return self._found.get("lens", webcam) or parts.get("camera")

    def _printer_geometry(self) -> dict[str, Any]:
        profile = self._printer_profile_manager.get_current_or_default()
        return self._bench_eye.ask("printer", timeout_s=QUICK_S, profile=profile)[0]

    def _take_pose_picture(self) -> dict[str, float] | None:
        """Takes the picture that the camera's place is found on; answers where the printer says that it stands."""
        position_mm = self._stands_at_mm()
        self._pose_picture = self._grab()
        self._pose_position_mm = position_mm if self._homing.known else None
        return None if position_mm is None else dict(zip("xyz", position_mm))

    def _stands_at_mm(self, timeout_s: float = 10.0) -> tuple[float, float, float] | None:
        """Where the printer stands, as it says itself; None where it is not connected, or prints."""
        if self._printer.get_state_id() != "OPERATIONAL":
            return None
        return self._watch.holds.where(timeout_s=timeout_s)

    def _material(self, over: dict[str, Any]) -> dict[str, Any]:
        """The filament's thresholds as a recording's header has them: as saved, or as `over` says."""
        low, high, saturation, value = (over.get(name, getattr(self._moop_settings, name)) for name in MATERIAL)
        return {"hue_deg": [low, high], "saturation_min": saturation, "value_min": value}


def _click_px(data: Any) -> float:
    """How exactly somebody clicks. Raises CalibrationError."""
    try:
        return float(data)
    except (TypeError, ValueError):
        raise CalibrationError(f"click_px is {data!r}; a number of pixels is needed.") from None


def _board(data: Any) -> dict[str, Any]:
    """The checkerboard's inner corners and square, as the command line takes them. Raises CalibrationError."""
    try:
        return {"board": str(data.get("board", "9x6")), "square_mm": float(data["square_mm"])}
    except (KeyError, TypeError, ValueError):
        raise CalibrationError("Say how wide a square of the checkerboard is: square_mm, as measured.") from None
