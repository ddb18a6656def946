"""A pause that lasts: what is turned off after a while, and hot again before anything moves."""

from __future__ import annotations

import logging
import threading
from typing import Any, Protocol

log = logging.getLogger("octoprint.plugins.moop.acting")


class Heaters(Protocol):
    """The part of OctoPrint's printer interface that is used here."""

    def set_temperature(self, heater: str, value: float) -> None: ...
    def get_current_temperatures(self) -> dict[str, Any]: ...


class Resting:
    """The heaters while the print stands paused because of us.

    What was hot when the pause began is hot again before the print goes on, whoever has turned it off meanwhile: many
    firmwares do so by themselves, and a print that is resumed cold is lost.
    """

    def __init__(self, printer: Heaters) -> None:
        self._printer = printer
        self._lock = threading.Lock()  # never held while the printer is spoken to
        self._hot: dict[str, float] = {}
        self._off: set[str] = set()
        self._timers: list[threading.Timer] = []

    def begin(self, hot_ends_off_s: float = 0.0, bed_off_s: float = 0.0) -> None:
        """The print has been paused. Hot ends and bed are turned off after so many seconds, 0 for never."""
        self.end()
        self._hot = {name: target for name, target in self._targets().items() if target}
        for after_s, kind in ((hot_ends_off_s, "tool"), (bed_off_s, "bed")):
            if after_s:
                timer = threading.Timer(after_s, self._turn_off, (kind,))
                timer.daemon = True
                timer.start()
                self._timers.append(timer)

    def end(self) -> None:
        """The print goes on, or is over."""
        self._ended()

    def _ended(self) -> tuple[dict[str, float], set[str]]:
        """(what was hot when the pause began, what was turned off since)"""
        with self._lock:
            timers, self._timers = self._timers, []
            hot, off = self._hot, self._off
            self._hot, self._off = {}, set()
        for timer in timers:
            timer.cancel()
        return hot, off

    def reheating(self) -> list[str]:
        """The commands that must come before any move when the print is resumed; the bed first, which takes longest."""
        hot, off = self._ended()
        now = self._targets()
        cold = {name: target for name, target in hot.items() if name in off or not now.get(name)}
        several = len([name for name in now if name.startswith("tool")]) > 1
        waits = {"bed": "M190", "chamber": "M191"}
        commands = [f"{wait} S{cold[name]:g}" for name, wait in waits.items() if name in cold]
        for name in sorted(cold.keys() - waits.keys()):
            commands.append(f"M109 T{name[4:]} S{cold[name]:g}" if several else f"M109 S{cold[name]:g}")
        return commands

    def _targets(self) -> dict[str, float]:
        """Of each heater, 0 where it is off."""
        try:
            temperatures = self._printer.get_current_temperatures()
            known = (name for name in temperatures if name.startswith("tool") or name in ("bed", "chamber"))
            return {name: float(temperatures[name].get("target") or 0.0) for name in known}
        except Exception:
            log.exception("The temperatures are not known")
            return {}

    def _turn_off(self, kind: str) -> None:
        hot = self._hot
        wanted = {heater for heater, target in self._targets().items() if target and heater.startswith(kind)}
        with self._lock:
            if self._hot is not hot:  # the print goes on
                return
            self._off |= wanted
        try:
            for heater in sorted(wanted):
                self._printer.set_temperature(heater, 0)
            if self._hot is not hot:  # it went on meanwhile: what was just sent must not be the last word
                for heater in sorted(wanted & hot.keys()):
                    self._printer.set_temperature(heater, hot[heater])
            log.info("Paused for long: turned off %s", ", ".join(sorted(wanted)) or "nothing")
        except Exception:
            log.exception("The heaters could not be turned off")
