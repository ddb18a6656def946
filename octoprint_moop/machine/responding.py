"""What follows from a verdict, or from having had none for long: the printer is told, and the ledger what was done."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from typing import Any

from ..core.settings import Settings
from . import blindness
from .acting import Actor
from .ledger import Ledger
from .resting import Resting

log = logging.getLogger("octoprint.plugins.moop.watch")


class Responder:
    """Settings are handed in at each call, since they may change while a print runs."""

    def __init__(self, printer: Any, ledger: Ledger) -> None:
        """printer : OctoPrint's; what is used of it is said by the protocols in `acting` and `resting`"""
        self._printer, self._ledger = printer, ledger
        self._actor, self._resting = Actor(printer), Resting(printer)
        self._blind_s = 0.0

    def begin(self, objects: Sequence[str] = (), cancel_commands: Sequence[str] = ()) -> None:
        """A new print, with the command that makes the firmware skip each of its objects, where there is one."""
        self._actor.begin(objects, cancel_commands)
        self._resting.end()
        self._blind_s = 0.0

    def end(self) -> None:
        """The print goes on, or is over."""
        self._resting.end()

    def to_check(self, check: dict[str, Any], settings: Settings) -> None:
        """Do what is wanted about a check; `action` in it says afterwards what was done."""
        check["action"] = action = self._actor.act(check, settings.on_failed, settings.on_suspect)
        if action != "none":
            log.warning("Layer %d: %s. %s Action: %s", check["layer"], check["verdict"], check["reason"], action)
            self._done(action, check["reason"], settings)

    def to_seeing(self) -> None:
        self._blind_s = 0.0

    def to_blindness(self, for_s: float, settings: Settings) -> None:
        """Nobody has watched for so much longer. Where that was wanted, the user is told after a while, or it pauses."""
        status = self._ledger.status
        if status["blind_code"] in blindness.WANTED or settings.on_blind == "none" or not self._printer.is_printing():
            return
        before_s, self._blind_s = self._blind_s, self._blind_s + for_s
        if not before_s < settings.blind_min * 60 <= self._blind_s:
            return
        reason = f"Nobody has watched this print for {settings.blind_min:g} min. {status['blind']}"
        log.warning("%s Action: %s", reason, settings.on_blind)
        if settings.on_blind == "pause":
            self._actor.pause()
        self._done(settings.on_blind, reason, settings)
        self._ledger.tell_unwatched()

    def cancelled_by(self, command: str) -> str | None:
        """The object that this command makes the firmware skip, whoever sends it."""
        return self._actor.cancelled_by(command)

    # --- around a pause of ours -----------------------------------------------------------------------------------

    @property
    def has_paused(self) -> bool:
        return bool(self._ledger.status["action"] == "pause")

    def pausing_commands(self, settings: Settings) -> list[str]:
        """What is to be sent when the print has been paused, after OctoPrint's own script."""
        return _lines(settings.gcode_paused) if self.has_paused else []

    def resuming_commands(self, settings: Settings) -> list[str]:
        """What is to be sent before OctoPrint's own script when the print is resumed: first of all the heaters."""
        return [*self._resting.reheating(), *_lines(settings.gcode_resumed)] if self.has_paused else []

    def _done(self, action: str, reason: str, settings: Settings) -> None:
        if action == "pause":
            self._resting.begin(settings.cool_after_min * 60, settings.bed_off_after_min * 60)
        self._ledger.note(action=action, reason=reason)


def _lines(gcode: str) -> list[str]:
    """The commands of a setting, without comments."""
    commands = (line.split(";")[0].strip() for line in gcode.splitlines())
    return [command for command in commands if command]
