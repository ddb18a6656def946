"""The watch: the one thread that owns the conversation with printer, camera and eye while a print runs.

Everything that happens is put into its mailbox as a call and done in turn. Others read the last published status and
checks, which are never changed once published. Whatever fails here, the print goes on and the status says why nobody
is watching.
"""

from __future__ import annotations

import logging
import queue
import threading
import time
from collections import OrderedDict
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Callable, Protocol

from ..core.errors import FrameError, MoopError
from ..core.settings import Settings
from .holds import Hold, Holds
from .link import EyeGone, EyeLink, Interrupted
from .recorder import Recorder
from .webcam import Webcam

log = logging.getLogger("octoprint.plugins.moop.watch")

OPEN_TIMEOUT_S = 900.0
REVIVALS = 5
KEPT_PICTURES = 60
IDLE = "No print is running."
Tell = Callable[[str, dict[str, Any]], None]


class Printer(Protocol):
    """The part of OctoPrint's printer interface that is used here and in `holds`."""

    def set_job_on_hold(self, value: bool, blocking: bool = True) -> Any: ...
    def get_state_id(self) -> str: ...
    def pause_print(self, *, tags: set[str]) -> None: ...
    def cancel_print(self, *, tags: set[str]) -> None: ...


@dataclass(frozen=True)
class Job:
    """A print that began. header: a recording's header, or None where the set-up was never made."""

    name: str
    path: str | None
    header: dict[str, Any] | None
    why_not: str = ""
    over: threading.Event = field(default_factory=threading.Event)


@dataclass
class _Print:
    """What the thread knows of the print that runs. Nobody else touches it."""

    job: Job
    began_s: float = field(default_factory=time.monotonic)
    recorder: Recorder | None = None
    ends: list[int] = field(default_factory=list)
    layer: int | None = None
    born: int = 0
    revivals: int = 0
    last_pos: float = -1
    last_jpeg: bytes = b""
    told: set[tuple[Any, ...]] = field(default_factory=set)
    action: str = "none"
    reason: str = ""
    switched_off: bool = False


@dataclass(frozen=True)
class _Look:
    jpeg: bytes
    moment: dict[str, Any]
    check: dict[str, Any]


class Watch:
    """Watches prints. Every public method may be called from any thread and returns at once.

    tell : called with (kind, payload) for `status`, `check`, `failed`, `suspect`, `blind`; from this thread only
    """

    def __init__(
        self,
        printer: Printer,
        webcam: Webcam,
        eye: EyeLink,
        recordings: Path,
        cache: Path,
        settings: Settings,
        tell: Tell,
        version: str = "",
    ) -> None:
        self._printer, self._webcam, self._eye = printer, webcam, eye
        self._recordings, self._cache = recordings, cache
        self._settings, self._tell, self._version = settings, tell, version
        self._mailbox: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self.holds = Holds(printer, lambda hold: self._mailbox.put(lambda: self._look(hold)))
        self._print: _Print | None = None
        self._job: Job | None = None
        self._blind: str | None = IDLE
        self._renderer = ""
        self._pictures: OrderedDict[int, dict[str, bytes]] = OrderedDict()
        self._checks: tuple[dict[str, Any], ...] = ()
        self._checked_s = 0.0
        self._status: dict[str, Any] = self._make_status()
        self._thread = threading.Thread(target=self._run, name="moop.watch", daemon=True)

    # --- read by others -------------------------------------------------------------------------------------------

    @property
    def status(self) -> dict[str, Any]:
        """FORMATS.md, section 5."""
        status = self._status
        if status["last_check"] is None:
            return status
        age_s = round(time.monotonic() - self._checked_s, 1)
        return {**status, "last_check": {**status["last_check"], "age_s": age_s}}

    @property
    def checks(self) -> tuple[dict[str, Any], ...]:
        """All checks of this print, or of the last one until the next begins."""
        return self._checks

    def picture(self, check_id: int, kind: str) -> bytes | None:
        """frame.jpg, seen.png, expected.png or ignored.png of a recent check; None where it is not kept any more."""
        return self._pictures.get(check_id, {}).get(kind)

    # --- told by others -------------------------------------------------------------------------------------------

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        self.job_over("the server stops")
        self._mailbox.put(None)
        if self._thread.is_alive():
            self._thread.join(5)

    def job_selected(self, path: str) -> None:
        """A file that will probably be printed: read it ahead, so that the first layers are watched too."""
        self._mailbox.put(lambda: self._read_ahead(path))

    def job_started(self, job: Job) -> None:
        self._job = job
        self._mailbox.put(lambda: self._begin(job))

    def job_stopping(self, why: str, lost: bool = False) -> None:
        """Nothing more can be learned from a hold that stands; it is released. lost: the connection has gone."""
        self.holds.drop(why, lost)

    def job_over(self, how: str, lost: bool = False) -> None:
        if self._job is not None:
            self._job.over.set()
        self.holds.plan_none()
        self.holds.drop(how, lost)
        self._mailbox.put(lambda: self._end(how))

    def apply(self, settings: Settings) -> None:
        self._mailbox.put(lambda: self._apply(settings))

    def watch_this_print(self, watching: bool) -> None:
        self._mailbox.put(lambda: self._switch(watching))

    def check_now(self) -> bool:
        """Look at the very next line of the file. False where nothing is being watched."""
        return self.holds.ask()

    def pardon(self) -> None:
        self._mailbox.put(self._pardon)

    # --- the thread -----------------------------------------------------------------------------------------------

    def _run(self) -> None:
        while True:
            try:
                todo = self._mailbox.get(timeout=2.0)
            except queue.Empty:
                todo = self._look_after_holds
            if todo is None:
                return
            try:
                todo()
            except Exception:
                log.exception("The watch stumbled, and goes on")

    def _begin(self, job: Job) -> None:
        self._print = current = _Print(job)
        self._checks, self._pictures = (), OrderedDict()
        self.holds.plan_none()
        if job.why_not or job.header is None or job.path is None:
            self._publish(blind=job.why_not or "The camera is not calibrated. Run the set-up.")
            return
        if not self._settings.watch_prints:
            self._publish(blind="Watching is switched off in the settings.")
            return
        self._publish(blind="The G-code is being read.")
        header = self._header(current)
        if self._settings.record:
            current.recorder = Recorder(self._recordings, job.name, header, self._settings.recordings_mb * 1_000_000)
        self._open(current)

    def _open(self, current: _Print, again: bool = False) -> None:
        """Make the eye ready for this print, and begin to hold at its layers."""
        assert current.job.path is not None
        folder = current.recorder.folder if current.recorder is not None else None
        packed = folder / "job.gcode.gz" if folder is not None else None
        try:
            result, _ = self._eye.ask(
                "open", timeout_s=OPEN_TIMEOUT_S, interrupted=current.job.over,
                job=current.job.path, header=self._header(current), settings=asdict(self._settings),
                cache=str(self._cache), keep_as=str(packed) if packed is not None else None,
                recording=str(folder) if again and folder is not None else None,
            )  # fmt: skip
        except Interrupted:
            return
        except EyeGone as error:
            self._revive_later(current, str(error))
            return
        except MoopError as error:
            self._publish(blind=str(error))
            return
        current.born = self._eye.births
        current.ends, self._renderer = result["ends"], result["renderer"]
        for note in result["notes"]:
            log.info("%s: %s", current.job.name, note)
        self._plan(current)
        self._publish(blind=None if current.ends else "The file extrudes nothing that could be watched.")

    def _revive_later(self, current: _Print, why: str) -> None:
        """The eye has gone. Start it again, a little later each time, until it is plain that it will not stay."""
        self.holds.plan_none()
        current.revivals += 1
        if current.revivals > REVIVALS:
            self._publish(blind=f"{why} It was started again {REVIVALS} times; this print is not watched any more.")
            return
        self._publish(blind=f"{why} It is being started again.")
        wait_s = 0.0 if current.revivals == 1 else 2.0 ** current.revivals

        def revive() -> None:
            if self._print is current and not current.job.over.is_set():
                self._open(current, again=True)

        timer = threading.Timer(wait_s, lambda: self._mailbox.put(revive))
        timer.daemon = True
        timer.start()

    def _look(self, hold: Hold) -> None:
        """One check, from a hold to its release."""
        current, look, gone = self._print, None, ""
        try:
            if current is not None:
                current.last_pos = hold.file_pos
                current.layer = hold.layer
                look = self._see(current, hold)
                self._act(current, look.check)
        except Interrupted as error:
            log.info("Layer %d was not checked: %s", hold.layer, hold.dropped or error)
        except EyeGone as error:
            gone = str(error)
        except MoopError as error:
            log.warning("Layer %d was not checked: %s", hold.layer, error)
            self._publish(blind=str(error))
        except Exception as error:
            log.exception("Layer %d was not checked", hold.layer)
            self._publish(blind=f"Checking failed ({type(error).__name__}). The log has the details.")
        finally:
            if current is not None and not gone:
                self._plan(current)
            self.holds.release(hold)
        if current is not None and gone:
            log.warning("Layer %d was not checked: %s", hold.layer, gone)
            self._revive_later(current, gone)
        if current is not None and look is not None:
            self._keep(current, look, hold)

    def _see(self, current: _Print, hold: Hold) -> _Look:
        """Wait until the printer stands still, take a picture, and have it checked.

        Raises Interrupted, FrameError, EyeGone, and what the eye raises.
        """
        settings = self._settings
        if not hold.over.wait(settings.settle_timeout_s):
            raise MoopError(
                f"The printer did not report its position within {settings.settle_timeout_s:.0f} s. "
                "If that happens again, its firmware may not know M114."
            )
        if hold.position_mm is None or hold.stopped.wait(settings.settle_s):
            raise Interrupted(hold.dropped)
        deadline_s = time.monotonic() + settings.check_timeout_s
        jpeg = self._fresh(current, hold, deadline_s)
        x, y, z = hold.position_mm
        recorder = current.recorder
        moment = {
            "frame": recorder.name_frame() if recorder is not None else f"frames/{len(self._checks):06d}.jpg",
            "file_pos": hold.file_pos, "layer": hold.layer, "position_mm": {"x": x, "y": y, "z": z},
            "time_s": round(time.monotonic() - current.began_s, 3), "parked": False,
        }  # fmt: skip
        if self._eye.births != current.born:
            raise EyeGone("The process that looks at the pictures was started anew.")
        check, _ = self._eye.ask(
            "check", jpeg, timeout_s=max(deadline_s - time.monotonic(), 1.0), interrupted=hold.stopped, moment=moment
        )
        return _Look(jpeg, moment, check)

    def _fresh(self, current: _Print, hold: Hold, deadline_s: float) -> bytes:
        """A picture that is not, byte for byte, the one of the last check: no sensor delivers the same noise twice."""
        for attempt in range(3):
            if attempt and hold.stopped.wait(0.5):
                raise Interrupted(hold.dropped)
            jpeg = self._webcam.grab(max(deadline_s - time.monotonic(), 0.5), hold.stopped)
            if jpeg != current.last_jpeg:
                current.last_jpeg = jpeg
                return jpeg
        raise FrameError("The webcam delivers the same picture again and again. Restart it.")

    def _act(self, current: _Print, check: dict[str, Any]) -> None:
        """Do what the settings say about a failure; once for each failure."""
        if check["verdict"] != "failed":
            return
        failure = (check["mode"], *sorted(entry["name"] for entry in check["objects"] if entry["verdict"] == "failed"))
        if failure in current.told:
            return
        current.told.add(failure)
        current.action = self._settings.on_failed
        if current.action == "cancel_object":
            current.action = "pause"
        current.reason = check["reason"]
        if current.action == "pause":
            self._printer.pause_print(tags={"moop:mismatch"})
        elif current.action == "cancel":
            self._printer.cancel_print(tags={"moop:mismatch"})
        check["action"] = current.action

    def _keep(self, current: _Print, look: _Look, hold: Hold) -> None:
        """After the release: keep the pictures, write the recording, tell everybody."""
        held_s = time.monotonic() - hold.since_s
        self._checked_s, current.revivals = time.monotonic(), 0
        check_id = len(self._checks)
        check = {**look.check, "id": check_id, "held_s": round(held_s, 3)}
        pictures = {"frame.jpg": look.jpeg}
        try:
            _, masks = self._eye.ask("pictures", timeout_s=20.0, interrupted=current.job.over)
            pictures.update(zip(("seen.png", "expected.png", "ignored.png"), masks))
        except MoopError as error:
            log.debug("No pictures of check %d: %s", check_id, error)
        self._pictures[check_id] = pictures
        while len(self._pictures) > KEPT_PICTURES:
            self._pictures.popitem(last=False)
        self._checks = (*self._checks, check)
        if current.recorder is not None:
            current.recorder.add(look.jpeg, look.moment, look.check)
        log.info("Layer %d: %s, error %s, limit %s, held %.2f s", check["layer"], check["verdict"], check["E"],
                 check["limit"], held_s)  # fmt: skip
        self._publish(blind=None if check["verdict"] != "unusable" else check["reason"])
        self._tell("check", check)
        if check["verdict"] in ("failed", "suspect"):
            self._tell(check["verdict"], {"check": check, "action": check.get("action", "none")})

    def _plan(self, current: _Print) -> None:
        if current.switched_off or current.job.over.is_set() or self._print is not current:
            return
        settings = self._settings
        not_before_s = self._checked_s + settings.min_interval_s if self._checks else 0.0
        self.holds.plan(current.ends, settings.every_layers, current.last_pos, not_before_s)

    def _look_after_holds(self) -> None:
        """What the hooks noticed but had no time to say."""
        if self._print is None or self._blind is not None:
            return
        if self.holds.refused:
            self._publish(blind=f"The print cannot be held for a look ({self.holds.refused}).")
        elif self.holds.missed >= 3:
            self._publish(blind="The lines that are sent do not match the file. Was it changed after it was read?")

    def _end(self, how: str) -> None:
        current, self._print = self._print, None
        if current is not None and current.recorder is not None:
            current.recorder.end(how)
        self._publish(blind=IDLE, ended=current)

    def _read_ahead(self, path: str) -> None:
        if self._print is None:
            try:
                result, _ = self._eye.ask("index", timeout_s=OPEN_TIMEOUT_S, job=path, cache=str(self._cache))
                self._renderer = result["renderer"]
                self._publish(blind=IDLE)
            except MoopError as error:
                log.info("%s: %s", path, error)

    def _apply(self, settings: Settings) -> None:
        before, self._settings = self._settings, settings
        current = self._print
        if current is None or not current.ends:
            return
        looks_different = ("hue_min_deg", "hue_max_deg", "saturation_min", "value_min", "segmentation", "sensitivity")
        if any(getattr(before, name) != getattr(settings, name) for name in looks_different):
            self._open(current, again=True)
        else:
            self._plan(current)

    def _switch(self, watching: bool) -> None:
        current = self._print
        if current is None or not current.ends:
            return
        current.switched_off = not watching
        if watching:
            self._plan(current)
            self._publish(blind=None)
        else:
            self.holds.plan_none()
            self._publish(blind="Watching was switched off for this print.")

    def _pardon(self) -> None:
        current = self._print
        if current is not None:
            current.action, current.reason = "none", ""
            self._publish(blind=self._blind)

    def _header(self, current: _Print) -> dict[str, Any]:
        settings = self._settings
        material = {
            "hue_deg": [settings.hue_min_deg, settings.hue_max_deg],
            "saturation_min": settings.saturation_min, "value_min": settings.value_min,
        }  # fmt: skip
        try:
            size = Path(current.job.path or "").stat().st_size
        except OSError:  # deleted or renamed meanwhile
            size = 0
        head = {"format": "moop-recording", "version": 1, "job": {"file": "job.gcode", "bytes": size}}
        return {**head, **(current.job.header or {}), "material": material}

    def _publish(self, blind: str | None, ended: _Print | None = None) -> None:
        news = blind is not None and blind not in (self._blind, IDLE)
        self._blind = blind
        self._status = self._make_status(ended)
        self._tell("status", self.status)
        if news:
            self._tell("blind", {"reason": blind})

    def _make_status(self, ended: _Print | None = None) -> dict[str, Any]:
        current = self._print or ended
        return {
            "watching": self._print is not None and self._blind is None,
            "blind": self._blind,
            "job": current.job.name if current is not None else None,
            "layer": current.layer if current is not None else None,
            "layers": len(current.ends) or None if current is not None else None,
            "checks": len(self._checks),
            "last_check": self._checks[-1] if self._checks else None,
            "action": current.action if current is not None else "none",
            "reason": current.reason if current is not None else "",
            "renderer": self._renderer,
            "version": self._version,
        }
