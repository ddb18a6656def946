"""What no line of the file brings about: looks by the clock, and the blindness that nothing announces."""

from __future__ import annotations

import time

from ..core.settings import Settings
from . import blindness
from .holds import Holds
from .jobs import Print
from .ledger import Ledger
from .responding import Responder

TICK_S = 2.0
BY_CLOCK_S = 60.0
"""How often to look where no G-code tells when a layer ends."""
GLANCE_S = 1.5
"""How long a picture may take while the firmware stands still."""
NO_LINE_S = 60.0
"""Before so long the first line of a file, or of a script before it, has come by, whatever the printer does with it."""


class Clock:
    """Asked every TICK_S while nothing else is to be done. Used by the watching thread alone."""

    def __init__(self, holds: Holds, ledger: Ledger, responder: Responder) -> None:
        self._holds, self._ledger, self._responder = holds, ledger, responder

    def tick(self, current: Print, settings: Settings, paused: bool) -> None:
        """Look where that is due, and say what the hooks noticed but had no time to say."""
        watching = self._ledger.status["watching"]
        if watching:
            self._responder.to_seeing()
        else:  # ticks come only while nothing else is to be done, so this is the least that it can be
            self._responder.to_blindness(TICK_S, settings)
        if current.by_clock and not self._holds.refused:
            longest_s = min(settings.longest_s or BY_CLOCK_S, BY_CLOCK_S)
            if _is_time(current, longest_s) and not (current.switched_off or paused):
                self.look_now(current, settings)
        elif watching and self._holds.refused:
            self._ledger.blind(blindness.NOT_HELD, f"The print cannot be held for a look ({self._holds.refused}).")
        elif watching and not paused and self._no_line_for_long(current):
            self._ledger.blind(
                blindness.NOT_HELD,
                "No line of this print comes by here: over this kind of connection it cannot be held for a look.",
            )
        elif watching and self._holds.missed >= 3:
            self._ledger.blind(
                blindness.FILE_CHANGED,
                "The lines that are sent do not match the file. Was it changed after it was read?",
            )
        elif settings.longest_s and settings.capture != "slicer" and _is_time(current, settings.longest_s):
            self._holds.ask()

    def _no_line_for_long(self, current: Print) -> bool:
        if self._holds.shows or self._holds.last_pos >= 0:
            return False
        return time.monotonic() - current.began_s > NO_LINE_S

    def look_now(self, current: Print, settings: Settings) -> None:
        """At the next line of the file, or wherever a firmware that prints from its own storage has come to."""
        if current.job.held:
            self._holds.ask()
        else:
            self._holds.glance(settings.settle_s + GLANCE_S)


def _is_time(current: Print, longest_s: float) -> bool:
    """Nobody has looked for so long, whatever the last look showed."""
    since_s = current.began_s if current.looked_s is None else current.looked_s
    return time.monotonic() > max(since_s + longest_s, current.rest_until_s)
