"""The watch: the one thread that owns the conversation with printer, camera and eye while a print runs.

Everything that happens is put into its mailbox as a call and done in turn; what others may know of it stands in the
ledger. Whatever fails here, the print goes on and the ledger says why nobody is watching.
"""

from __future__ import annotations

import logging
import queue
import threading
import time
from collections import deque
from dataclasses import asdict
from pathlib import Path
from typing import Any, Callable

from ..core.errors import MoopError
from ..core.settings import Settings
from . import blindness
from .acting import Actor
from .holds import BARE, Hold, Holds
from .jobs import Ahead, Job, Print
from .ledger import Ledger
from .link import EyeGone, EyeLink, Interrupted
from .looks import Look, Looks
from .parking import Modes
from .recorder import Recorder
from .resting import Resting
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
        self._printer, self._eye = printer, eye
        self._recordings, self._cache = recordings, cache
        self._settings, self._ledger = settings, ledger
        self._mailbox: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self.holds = Holds(printer, lambda hold: self._mailbox.put(lambda: self._look(hold)))
        self._looks = Looks(self.holds, webcam, eye)
        self._actor, self._resting = Actor(printer), Resting(printer)
        self._print: Print | None = None
        self._job: Job | None = None
        self._paused = False
        self._ahead: deque[Ahead] = deque()
        self._read_last: tuple[str, float, int] | None = None
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

    def job_expected(self, path: str) -> None:
        """A file that will probably be printed: read it ahead, so that the first layers are watched too."""
        ahead = Ahead(path)
        self._ahead.append(ahead)
        self._mailbox.put(lambda: self._read_ahead(ahead))

    def job_started(self, job: Job) -> None:
        self._job, self._paused = job, False
        for ahead in list(self._ahead):
            if ahead.path != job.path:  # what prints now comes first
                ahead.unwanted.set()
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
        """By us or not."""
        self._paused = True

    def job_resumed(self) -> None:
        self._paused = False
        self._mailbox.put(self._go_on)

    @property
    def paused_by_us(self) -> bool:
        return bool(self._ledger.status["action"] == "pause")

    def pausing_commands(self) -> list[str]:
        """What is to be sent when the print has been paused, after OctoPrint's own script."""
        return _lines(self._settings.gcode_paused) if self.paused_by_us else []

    def resuming_commands(self) -> list[str]:
        """What is to be sent before OctoPrint's own script when the print is resumed: first of all the heaters."""
        return [*self._resting.reheating(), *_lines(self._settings.gcode_resumed)] if self.paused_by_us else []

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
        name = self._actor.cancelled_by(command)
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
        self._actor.begin()
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
                "open", *current.reference[:1], timeout_s=OPEN_TIMEOUT_S, interrupted=current.job.over,
                progress=self._read_so_far, job=None if job is None else str(job), header=self._header(current),
                settings=asdict(self._settings), mesh=current.mesh, cache=str(self._cache),
                keep_as=str(packed) if packed is not None else None,
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
        finally:
            self._ledger.note(reading=None)
        current.born, current.ready, current.by_height = self._eye.births, True, result["road"] == "height"
        current.ends, current.bounds_mm = result["ends"], result["bounds_mm"]
        current.bare_ends = result["bare_ends"]
        modes = map(Modes.from_json, result["modes"])
        current.modes = dict(zip([*current.bare_ends, *current.ends], modes))
        for note in result["notes"]:
            log.info("%s: %s", current.job.name, note)
        if not again:
            self._actor.begin(result["objects"], result["cancel_commands"])
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
        """One check, or one picture of the empty bed, from a hold to its release."""
        current, looks, gone = self._print, [], ""
        try:
            if current is not None:
                current.last_pos = hold.file_pos
                if hold.layer == BARE:
                    self._look_at_bed(current, hold)
                else:
                    current.looked_s = hold.since_s
                    looks = self._looks.check(current, hold, self._settings)
                    self._act(looks[-1].check)
        except Interrupted as error:
            log.info("%s was not checked: %s", _named(hold), hold.dropped or error)
        except EyeGone as error:
            gone = str(error)
        except MoopError as error:
            log.warning("%s was not checked: %s", _named(hold), error)
            self._ledger.blind(error.code, str(error))
        except Exception as error:
            log.exception("%s was not checked", _named(hold))
            self._ledger.blind(blindness.BUG, f"Checking failed ({type(error).__name__}). The log has the details.")
        finally:
            if current is not None and not gone:
                self._plan(current)
            self.holds.release(hold)
        if current is not None and gone:
            log.warning("%s was not checked: %s", _named(hold), gone)
            self._revive_later(current, gone)
        if current is not None and looks:
            self._keep(current, looks, time.monotonic() - hold.since_s)
            if looks[-1].check["action"] == "cancel_object":  # it stays where it lies: only what changes now counts
                self._tell_eye("accept")

    def _look_at_bed(self, current: Print, hold: Hold) -> None:
        if self._looks.reference(current, hold, self._settings):
            if current.recorder is not None:
                current.recorder.add_reference(*current.reference)
            log.info("The empty bed was looked at, %.2f s", time.monotonic() - hold.since_s)
        else:
            log.info("The head stands before the bed: no picture of it was taken here")

    def _act(self, check: dict[str, Any]) -> None:
        check["action"] = self._actor.act(check, self._settings.on_failed, self._settings.on_suspect)
        if check["action"] != "none":
            what = "Layer %d is " + check["verdict"] + ": %s Action: %s"
            log.warning(what, check["layer"], check["reason"], check["action"])
            self._acted(check["action"], check["reason"])

    def _acted(self, action: str, reason: str) -> None:
        if action == "pause":
            self._resting.begin(self._settings.cool_after_min * 60, self._settings.bed_off_after_min * 60)
        self._ledger.note(action=action, reason=reason)

    def _keep(self, current: Print, looks: list[Look], held_s: float) -> None:
        """After the release: keep the pictures, write the recording, tell everybody."""
        last = looks[-1]
        current.revivals, current.last_frame = 0, last.moment["frame"]
        check, pictures = last.check, {"frame.jpg": last.jpeg}
        try:
            _, masks = self._eye.ask("pictures", timeout_s=20.0, interrupted=current.job.over)
            pictures.update(zip(("seen.png", "expected.png", "ignored.png"), masks))
        except MoopError as error:
            log.debug("No pictures of %s: %s", last.moment["frame"], error)
        if current.recorder is not None:
            for look in looks:
                current.recorder.add(look.jpeg, look.moment, look.check, final=look is last)
        log.info("Layer %d: %s, error %s, held %.2f s", check["layer"], check["verdict"], check["E"], held_s)
        self._ledger.note(layer=check["layer"])
        self._ledger.add(check, pictures, held_s)

    def _plan(self, current: Print) -> None:
        if current.switched_off or current.job.over.is_set() or self._print is not current:
            return
        settings = self._settings
        not_before_s = 0.0 if current.looked_s is None else current.looked_s + settings.min_interval_s
        every_layers = 0 if settings.capture == "slicer" else settings.every_layers
        bare_ends = current.bare_ends if not current.reference else ()
        self.holds.plan(current.ends, every_layers, current.last_pos, not_before_s, bare_ends)

    def _tick(self) -> None:
        """What nobody else thinks of: what the hooks noticed but had no time to say, and what does not come at all."""
        current, settings = self._print, self._settings
        if current is None:
            if time.monotonic() - self._idle_since_s > REST_S and self._eye.pid is not None:
                self._eye.close()
            return
        watching = self._ledger.status["watching"]
        if watching:
            current.blind_s = 0.0
        else:
            self._mind_being_blind(current)
        if current.by_height and not self.holds.refused:
            self._look_by_height(current)
        elif not watching:
            return
        elif self.holds.refused:
            self._ledger.blind(blindness.NOT_HELD, f"The print cannot be held for a look ({self.holds.refused}).")
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

    def _mind_being_blind(self, current: Print) -> None:
        """A print that should be watched and is not: after a while the user is told, or the print is paused."""
        settings, status = self._settings, self._ledger.status
        if status["blind_code"] in blindness.WANTED or settings.on_blind == "none" or not self._printer.is_printing():
            return
        before_s = current.blind_s
        current.blind_s += TICK_S  # ticks come only while nothing else is to be done, so this is the least it can be
        if not before_s < settings.blind_min * 60 <= current.blind_s:
            return
        reason = f"Nobody has watched this print for {settings.blind_min:g} min. {status['blind']}"
        log.warning("%s Action: %s", reason, settings.on_blind)
        if settings.on_blind == "pause":
            self._actor.pause()
        self._acted(settings.on_blind, reason)
        self._ledger.tell_unwatched()

    def _end(self, how: str) -> None:
        current, self._print = self._print, None
        self._idle_since_s = time.monotonic()
        self._resting.end()
        if current is not None and current.recorder is not None:
            current.recorder.end(how)
        self._ledger.idle()

    def _go_on(self) -> None:
        """The user resumed the print. Where we had paused it, it is accepted as it stands: only what is new counts."""
        self._resting.end()
        if self._ledger.status["action"] == "pause":
            self._settle_it("accept")

    def _settle_it(self, how: str) -> None:
        """What failed is settled, by `accept` or `pardon`; remembered, too, for an eye that has to begin anew."""
        self._ledger.note(action="none", reason="")
        self._tell_eye(how)

    def _tell_eye(self, how: str) -> None:
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

    def _read_ahead(self, ahead: Ahead) -> None:
        self._ahead.remove(ahead)
        stamp = ahead.stamp()
        if self._print is not None or ahead.unwanted.is_set() or (self._eye.pid and stamp == self._read_last):
            return
        self._idle_since_s = time.monotonic()
        try:
            result, _ = self._eye.ask(
                "index", timeout_s=OPEN_TIMEOUT_S, interrupted=ahead.unwanted, progress=self._read_so_far,
                job=ahead.path, cache=str(self._cache),
            )  # fmt: skip
            self._read_last = stamp
            self._ledger.note(renderer=result["renderer"])
        except Interrupted:
            self._eye.close()  # it would go on reading
        except MoopError as error:
            log.info("%s: %s", ahead.path, error)
        finally:
            self._ledger.note(reading=None)

    def _read_so_far(self, ratio: float) -> None:
        self._ledger.note(reading=ratio)

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
        taken = {"reference": current.reference[1]} if current.reference else {}
        return {**head, **(current.job.header or {}), "material": material, **taken}


def _lines(gcode: str) -> list[str]:
    """The commands of a setting, without comments."""
    commands = (line.split(";")[0].strip() for line in gcode.splitlines())
    return [command for command in commands if command]


def _named(hold: Hold) -> str:
    return "The empty bed" if hold.layer == BARE else f"Layer {hold.layer}"
