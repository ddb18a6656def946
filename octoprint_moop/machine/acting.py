"""What is done to the printer when a print has failed, and after."""

from __future__ import annotations

import logging
import threading
from collections.abc import Sequence
from typing import Any, Protocol

log = logging.getLogger("octoprint.plugins.moop.acting")

TAG = "moop:mismatch"
WELL_CHECKS = 5
"""After so many good checks in a row, what fails is something new."""


class Printer(Protocol):
    """The part of OctoPrint's printer interface that is used here."""

    def pause_print(self, *, tags: set[str]) -> None: ...
    def cancel_print(self, *, tags: set[str]) -> None: ...
    def commands(self, commands: list[str], *, tags: set[str]) -> None: ...
    def set_temperature(self, heater: str, value: float) -> None: ...
    def get_current_temperatures(self) -> dict[str, Any]: ...


class Actor:
    """Acts once for each thing that fails. A print that was resumed is not stopped again for what is already known,
    unless all was well for a while in between."""

    def __init__(self, printer: Printer) -> None:
        self._printer = printer
        self._told: set[str] = set()
        self._well = 0
        self._objects: dict[str, str] = {}
        self._names: dict[str, str] = {}
        self._cooling: threading.Timer | None = None
        self._cooled: dict[str, float] = {}

    def begin(self, objects: Sequence[str] = (), cancel_commands: Sequence[str] = ()) -> None:
        """A new print, with the command that makes the firmware skip each of its objects, where there is one."""
        self._told, self._well = set(), 0
        self._objects = {name: command for name, command in zip(objects, cancel_commands) if command}
        self._names = {command: name for name, command in self._objects.items()}
        self.forget_cooling()

    def cancelled_by(self, command: str) -> str | None:
        """The object that this command makes the firmware skip, whoever sends it."""
        return self._names.get(command)

    def act(self, check: dict[str, Any], wanted: str) -> str:
        """Do what is wanted about a check, where it failed; answers what was done.

        Cancelling one object needs a name that the firmware knows, and something else to go on with: without, it is
        a pause.
        """
        self._well = self._well + 1 if check["verdict"] == "ok" else 0
        if self._well >= WELL_CHECKS:
            self._told = set()
        if check["verdict"] != "failed":
            return "none"
        failed = {entry["name"] for entry in check["objects"] if entry["verdict"] == "failed"} or {""}
        new = failed - self._told
        if not new:
            return "none"
        self._told |= failed
        if wanted == "cancel_object":
            if new <= self._objects.keys() and self._told < self._objects.keys():
                self._printer.commands([self._objects[name] for name in sorted(new)], tags={TAG})
                return "cancel_object"
            wanted = "pause"
        if wanted == "pause":
            self._printer.pause_print(tags={TAG})
        elif wanted == "cancel":
            self._printer.cancel_print(tags={TAG})
        return wanted

    # --- a hot end that must not ooze and char for hours ----------------------------------------------------------

    def cool_later(self, after_s: float) -> None:
        """Turn the hot ends off when the print has stood paused for so long. The bed keeps its heat, and the print."""
        self.forget_cooling()
        self._cooling = threading.Timer(after_s, self._cool)
        self._cooling.daemon = True
        self._cooling.start()

    def forget_cooling(self) -> None:
        """The print goes on, or is over."""
        if self._cooling is not None:
            self._cooling.cancel()
        self._cooling, self._cooled = None, {}

    def reheating(self) -> list[str]:
        """The commands that must come before any move when the print is resumed."""
        cooled, self._cooled = self._cooled, {}
        only = len(cooled) == 1 and "tool0" in cooled
        return [
            f"M109 S{target:g}" if only else f"M109 T{heater[4:]} S{target:g}"
            for heater, target in sorted(cooled.items())
        ]

    def _cool(self) -> None:
        try:
            targets = {
                heater: float(now["target"])
                for heater, now in self._printer.get_current_temperatures().items()
                if heater.startswith("tool") and now.get("target")
            }
            for heater in targets:
                self._printer.set_temperature(heater, 0)
            self._cooled = targets
            log.info("Paused for long: turned off %s", ", ".join(sorted(targets)) or "nothing")
        except Exception:
            log.exception("The hot ends could not be turned off")
