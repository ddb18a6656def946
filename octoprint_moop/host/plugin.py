"""The plugin as OctoPrint sees it: mixins and hooks that hand everything to the watch."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Any

import octoprint.plugin
from octoprint.access import ADMIN_GROUP, READONLY_GROUP, USER_GROUP
from octoprint.access.permissions import Permissions
from octoprint.events import Events

from ..core.errors import FrameError, SettingsError
from ..core.settings import DEFAULTS, VERSION, Settings, described, migrate, read_settings, read_value
from ..machine import recorder
from ..machine.calibrations import Calibrations
from ..machine.copies import find_copy
from ..machine.homing import Homing
from ..machine.ledger import Ledger
from ..machine.link import EyeLink
from ..machine.meshes import Meshes
from ..machine.setups import Setups
from ..machine.watch import REST_S, Job, Watch
from ..machine.webcam import Webcam, octoprint_webcam, webcam_name
from .api import MoopApi
from .api_calibrations import MoopCalibrationsApi
from .api_jobs import MoopJobsApi
from .api_past import MoopPastApi
from .api_setup import MoopSetupApi
from .health import health_checks

REPOSITORY = ("octoprint-moop", "octoprint_moop")


class MoopPlugin(
    MoopApi,
    MoopJobsApi,
    MoopPastApi,
    MoopSetupApi,
    MoopCalibrationsApi,
    octoprint.plugin.StartupPlugin,
    octoprint.plugin.ShutdownPlugin,
    octoprint.plugin.SettingsPlugin,
    octoprint.plugin.EventHandlerPlugin,
    octoprint.plugin.AssetPlugin,
    octoprint.plugin.TemplatePlugin,
    octoprint.plugin.WizardPlugin,
):
    """Wires OctoPrint's printer, webcam, events and settings to one `Watch`. Watch, set-up and replays have an eye each."""

    # --- life -----------------------------------------------------------------------------------------------------

    def initialize(self) -> None:
        data = Path(self.get_plugin_data_folder())
        self._recordings = data / "recordings"
        self._setups, self._found = Calibrations(data / "setups.json"), Setups(data / "found.json")
        self._homing = Homing()
        self._lens_pictures: dict[int, bytes] = {}
        self._lens_found: dict[int, dict[str, Any]] = {}
        self._lens_webcam = ""
        self._lens_last = b""
        self._marked_model = data / "cache" / "model-with-markers.stl"
        self._forget_marked_model()  # of a set-up that nobody ended
        self._pose_picture, self._pose_position_mm = b"", None
        self._bench_lock, self._bed_lock = threading.Lock(), threading.Lock()
        self._meshes, self._meshes_lock = Meshes(data / "meshes"), threading.Lock()
        self._moop_settings = self._stored_settings()
        self._webcam = Webcam(lambda name: octoprint_webcam(name or self._moop_settings.webcam))
        # Questions of the set-up never make a check wait, nor a replay a question: each has an eye of its own, born
        # when first needed.
        self._watch_eye, self._bench_eye, self._replay_eye = EyeLink(), EyeLink(rest_s=REST_S), EyeLink(rest_s=REST_S)
        self._ledger = Ledger(self._tell, self._plugin_version)
        self._watch = Watch(
            self._printer, self._webcam, self._watch_eye, self._recordings, data / "cache", self._moop_settings,
            self._ledger,
        )  # fmt: skip

    def on_after_startup(self) -> None:
        self._watch.start()

    def on_shutdown(self) -> None:
        self._watch.stop()
        self._watch_eye.close()
        self._bench_eye.close()
        self._replay_eye.close()

    def _tell(self, kind: str, payload: dict[str, Any]) -> None:
        """From the watching thread to the pages and to OctoPrint's event bus."""
        if kind in ("status", "check"):
            self._send({"type": kind, kind: payload}, Permissions.PLUGIN_MOOP_VIEW)
        elif kind in ("failed", "unwatched") or (kind == "suspect" and payload["action"] != "none"):
            self._send({"type": kind, **payload}, Permissions.PLUGIN_MOOP_VIEW)
        if kind != "status":
            self._event_bus.fire(f"plugin_{self._identifier}_{kind}", payload)

    def _send(self, message: dict[str, Any], to: Any) -> None:
        """To the pages of those who have this permission."""
        self._plugin_manager.send_plugin_message(self._identifier, message, permissions=[to])

    # --- events ---------------------------------------------------------------------------------------------------

    def on_event(self, event: str, payload: Any) -> None:
        """On the thread that all plugins share: every answer here is to put something into a mailbox."""
        watch = self._watch
        if event in (Events.FILE_ADDED, Events.FILE_SELECTED):
            # an upload names its storage, a selection its origin
            local = payload.get("storage", payload.get("origin")) == "local"
            if local and "gcode" in (payload.get("type") or ("gcode",)):
                watch.job_expected(self._file_manager.path_on_disk("local", payload["path"]))
        elif event == Events.PRINT_STARTED:
            watch.job_started(self._job(payload))
        elif event == Events.PRINT_PAUSED:
            watch.job_paused()
        elif event == Events.PRINT_RESUMED:
            watch.job_resumed()
        elif event == Events.PRINT_DONE:
            watch.job_over("done")
        elif event == Events.PRINT_CANCELLED:
            watch.job_over("cancelled")
        elif event == Events.PRINT_FAILED and payload.get("reason") != "cancelled":  # late, and told before as such
            watch.job_over("failed")
        elif event == Events.PRINT_CANCELLING:
            watch.job_stopping("the print is being cancelled")
        elif event in (Events.DISCONNECTING, Events.PRINTER_RESET, Events.ERROR):
            self._homing.lost()
            watch.job_stopping(f"the printer went away ({event})")
        elif event == Events.DISCONNECTED:
            self._homing.lost()
            watch.job_over("disconnected", lost=True)
        elif event == Events.SHUTDOWN:
            watch.job_stopping("the server stops")

    def _job(self, payload: Any) -> Job:
        name = str(payload.get("name") or payload.get("path") or "")
        origin, path = str(payload.get("origin")), str(payload.get("path") or "")
        key, (profile, webcam) = self._job_key(origin, path), self._setup_key()
        mesh, header = self._mesh_of(key), self._setups.get(profile, webcam)
        if origin != "local":
            why = (
                "This print runs from the printer's own storage, where nobody can hold it for a look. With the same file "
                "among OctoPrint's own, or a model and its layer height attached, it can still be watched."
            )
            uploads, size = Path(self._file_manager.path_on_disk("local", "")), payload.get("size")
            copy = lambda: find_copy(uploads, path, size)  # noqa: E731
            return Job(name, None, header, why, key, mesh, webcam, held=False, copy=copy)
        return Job(name, self._file_manager.path_on_disk("local", path), header, "", key, mesh, webcam)

    def _setup_key(self) -> tuple[str, str]:
        """Printer profile and webcam that a set-up holds for."""
        profile = self._printer_profile_manager.get_current_or_default()
        return str(profile["id"]), webcam_name(self._moop_settings.webcam)

    # --- settings -------------------------------------------------------------------------------------------------

    def get_settings_defaults(self) -> dict[str, Any]:
        return dict(DEFAULTS)

    def get_settings_version(self) -> int:
        return VERSION

    def on_settings_migrate(self, target: int, current: int | None) -> None:
        stored = self._settings.get_all_data(merged=False, incl_defaults=False) or {}
        for name, value in migrate(stored, current).items():
            if name in DEFAULTS and stored.get(name) != value:
                self._settings.set([name], value)

    def on_settings_save(self, data: dict[str, Any]) -> Any:
        good = {}
        for name, value in data.items():
            try:
                good[name] = read_value(name, DEFAULTS.get(name) if value is None else value)
            except SettingsError as error:
                self._logger.warning("Not saved: %s", error)
                self._send({"type": "refused", "setting": name, "message": str(error)}, Permissions.SETTINGS)
        saved = octoprint.plugin.SettingsPlugin.on_settings_save(self, good)
        self._moop_settings = self._stored_settings()
        self._watch.apply(self._moop_settings)
        return saved

    def _stored_settings(self) -> Settings:
        """What is stored, where it makes sense: a value edited by hand into nonsense must not end the watching."""
        values = {}
        for name in DEFAULTS:
            try:
                values[name] = read_value(name, self._settings.get([name]))
            except SettingsError as error:
                self._logger.warning("The default is used: %s", error)
        return read_settings(values)

    # --- page -----------------------------------------------------------------------------------------------------

    def get_assets(self) -> dict[str, list[str]]:
        static = Path(self._basefolder) / "static"
        return {
            kind: sorted(f"{folder}/{path.name}" for path in (static / folder).glob(f"*.{suffix}"))
            for kind, folder, suffix in (("js", "js", "js"), ("css", "css", "css"), ("clientjs", "clientjs", "js"))
        }

    def get_template_vars(self) -> dict[str, Any]:
        return {"fields": described()}

    def is_template_autoescaped(self) -> bool:
        return True

    def is_wizard_required(self) -> bool:
        """OctoPrint's own assistant only points to the set-up in the tab, where one can come back to it."""
        return self._setups.get(*self._setup_key()) is None

    def get_wizard_version(self) -> int:
        return 1

    # --- for other plugins ----------------------------------------------------------------------------------------

    def helpers(self) -> dict[str, Any]:
        """docs/events.md"""
        return {"status": lambda: self._ledger.status, "check_now": lambda: self._watch.check_now()}

    def problems(self) -> list[str]:
        """What keeps the next print from being watched or recorded, as far as that is known without a look."""
        found: list[str] = []
        if not self._moop_settings.watch_prints:
            return found
        if self._setups.get(*self._setup_key()) is None:
            found.append("Prints are not watched: it is not known where the camera stands. Open the MOOP tab's set-up.")
        try:
            octoprint_webcam(self._moop_settings.webcam)
        except FrameError as error:
            found.append(f"Prints are not watched. {error}")
        if self._moop_settings.record and recorder.is_disk_full(self._recordings):
            found.append("Prints are watched but not recorded: the disk is almost full.")
        return found

    # --- hooks ----------------------------------------------------------------------------------------------------

    def hooks(self) -> dict[str, Any]:
        return {
            "octoprint.comm.protocol.gcode.queuing": self.on_gcode_queuing,
            "octoprint.comm.protocol.gcode.sent": self.on_gcode_sent,
            "octoprint.comm.protocol.gcode.received": self.on_gcode_received,
            "octoprint.comm.protocol.atcommand.queuing": self.on_atcommand_queuing,
            "octoprint.comm.protocol.scripts": self.on_script,
            "octoprint.access.permissions": self.permissions,
            "octoprint.server.http.bodysize": self.body_sizes,
            "octoprint.server.http.routes": self.server_routes,
            "octoprint.events.register_custom_events": self.custom_events,
            "octoprint.plugin.backup.additional_excludes": self.backup_excludes,
            "octoprint.plugin.softwareupdate.check_config": self.update_information,
            "octoprint.plugin.health_check.get_additional_checks": lambda: health_checks(self.problems),
        }

    def on_gcode_queuing(
        self, comm: Any, phase: str, cmd: str, cmd_type: Any, gcode: str | None,
        subcode: Any = None, tags: Any = None, *args: Any, **kwargs: Any,
    ) -> Any:  # fmt: skip
        # Comments never come this far and texts may be rewritten: the position in the file is what a line is known by.
        file_pos = _file_pos(tags)
        return None if file_pos is None else self._watch.holds.line_queuing(cmd, file_pos)

    def on_gcode_sent(
        self, comm: Any, phase: str, cmd: str, cmd_type: Any, gcode: str | None,
        subcode: Any = None, tags: Any = None, *args: Any, **kwargs: Any,
    ) -> None:  # fmt: skip
        self._watch.holds.line_sent(gcode, tags)
        self._homing.sent(gcode, cmd)
        if gcode == "M486" or cmd.startswith("EXCLUDE_OBJECT"):
            self._watch.command_sent(cmd)

    def on_gcode_received(self, comm: Any, line: str, *args: Any, **kwargs: Any) -> str:
        self._watch.holds.line_received(line)
        return line

    def on_atcommand_queuing(
        self, comm: Any, phase: str, command: str, parameters: str, tags: Any = None, *args: Any, **kwargs: Any
    ) -> None:
        file_pos = _file_pos(tags)
        if command == "moop" and file_pos is not None and self._moop_settings.capture == "slicer":
            self._watch.holds.mark_queuing(file_pos)

    def on_script(self, comm: Any, kind: str, name: str, *args: Any, **kwargs: Any) -> Any:
        if kind == "gcode" and name == "beforePrintResumed":
            return self._watch.responder.resuming_commands(self._moop_settings), None
        if kind == "gcode" and name == "afterPrintPaused":
            return None, self._watch.responder.pausing_commands(self._moop_settings)
        return None

    def permissions(self, *args: Any, **kwargs: Any) -> list[dict[str, Any]]:
        return [
            {"key": "VIEW", "name": "View", "description": "See the checks, their pictures and the recordings.",
             "roles": ["view"], "default_groups": [READONLY_GROUP, USER_GROUP]},
            {"key": "CONTROL", "name": "Control",
             "description": "Watch or not, check now, try other settings on recordings, delete them.",
             "roles": ["control"], "default_groups": [USER_GROUP]},
            {"key": "CALIBRATE", "name": "Calibrate", "description": "Set up printer geometry, camera and filament.",
             "roles": ["calibrate"], "dangerous": True, "default_groups": [ADMIN_GROUP]},
        ]  # fmt: skip

    def custom_events(self, *args: Any, **kwargs: Any) -> list[str]:
        return ["check", "suspect", "failed", "unusable", "camera_moved", "blind", "unwatched"]

    def backup_excludes(self, excluded: Any, *args: Any, **kwargs: Any) -> list[str]:
        return ["recordings", "cache"]

    def update_information(self) -> dict[str, Any]:
        user, repository = REPOSITORY
        return {
            self._identifier: {
                "displayName": self._plugin_name, "displayVersion": self._plugin_version,
                "current": self._plugin_version,
                "type": "github_release", "user": user, "repo": repository,
                "pip": f"https://github.com/{user}/{repository}/archive/{{target_version}}.zip",
            }
        }  # fmt: skip


def _file_pos(tags: Any) -> int | None:
    """Where the line ends in the file that is printed; None for a line that is not the file's."""
    for tag in tags or ():
        if tag.startswith("filepos:"):
            return int(tag[8:])
    return None
