"""The watch: the one thread that owns the conversation with printer, camera and eye while a print runs.

Everything that happens is put into its mailbox as a call and done in turn; what others may know of it stands in the
ledger. Whatever fails here, the print goes on and the ledger says why nobody is watching.
"""

from __future__ import annotations

import logging
import queue
import threading
import time
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, Callable

from ..core.errors import MoopError
from ..core.settings import Settings
from . import blindness
from .ahead import READING_S, Ahead, Reading
from .clock import TICK_S, Clock
from .holds import BARE, Hold, Holds
from .jobs import Job, Print
from .ledger import Ledger
from .link import EyeGone, EyeLink, Interrupted
from .looks import Look, Looks
from .responding import Responder
from .webcam import Webcam

log = logging.getLogger("octoprint.plugins.moop.watch")

REVIVALS = 5
REST_S = 600.0
"""After so long without a print, or a question of the set-up, an eye is closed, and its memory given back."""


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
        """printer : OctoPrint's; what is used of it is said by the protocols in `holds`, `acting` and `resting`"""
        self._eye = eye
        self._recordings, self._cache = recordings, cache
        self._settings, self._ledger = settings, ledger
        self._mailbox: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self.holds = Holds(printer, lambda hold: self._mailbox.put(lambda: self._look(hold)))
        self._looks = Looks(self.holds, webcam, eye)
        self.responder = Responder(printer, ledger)
        self._clock = Clock(self.holds, ledger, self.responder)
        self._reading = Reading(eye, ledger, cache)
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

    def job_expected(self, path: str) -> None:
        """A file that will probably be printed: read it ahead, so that the first layers are watched too."""
        ahead = self._reading.expect(path)
        self._mailbox.put(lambda: self._read_ahead(ahead))

    def job_started(self, job: Job) -> None:
        self._job, self._paused = job, False
        self._reading.make_way(job.path)
        self._mailbox.put(lambda: self._begin(job))

    def job_stopping(self, why: str, lost: bool = False) -> None:
        """Nothing more can be learned from a hold that stands; it is released. lost: the connection has gone."""
        self.holds.drop(why, lost)

    def job_over(self, how: str, lost: bool = False) -> None:
        if self._job is not None:
            self._job.over.set()
        self.holds.plan_none()
        self.holds.drop(how, lost)
        self.holds.last_pos = -1
        if lost:
            self.holds.shows = False
        self._mailbox.put(lambda: self._end(how))

    def job_paused(self) -> None:
        """By us or not."""
        self._paused = True

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
        name, file_pos = self.responder.cancelled_by(command), self.holds.last_pos
        if name is not None:
            self._mailbox.put(lambda: self._skip(name, file_pos))

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
        if job.path is None and job.mesh is None:
            copy = job.copy()
            job = job if copy is None else replace(job, path=str(copy))
        self._print = current = Print(job, job.mesh)
        self.holds.begin()
        self.responder.begin()
        self._ledger.begin(job.name)
        if job.mesh is None and job.path is None:
            self._ledger.blind(blindness.NOT_LOCAL, job.why_not or "This print's file is not OctoPrint's own.")
            return
        if job.header is None:
            self._ledger.blind(blindness.NOT_SET_UP, "The camera is not calibrated. Run the set-up.")
            return
        if not self._settings.watch_prints:
            self._ledger.blind(blindness.OFF, "Watching is switched off in the settings.")
            return
        self._open(current)

    def _open(self, current: Print, again: bool = False) -> None:
        """Make the eye ready for this print, and begin to hold at its layers.

        Until that is done, which may take minutes, the print goes on by itself.
        """
        self.holds.plan_none()
        self.holds.let_go("what is known of the print is being learned anew")
        current.begin_recording(self._recordings, self._settings, self._ledger.recorded)
        known = current.to_be_opened(again)
        again = again and current.ready
        try:
            result, _ = self._eye.ask(
                "open", *current.reference[:1], timeout_s=READING_S, interrupted=current.job.over,
                progress=self._reading.so_far, header=current.header(self._settings), settings=asdict(self._settings),
                cache=str(self._cache), **known,
            )  # fmt: skip
        except Interrupted:
            return
        except EyeGone as error:
            self._revive_later(current, str(error))
            return
        except MoopError as error:
            self._ledger.blind(error.code, str(error))
            if current.ready and self._eye.births == current.born:  # what it knew before, it still knows
                self._plan(current)
            return
        finally:
            self._ledger.note(reading=None)
        current.opened(result, self._eye.births)
        for note in result["notes"]:
            log.info("%s: %s", current.job.name, note)
        if not again:
            self.responder.begin(result["objects"], result["cancel_commands"])
        self._plan(current)
        by_bytes = current.by_clock and not current.by_height
        self._ledger.note(
            renderer=result["renderer"], layers=result["layers"], road="bytes" if by_bytes else result["road"]
        )
        if not result["layers"]:
            self._ledger.blind(blindness.NO_LAYERS, "The file extrudes nothing that could be watched.")
        elif by_bytes and not self._ledger.status["checks"]:
            self._ledger.blind(blindness.NOT_LOCAL, blindness.UNCONFIRMED)
        else:
            self._ledger.note(blind=None)

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
                    current.last_pos, current.in_vain = hold.file_pos, 0
                    self.responder.to_check(looks[-1].check, self._settings)
        except Interrupted as error:
            log.info("%s was not checked: %s", hold.name, hold.dropped or error)
        except EyeGone as error:
            gone = str(error)
        except MoopError as error:
            log.warning("%s was not checked: %s", hold.name, error)
            self._ledger.blind(error.code, str(error))
            if current is not None:
                current.looked_in_vain(time.monotonic() - hold.since_s)
        except Exception as error:
            log.exception("%s was not checked", hold.name)
            self._ledger.blind(blindness.BUG, f"Checking failed ({type(error).__name__}). The log has the details.")
        finally:
            try:
                if current is not None and not gone:
                    self._plan(current)
            finally:
                self.holds.release(hold)
        if current is not None and gone:
            log.warning("%s was not checked: %s", hold.name, gone)
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

    def _keep(self, current: Print, looks: list[Look], held_s: float) -> None:
        """After the release: keep the pictures, write the recording, tell everybody."""
        last = looks[-1]
        current.revivals, current.last_frame = 0, last.moment["frame"]
        check, pictures = last.check, {"frame.jpg": last.jpeg}
        try:
            told, masks = self._eye.ask("pictures", timeout_s=20.0, interrupted=current.job.over, birth=current.born)
            if told["renderer"] != self._ledger.status["renderer"]:
                log.warning("The masks are drawn by %s from now on", told["renderer"])
                self._ledger.note(renderer=told["renderer"])
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
        not_before_s = current.rest_until_s
        if current.looked_s is not None:
            not_before_s = max(not_before_s, current.looked_s + settings.min_interval_s)
        every_layers = 0 if settings.capture == "slicer" else settings.every_layers
        bare_ends = current.bare_ends if not current.reference else ()
        self.holds.plan(current.ends, every_layers, current.last_pos, not_before_s, bare_ends)

    def _tick(self) -> None:
        if self._print is not None:
            self._clock.tick(self._print, self._settings, self._paused)
        elif time.monotonic() - self._idle_since_s > REST_S and self._eye.pid is not None:
            self._eye.close()

    def _end(self, how: str) -> None:
        current, self._print = self._print, None
        self._idle_since_s = time.monotonic()
        self.responder.end()
        if current is not None and current.recorder is not None:
            current.recorder.end(how)
        self._ledger.idle()

    def _go_on(self) -> None:
        """The user resumed the print. Where we had paused it, it is accepted as it stands: only what is new counts."""
        self.responder.end()
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
            self._eye.ask(how, timeout_s=20.0, interrupted=current.job.over, birth=current.born)
        except MoopError as error:
            log.info("Could not %s: %s", how, error)

    def _skip(self, name: str, file_pos: int) -> None:
        if self._print is not None:
            self._print.cancelled.setdefault(name, max(file_pos, int(self._print.last_pos), 0))

    def _read_ahead(self, ahead: Ahead) -> None:
        self._idle_since_s = time.monotonic()
        if self._print is not None:  # what prints needs the eye, and the machine
            ahead.unwanted.set()
        self._reading.read(ahead)

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
        current.switched_off, current.in_vain, current.rest_until_s = not watching, 0, 0.0
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
            self._clock.look_now(self._print, self._settings)

    def _take_mesh(self, key: str, mesh: dict[str, Any] | None) -> None:
        """A print that is under way is looked at by its new road from now on, and learned again from its recording."""
        current = self._print
        if current is None or current.job.key != key or current.mesh == mesh or current.job.header is None:
            return
        current.mesh = mesh
        if current.recorder is not None:
            current.recorder.renew(current.header(self._settings))
        if current.job.path is None and mesh is None:
            self.holds.plan_none()
            self._ledger.blind(blindness.NOT_LOCAL, current.job.why_not)
        else:
            self._open(current, again=current.ready)
