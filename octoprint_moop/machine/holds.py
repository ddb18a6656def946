"""Holding the job at the end of a layer: what the G-code hooks do, and nothing that takes time.

The hooks run in OctoPrint's serial threads, where a millisecond is a stalled printer. Below the next boundary they
compare one number. At a boundary they hold the job, send M400 and M114 after the layer's last command, and hand the
hold over; whoever took it over waits for the printer's report and must release it.
"""

from __future__ import annotations

import bisect
import itertools
import logging
import math
import re
import threading
import time
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Callable, Protocol

log = logging.getLogger("octoprint.plugins.moop.holds")

SETTLE_TAG = "moop:settle"
BARE = -1
"""The layer of a hold at which nothing lies on the bed yet."""
_REPORT = re.compile(
    r"X:\s*(-?\d+(?:\.\d+)?)\s*Y:\s*(-?\d+(?:\.\d+)?)\s*Z:\s*(-?\d+(?:\.\d+)?)(?:\s*E:\s*(-?\d+(?:\.\d+)?))?"
)
_READ = re.compile(r"SD printing byte (\d+)/(\d+)")


class Printer(Protocol):
    """The part of OctoPrint's printer interface that is used here."""

    def set_job_on_hold(self, value: bool, blocking: bool = True) -> Any: ...
    def commands(self, commands: list[str], *, tags: set[str]) -> None: ...


@dataclass(eq=False)
class Hold:
    """The job stands at `file_pos`; `layer` is the one that ended there, or is being printed where none ends, or BARE.

    over     : set when waiting is over: the printer reported its position, or the hold has lost its purpose
    dropped  : why it has lost its purpose, "" while it has not
    lost     : the connection went, and OctoPrint's hold with it
    marked   : the slicer's own mark brought it about, with the head where the user wants it
    unheld   : the job runs from the printer's own storage: its firmware was told to stand still for a while instead
    read     : (bytes, of how many) that such a firmware has told to have read since it was last asked
    sure_pos : as in a Moment
    """

    file_pos: int
    layer: int
    tag: str
    marked: bool = False
    since_s: float = field(default_factory=time.monotonic)
    armed: bool = False
    position_mm: tuple[float, float, float] | None = None
    e_mm: float | None = None
    over: threading.Event = field(default_factory=threading.Event)
    stopped: threading.Event = field(default_factory=threading.Event)
    dropped: str = ""
    lost: bool = False
    unheld: bool = False
    read: list[tuple[int, int]] = field(default_factory=list)
    sure_pos: int | None = None

    @property
    def name(self) -> str:
        """What is looked at in it, for the log."""
        return "The empty bed" if self.layer == BARE else f"Layer {self.layer}"

    def drop(self, why: str, lost: bool = False) -> None:
        self.dropped, self.lost = why, lost or self.lost
        self.stopped.set()
        self.over.set()


@dataclass(frozen=True)
class _Plan:
    """ends: file position of each layer's end, rising; wanted: those at which to hold, with their layer."""

    ends: Sequence[int]
    wanted: dict[int, int]
    wanted_pos: Sequence[int]
    not_before_s: float
    choice: tuple[int, tuple[int, ...]] = (1, ())

    def after(self, file_pos: float) -> float:
        index = bisect.bisect_right(self.wanted_pos, file_pos)
        return self.wanted_pos[index] if index < len(self.wanted_pos) else math.inf


class Holds:
    """The one owner of this plugin's hold. At most one exists at a time.

    hand_over : called with each new hold, from a serial thread; must not block
    missed    : boundaries since the last hold that never came by as a line of the file
    refused   : why the last hold was impossible, "" where it was not
    last_pos  : of the line of the file that came by last; -1 where none has since the last print was over
    shows     : whether anything that was sent over this connection came by here
    """

    def __init__(self, printer: Printer, hand_over: Callable[[Hold], None]) -> None:
        self._printer, self._hand_over = printer, hand_over
        self._plan: _Plan | None = None
        self._made: _Plan | None = None
        self._next_pos: float = math.inf
        self._asked = False
        self._hold: Hold | None = None
        self._numbers = itertools.count()
        self._lock = threading.Lock()
        self.missed = 0
        self.refused = ""
        self.last_pos = -1
        self.shows = False

    # --- for the watching thread ----------------------------------------------------------------------------------

    def plan(
        self, ends: Sequence[int], every_layers: int = 1, after_pos: float = -1, not_before_s: float = 0.0,
        bare_ends: Sequence[int] = (),
    ) -> None:  # fmt: skip
        """Hold at the end of every so many layers, from `after_pos` on, not before `not_before_s` (monotonic).

        every_layers : 0 to hold at the slicer's marks only
        bare_ends    : positions before the first layer at which to hold besides
        """
        choice, made = (every_layers, tuple(bare_ends)), self._made
        if made is None or made.ends is not ends or made.choice != choice:  # made once for a print, not at each layer
            wanted = {pos: layer for layer, pos in enumerate(ends) if every_layers and (layer + 1) % every_layers == 0}
            wanted.update(dict.fromkeys(bare_ends, BARE))
            made = _Plan(ends, wanted, sorted(wanted), not_before_s, choice)
        self._made = plan = replace(made, not_before_s=not_before_s)
        self._plan = plan
        self._next_pos = plan.after(after_pos)

    def plan_none(self) -> None:
        """No new holds; one that stands is not touched."""
        self._next_pos, self._plan, self._asked = math.inf, None, False

    def begin(self) -> None:
        """A new print: nothing is planned for it, and what was wrong with the last one is no matter of its."""
        self.plan_none()
        self.missed, self.refused = 0, ""

    def ask(self) -> bool:
        """Hold at the very next line of the file. False where no plan is made, or a hold stands already."""
        if self._plan is None or self._hold is not None:
            return False
        self._asked = True
        self._next_pos = 0
        return True

    def glance(self, dwell_s: float) -> None:
        """Have a firmware that prints from its own storage finish its moves, report, and stand still for a while."""
        hold = Hold(0, 0, f"{SETTLE_TAG}:{next(self._numbers)}", unheld=True)
        with self._lock:
            if self._hold is not None or self._plan is None:
                return
            self._hold = hold
        try:
            self._printer.commands(["M27", "M400", "M27", "M114", f"G4 P{dwell_s * 1000:.0f}"], tags={hold.tag})
        except Exception as error:
            self._hold, self.refused = None, f"{type(error).__name__}: {error}"
            return
        self._hand_over(hold)

    def glance_again(self, hold: Hold) -> None:
        """Ask the same firmware once more how far it is and where it stands, and begin to wait anew for its report."""
        self._await_anew(hold)
        hold.read = []
        self._printer.commands(["M27", "M114"], tags={hold.tag})

    def drop(self, why: str, lost: bool = False) -> None:
        """Whoever waits for a hold shall stop waiting and release it. lost: its connection has gone."""
        hold = self._hold
        if hold is not None:
            hold.drop(why, lost)

    def let_go(self, why: str) -> None:
        """The same, and it is released at once: whoever took it over is not going to see to it soon."""
        hold = self._hold
        if hold is not None:
            hold.drop(why)
            self.release(hold)

    def move(self, hold: Hold, commands: Sequence[str]) -> None:
        """Send moves while the job is held, and begin to wait anew for the printer to report where they ended."""
        self._await_anew(hold)
        self._printer.commands([*commands, "M400", "M114"], tags={hold.tag})

    def move_back(self, hold: Hold, commands: Sequence[str]) -> None:
        """Send moves that end the hold's own; nobody waits for them, and the file's next line comes after."""
        if not hold.dropped:
            self._printer.commands(list(commands), tags={hold.tag})

    def _await_anew(self, hold: Hold) -> None:
        hold.armed, hold.position_mm = False, None
        hold.over.clear()
        if hold.dropped:
            hold.over.set()
        hold.tag = f"{SETTLE_TAG}:{next(self._numbers)}"

    def release(self, hold: Hold) -> None:
        """Let the job go on. Harmless where it was done before, or the connection has gone."""
        with self._lock:
            if self._hold is not hold:
                return
            self._hold = None
        if hold.lost or hold.unheld:
            return
        try:
            self._printer.set_job_on_hold(False)
        except Exception:  # no connection any more, and with it no hold
            log.warning("The hold could not be released", exc_info=True)

    def where(self, timeout_s: float) -> tuple[float, float, float] | None:
        """The position of a printer that prints nothing, as it reports it itself; None where it does not in time."""
        hold = Hold(-1, -1, f"{SETTLE_TAG}:{next(self._numbers)}", unheld=True)
        with self._lock:
            if self._hold is not None or self._plan is not None:
                return None
            self._hold = hold
        try:
            self._printer.commands(["M400", "M114"], tags={hold.tag})
            hold.over.wait(timeout_s)
            return hold.position_mm
        finally:
            self._hold = None

    # --- for the hooks --------------------------------------------------------------------------------------------

    def line_queuing(self, command: str, file_pos: int) -> list[Any] | None:
        """What to send for this line of the file; None to leave it as it is."""
        self.last_pos = file_pos
        if file_pos < self._next_pos:
            return None
        hold = self._take(file_pos)
        if hold is None:
            return None
        return [command, ("M400", None, {hold.tag}), ("M114", None, {hold.tag})]

    def line_sent(self, gcode: str | None, tags: Collection[str] | None) -> None:
        self.shows = True
        hold = self._hold
        if hold is not None and gcode == "M114" and tags and hold.tag in tags:
            hold.armed = True

    def line_received(self, line: str) -> None:
        hold = self._hold
        if hold is None:
            return
        if hold.unheld:
            told = _READ.search(line)
            if told:
                hold.read.append((int(told.group(1)), int(told.group(2))))
        if not hold.armed or hold.position_mm is not None:
            return
        report = _REPORT.search(line)
        if report:
            x, y, z, e = report.groups()
            hold.e_mm = None if e is None else float(e)
            hold.position_mm = (float(x), float(y), float(z))
            hold.over.set()

    def mark_queuing(self, file_pos: int) -> None:
        """The file has a mark of the slicer's here: the layer before it is complete, and the head is parked."""
        plan = self._plan
        if plan is None or self._hold is not None or time.monotonic() < plan.not_before_s:
            return
        layer = max(bisect.bisect_right(plan.ends, file_pos) - 1, 0)
        hold = self._hold_job(plan, file_pos, layer, marked=True)
        if hold is not None:  # held, so these two go out at once, behind what is on its way
            self._printer.commands(["M400", "M114"], tags={hold.tag})

    def _take(self, file_pos: int) -> Hold | None:
        plan = self._plan
        if plan is None or self._hold is not None:
            # A hold is followed by a plan made anew; a mere question where the printer stands is not.
            self._next_pos = math.inf if plan is None else plan.after(file_pos)
            return None
        layer = plan.wanted.get(file_pos)
        if self._asked:
            layer = max(min(bisect.bisect_left(plan.ends, file_pos), len(plan.ends) - 1), 0)
        elif layer is None:
            self.missed += 1
        if layer is None or (time.monotonic() < plan.not_before_s and not self._asked):
            self._next_pos = plan.after(file_pos)
            return None
        return self._hold_job(plan, file_pos, layer)

    def _hold_job(self, plan: _Plan, file_pos: int, layer: int, marked: bool = False) -> Hold | None:
        hold = Hold(file_pos, layer, f"{SETTLE_TAG}:{next(self._numbers)}", marked)
        self._hold, self._asked = hold, False
        try:
            answer = self._printer.set_job_on_hold(True, blocking=False)
        except Exception as error:  # not connected; or a connection of another kind
            answer, self.refused = False, f"{type(error).__name__}: {error}"
        if not answer:
            self._hold = None
            # OctoPrint 2 answers None where the connection knows no hold at all; False is another plugin being busy.
            self._next_pos = math.inf if answer is None else plan.after(file_pos)
            if answer is None:
                self.refused = "this kind of connection has no hold"
            return None
        self._next_pos = math.inf
        self.missed, self.refused = 0, ""
        self._hand_over(hold)
        return hold
