"""What is done to the printer when a print has failed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

TAG = "moop:mismatch"
WELL_CHECKS = 5
"""After so many good checks in a row, what fails is something new."""


class Printer(Protocol):
    """The part of OctoPrint's printer interface that is used here."""

    def pause_print(self, *, tags: set[str]) -> None: ...
    def cancel_print(self, *, tags: set[str]) -> None: ...
    def commands(self, commands: list[str], *, tags: set[str]) -> None: ...


class Actor:
    """Acts once for each thing that fails, or is suspected. A print that was resumed is not stopped again for what is
    already known, unless all was well for a while in between."""

    def __init__(self, printer: Printer) -> None:
        self._printer = printer
        self._told: dict[str, set[str]] = {"failed": set(), "suspect": set()}
        self._well = 0
        self._objects: dict[str, str] = {}
        self._names: dict[str, str] = {}
        self._gone: set[str] = set()

    def begin(self, objects: Sequence[str] = (), cancel_commands: Sequence[str] = ()) -> None:
        """A new print, with the command that makes the firmware skip each of its objects, where there is one."""
        self._forget()
        self._gone = set()
        self._objects = {name: command for name, command in zip(objects, cancel_commands) if command}
        self._names = {command: name for name, command in self._objects.items()}

    def cancelled_by(self, command: str) -> str | None:
        """The object that this command makes the firmware skip, whoever sends it."""
        name = self._names.get(command)
        if name is not None:
            self._gone.add(name)
        return name

    def act(self, check: dict[str, Any], on_failed: str, on_suspect: str = "none") -> str:
        """Do what is wanted about a check; answers what was done.

        Cancelling one object needs a name that the firmware knows, and something else to go on with: without, it is
        a pause.
        """
        self._well = self._well + 1 if check["verdict"] == "ok" else 0
        if self._well >= WELL_CHECKS:
            self._forget()
        verdict = check["verdict"]
        wanted = {"failed": on_failed, "suspect": on_suspect}.get(verdict, "none")
        if wanted == "none":
            return "none"
        named = {entry["name"] for entry in check["objects"] if entry["verdict"] == verdict} or {""}
        new = named - self._told["failed"] - self._told[verdict]
        if not new:
            return "none"
        self._told[verdict] |= named
        if wanted == "cancel_object":
            left = self._objects.keys() - self._gone
            if new < left:
                self._printer.commands([self._objects[name] for name in sorted(new)], tags={TAG})
                self._gone |= new
                return "cancel_object"
            wanted = "pause"
        if wanted == "pause":
            self.pause()
        elif wanted == "cancel":
            self._printer.cancel_print(tags={TAG})
        return wanted

    def pause(self) -> None:
        """As the user would have done."""
        self._printer.pause_print(tags={TAG})

    def _forget(self) -> None:
        self._told, self._well = {"failed": set(), "suspect": set()}, 0
