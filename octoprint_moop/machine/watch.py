"""The watch: the one thread that owns the conversation with printer, camera and eye while a print runs.

Everything that happens is put into its mailbox as a call and done in turn; what others may know of it stands in the
ledger. Whatever fails here, the print goes on and the ledger says why nobody is watching.
"""

from __future__ import annotations

import logging
import queue
import threading
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Callable

from ..core.errors import FrameError, MoopError
from ..core.settings import Settings
from . import blindness
from .acting import Actor
from .holds import Hold, Holds
from .jobs import Job, Print
from .ledger import Ledger
from .link import EyeGone, EyeLink, Interrupted
from .parking import Modes, Park, modes_at
from .recorder import Recorder
from .webcam import Webcam

log = logging.getLogger("octoprint.plugins.moop.watch")

OPEN_TIMEOUT_S = 900.0
REVIVALS = 5
TICK_S = 2.0
BY_HEIGHT_S = 60.0
"""How often to look where no G-code tells when a layer ends."""
GLANCE_S = 1.5
"""How long a picture may take while the firmware stands still."""
REST_S = 600.0
"""After so long without a print the eye is closed, and its memory given back."""


@dataclass(frozen=True)
class _Look:
    jpeg: bytes
    moment: dict[str, Any]
    check: dict[str, Any]


class Watch:
    """Watches prints. Every public method may be called from any thread and returns at once."""

    def __init__(
        self,
        printer: Any,
        webcam: Webcam,
        eye: EyeLink,
        recordings: Path,
        cache: Path,
        settings: Settings,
        ledger: Ledger,
    ) -> None:
        """printer : OctoPrint's; what is used of it is said by the protocols in `holds` and `acting`"""
        self._webcam, self._eye = webcam, eye
        self._recordings, self._cache = recordings, cache
        self._settings, self._ledger = settings, ledger
        self._mailbox: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self.holds = Holds(printer, lambda hold: self._mailbox.put(lambda: self._look(hold)))
        self.actor = Actor(printer)
        self._print: Print | None = None
        self._job: Job | None = None
        self._paused = False
        self._idle_since_s = time.monotonic()
        self._thread = threading.Thread(target=self._run, name="moop.watch", daemon=True)

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
        self._job, self._paused = job, False
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

    def job_paused(self) -> None:
        """Ours or not: the hot end cools after a while only where we are the cause."""
        self._paused = True
        if self._ledger.status["action"] == "pause" and self._settings.cool_after_min:
            self.actor.cool_later(self._settings.cool_after_min * 60)

    def job_resumed(self) -> None:
        self._paused = False
        self._mailbox.put(self._go_on)

    def apply(self, settings: Settings) -> None:
        self._mailbox.put(lambda: self._apply(settings))

    def watch_this_print(self, watching: bool) -> None:
        self._mailbox.put(lambda: self._switch(watching))

    def check_now(self) -> bool:
        """Look at the very next line of the file. False where nothing is being watched."""
        job = self._job
        if job is not None and not job.held and not job.over.is_set():
            self._mailbox.put(self._look_if_ready)
            return True
        return self.holds.ask()

    def mesh_changed(self, key: str, mesh: dict[str, Any] | None) -> None:
        """A user gave a job another mesh, or placed it anew; None where the G-code alone is to be used."""
        self._mailbox.put(lambda: self._take_mesh(key, mesh))

    def pardon(self) -> None:
        """What was found is not a failure: take it back."""
        self._mailbox.put(lambda: self._settle_it("pardon"))

    def command_sent(self, command: str) -> None:
        """Somebody, ourselves perhaps, sent a command; it may make the firmware skip an object from now on."""
        name = self.actor.cancelled_by(command)
        if name is not None:
            self._mailbox.put(lambda: self._skip(name))

    # --- the thread -----------------------------------------------------------------------------------------------

    def _run(self) -> None:
        while True:
            try:
                todo = self._mailbox.get(timeout=TICK_S)
            except queue.Empty:
                todo = self._tick
            if todo is None:
                return
            try:
                todo()
            except Exception:
                log.exception("The watch stumbled, and goes on")

    def _begin(self, job: Job) -> None:
        self._print = current = Print(job, job.mesh)
        self.holds.plan_none()
        self.actor.begin()
        self._ledger.begin(job.name)
        if job.mesh is None and (job.why_not or job.path is None):
            self._ledger.blind(blindness.NOT_LOCAL, job.why_not or "This print's file is not OctoPrint's own.")
            return
        if job.header is None:
            self._ledger.blind(blindness.NOT_SET_UP, "The camera is not calibrated. Run the set-up.")
            return
        if not self._settings.watch_prints:
            self._ledger.blind(blindness.OFF, "Watching is switched off in the settings.")
            return
        if self._settings.record:
            budget_bytes = self._settings.recordings_mb * 1_000_000
            current.recorder = Recorder(self._recordings, job.name, self._header(current), budget_bytes)
        self._open(current)

    def _open(self, current: Print, again: bool = False) -> None:
        """Make the eye ready for this print, and begin to hold at its layers."""
        folder = current.recorder.folder if current.recorder is not None else None
        packed = folder / "job.gcode.gz" if folder is not None else None
        # The packed copy is what is being printed, whatever has become of the file since.
        job = packed if again and packed is not None and packed.exists() else current.job.path
        again = again and current.ready
        try:
            result, _ = self._eye.ask(
                "open", timeout_s=OPEN_TIMEOUT_S, interrupted=current.job.over,
                job=None if job is None else str(job), header=self._header(current), settings=asdict(self._settings),
                mesh=current.mesh, cache=str(self._cache), keep_as=str(packed) if packed is not None else None,
                keep_mesh_as=str(folder / "model.stl") if folder is not None else None,
                recording=str(folder) if again and folder is not None else None, said=current.said,
            )  # fmt: skip
        except Interrupted:
            return
        except EyeGone as error:
            self._revive_later(current, str(error))
            return
        except MoopError as error:
            self._ledger.blind(error.code, str(error))
            return
        current.born, current.ready, current.by_height = self._eye.births, True, result["road"] == "height"
        current.ends, current.bounds_mm = result["ends"], result["bounds_mm"]
        current.modes = [Modes.from_json(modes) for modes in result["modes"]]
        for note in result["notes"]:
            log.info("%s: %s", current.job.name, note)
        if not again:
            self.actor.begin(result["objects"], result["cancel_commands"])
        self._plan(current)
        self._ledger.note(renderer=result["renderer"], layers=result["layers"], road=result["road"])
        if result["layers"]:
            self._ledger.note(blind=None)
        else:
            self._ledger.blind(blindness.NO_LAYERS, "The file extrudes nothing that could be watched.")

    def _revive_later(self, current: Print, why: str) -> None:
        """The eye has gone. Start it again, a little later each time, until it is plain that it will not stay."""
        self.holds.plan_none()
        current.revivals += 1
        if current.revivals > REVIVALS:
            why = f"{why} It was started again {REVIVALS} times; this print is not watched any more."
            self._ledger.blind(EyeGone.code, why)
            return
        self._ledger.blind(blindness.RESTARTING, f"{why} It is being started again.")

        def revive() -> None:
            if self._print is current and not current.job.over.is_set():
                self._open(current, again=True)

        wait_s = 0.0 if current.revivals == 1 else 2.0**current.revivals
        timer = threading.Timer(wait_s, lambda: self._mailbox.put(revive))
        timer.daemon = True
        timer.start()

    def _look(self, hold: Hold) -> None:
        """One check, from a hold to its release."""
        current, look, gone = self._print, None, ""
        try:
            if current is not None:
                current.last_pos, current.looked_s = hold.file_pos, hold.since_s
                look = self._see(current, hold)
                self._act(look.check)
        except Interrupted as error:
            log.info("Layer %d was not checked: %s", hold.layer, hold.dropped or error)
        except EyeGone as error:
            gone = str(error)
        except MoopError as error:
            log.warning("Layer %d was not checked: %s", hold.layer, error)
            self._ledger.blind(error.code, str(error))
        except Exception as error:
            log.exception("Layer %d was not checked", hold.layer)
            self._ledger.blind(
                blindness.BUG, f"Checking failed ({type(error).__name__}). The log has the details."
            )
        finally:
            if current is not None and not gone:
                self._plan(current)
            self.holds.release(hold)
        if current is not None and gone:
            log.warning("Layer %d was not checked: %s", hold.layer, gone)
            self._revive_later(current, gone)
        if current is not None and look is not None:
            self._keep(current, look, time.monotonic() - hold.since_s)

    def _see(self, current: Print, hold: Hold) -> _Look:
        """Wait until the printer stands still, take a picture, and have it checked.

        Raises Interrupted, FrameError, EyeGone, and what the eye raises.
        """
        self._settle(hold)
        moves = self._moves(current, hold)
        if moves is None:
            return self._picture(current, hold)
        away, back = moves
        try:
            self.holds.move(hold, away)
            self._settle(hold)
            return self._picture(current, hold)
        finally:
            self.holds.move_back(hold, back)

    def _settle(self, hold: Hold) -> None:
        """Wait for the printer's report, and a little longer. Raises MoopError without one, Interrupted."""
        timeout_s = self._settings.settle_timeout_s
        if not hold.over.wait(timeout_s):
            raise blindness.NoReport(
                f"The printer did not report its position within {timeout_s:.0f} s. "
                "If that happens again, its firmware may not know M114."
            )
        if hold.position_mm is None or hold.stopped.wait(0):
            raise Interrupted(hold.dropped)

    def _moves(self, current: Print, hold: Hold) -> tuple[list[str], list[str]] | None:
        """Away and back, where the head is to be parked, is not out of the way already, and may be moved."""
        settings, position_mm = self._settings, hold.position_mm
        modes = modes_at(current.modes, current.ends, hold.file_pos)
        if settings.capture != "park" or position_mm is None or modes is None or current.stands_clear(position_mm):
            return None
        volume_mm = (current.job.header or {})["printer"]["volume_mm"]
        park = Park(
            current.park_at_mm(settings.park_at), settings.park_lift_mm, settings.park_retract_mm,
            settings.park_speed_mm_s, volume_mm["height"],
        )  # fmt: skip
        return park.moves(position_mm, hold.e_mm, modes)

    def _picture(self, current: Print, hold: Hold) -> _Look:
        """Take a picture of the print as it stands now, and have it checked. Raises as `_see`."""
        if hold.stopped.wait(self._settings.settle_s) or hold.position_mm is None:
            raise Interrupted(hold.dropped)
        deadline_s = time.monotonic() + self._settings.check_timeout_s
        jpeg = self._fresh(current, hold, deadline_s)
        x, y, z = hold.position_mm
        moment = {
            "frame": f"frames/{current.frames:06d}.jpg", "file_pos": hold.file_pos, "layer": hold.layer,
            "position_mm": {"x": x, "y": y, "z": z}, "time_s": round(time.monotonic() - current.began_s, 3),
            "parked": hold.marked or current.stands_clear(hold.position_mm),
            **({"cancelled": dict(current.cancelled)} if current.cancelled else {}),
        }  # fmt: skip
        current.frames += 1
        if self._eye.births != current.born:
            raise EyeGone("The process that looks at the pictures was started anew.")
        check, _ = self._eye.ask(
            "check", jpeg, timeout_s=max(deadline_s - time.monotonic(), 1.0), interrupted=hold.stopped, moment=moment
        )
        moment["layer"] = check["layer"]  # by height, only the eye can tell
        return _Look(jpeg, moment, check)

    def _fresh(self, current: Print, hold: Hold, deadline_s: float) -> bytes:
        """A picture that is not, byte for byte, the one of the last check: no sensor delivers the same noise twice."""
        for attempt in range(3):
            if attempt and hold.stopped.wait(0.5):
                raise Interrupted(hold.dropped)
            jpeg = self._webcam.grab(max(deadline_s - time.monotonic(), 0.5), hold.stopped)
            if jpeg != current.last_jpeg:
                current.last_jpeg = jpeg
                return jpeg
        raise FrameError("The webcam delivers the same picture again and again. Restart it.")

    def _act(self, check: dict[str, Any]) -> None:
        check["action"] = self.actor.act(check, self._settings.on_failed)
        if check["action"] != "none":
            log.warning("Layer %d failed: %s Action: %s", check["layer"], check["reason"], check["action"])
            self._ledger.note(action=check["action"], reason=check["reason"])

    def _keep(self, current: Print, look: _Look, held_s: float) -> None:
        """After the release: keep the pictures, write the recording, tell everybody."""
        current.revivals, current.last_frame = 0, look.moment["frame"]
        check, pictures = look.check, {"frame.jpg": look.jpeg}
        try:
            _, masks = self._eye.ask("pictures", timeout_s=20.0, interrupted=current.job.over)
            pictures.update(zip(("seen.png", "expected.png", "ignored.png"), masks))
        except MoopError as error:
            log.debug("No pictures of %s: %s", look.moment["frame"], error)
        if current.recorder is not None:
            current.recorder.add(look.jpeg, look.moment, check)
        log.info("Layer %d: %s, error %s, held %.2f s", check["layer"], check["verdict"], check["E"], held_s)
        self._ledger.note(layer=check["layer"])
        self._ledger.add(check, pictures, held_s)

    def _plan(self, current: Print) -> None:
        if current.switched_off or current.job.over.is_set() or self._print is not current:
            return
        settings = self._settings
        not_before_s = 0.0 if current.looked_s is None else current.looked_s + settings.min_interval_s
        every_layers = 0 if settings.capture == "slicer" else settings.every_layers
        self.holds.plan(current.ends, every_layers, current.last_pos, not_before_s)

    def _tick(self) -> None:
        """What nobody else thinks of: what the hooks noticed but had no time to say, and what does not come at all."""
        current, settings = self._print, self._settings
        if current is None:
            if time.monotonic() - self._idle_since_s > REST_S and self._eye.pid is not None:
                self._eye.close()
            return
        if current.by_height and not self.holds.refused:
            self._look_by_height(current)
        elif not self._ledger.status["watching"]:
            return
        elif self.holds.refused:
            self._ledger.blind(
                blindness.NOT_HELD, f"The print cannot be held for a look ({self.holds.refused})."
            )
        elif self.holds.missed >= 3:
            self._ledger.blind(
                blindness.FILE_CHANGED,
                "The lines that are sent do not match the file. Was it changed after it was read?",
            )
        elif settings.longest_s and settings.capture != "slicer" and self._ledger.age_s > settings.longest_s:
            self.holds.ask()

    def _look_by_height(self, current: Print) -> None:
        since_s = current.began_s if current.looked_s is None else current.looked_s
        longest_s = self._settings.longest_s or BY_HEIGHT_S
        if time.monotonic() - since_s > min(longest_s, BY_HEIGHT_S) and not (current.switched_off or self._paused):
            self._look_anywhere(current)

    def _look_anywhere(self, current: Print) -> None:
        if current.job.held:
            self.holds.ask()
        else:
            self.holds.glance(self._settings.settle_s + GLANCE_S)

    def _end(self, how: str) -> None:
        current, self._print = self._print, None
        self._idle_since_s = time.monotonic()
        self.actor.forget_cooling()
        if current is not None and current.recorder is not None:
            current.recorder.end(how)
        self._ledger.idle()

    def _go_on(self) -> None:
        """The user resumed the print. Where we had paused it, it is accepted as it stands: only what is new counts."""
        self.actor.forget_cooling()
        if self._ledger.status["action"] == "pause":
            self._settle_it("accept")

    def _settle_it(self, how: str) -> None:
        """What failed is settled, by `accept` or `pardon`; remembered, too, for an eye that has to begin anew."""
        self._ledger.note(action="none", reason="")
        current = self._print
        if current is None or not current.last_frame:
            return
        current.said[current.last_frame] = how
        try:
            self._eye.ask(how, timeout_s=20.0, interrupted=current.job.over)
        except MoopError as error:
            log.info("Could not %s: %s", how, error)

    def _skip(self, name: str) -> None:
        if self._print is not None:
            self._print.cancelled.setdefault(name, max(int(self._print.last_pos), 0))

    def _read_ahead(self, path: str) -> None:
        if self._print is None:
            self._idle_since_s = time.monotonic()
            try:
                result, _ = self._eye.ask("index", timeout_s=OPEN_TIMEOUT_S, job=path, cache=str(self._cache))
                self._ledger.note(renderer=result["renderer"])
            except MoopError as error:
                log.info("%s: %s", path, error)

    def _apply(self, settings: Settings) -> None:
        before, self._settings = self._settings, settings
        current = self._print
        if current is None or not current.ready:
            return
        seeing = ("hue_min_deg", "hue_max_deg", "saturation_min", "value_min", "segmentation", "sensitivity", "head")
        if any(getattr(before, name) != getattr(settings, name) for name in seeing):
            self._open(current, again=True)
        else:
            self._plan(current)

    def _switch(self, watching: bool) -> None:
        current = self._print
        if current is None or current.job.header is None or (current.job.path is None and current.mesh is None):
            return
        current.switched_off = not watching
        if not watching:
            self.holds.plan_none()
            self._ledger.blind(blindness.OFF_FOR_PRINT, "Watching was switched off for this print.")
        elif current.ready and self._eye.pid is not None and self._eye.births == current.born:
            self._plan(current)
            self._ledger.note(blind=None)
        else:  # what made it blind may be mended by now
            current.revivals = 0
            self._open(current, again=current.ready)

    def _look_if_ready(self) -> None:
        if self._print is not None and self._print.ready:
            self._look_anywhere(self._print)

    def _take_mesh(self, key: str, mesh: dict[str, Any] | None) -> None:
        """A print that is under way is looked at by its new road from now on, and learned again from its recording."""
        current = self._print
        if current is None or current.job.key != key or current.mesh == mesh or current.job.header is None:
            return
        current.mesh = mesh
        if current.recorder is not None:
            current.recorder.renew(self._header(current))
        if current.job.path is None and mesh is None:
            self.holds.plan_none()
            self._ledger.blind(blindness.NOT_LOCAL, current.job.why_not)
        else:
            self._open(current, again=current.ready)

    def _header(self, current: Print) -> dict[str, Any]:
        settings = self._settings
        material = {
            "hue_deg": [settings.hue_min_deg, settings.hue_max_deg],
            "saturation_min": settings.saturation_min, "value_min": settings.value_min,
        }  # fmt: skip
        try:
            size = Path(current.job.path or "").stat().st_size
        except OSError:  # deleted or renamed meanwhile
            size = 0
        file = "" if current.job.path is None else "job.gcode"
        head = {"format": "moop-recording", "version": 1, "job": {"file": file, "bytes": size}}
        if current.mesh is not None:
            head["mesh"] = {"file": "model.stl", "layer_height_mm": current.mesh.get("layer_height_mm")}
        return {**head, **(current.job.header or {}), "material": material}
