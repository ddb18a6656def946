"""Prints one after the other on a printer that takes no time, for what must not grow with their number."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from octoprint_moop.core.settings import Settings
from octoprint_moop.machine.jobs import Job
from octoprint_moop.machine.ledger import Ledger
from octoprint_moop.machine.link import EyeLink
from octoprint_moop.machine.watch import Watch
from octoprint_moop.machine.webcam import Webcam


class Printer:
    """Answers at once, and does nothing."""

    def __init__(self) -> None:
        self.holds = 0
        self.let_go = threading.Event()

    def set_job_on_hold(self, value: bool, blocking: bool = True) -> bool:
        self.holds += 1 if value else -1
        if not value:
            self.let_go.set()
        return True

    def commands(self, commands: list[str], *, tags: set[str]) -> None: ...
    def pause_print(self, *, tags: set[str]) -> None: ...
    def cancel_print(self, *, tags: set[str]) -> None: ...
    def set_temperature(self, heater: str, value: float) -> None: ...

    def get_current_temperatures(self) -> dict[str, Any]:
        return {}

    def is_printing(self) -> bool:
        return True


class Endless:
    """A watch with its eye, and a printer before a camera.

    frame  : called for each picture, JPEG
    module : of the eye
    """

    def __init__(
        self, folder: Path, frame: Callable[[], bytes], module: str = "octoprint_moop.machine.eye", **settings: Any
    ) -> None:
        self.printer, self.eye = Printer(), EyeLink(module)
        self.ledger = Ledger(lambda kind, payload: None, "1.0")
        webcam = Webcam(lambda name: ("painted", lambda: [frame()]))
        chosen = Settings(**{"settle_s": 0.0, "on_failed": "none", **settings})
        self.watch = Watch(self.printer, webcam, self.eye, folder / "recordings", folder / "cache", chosen, self.ledger)
        self.watch.start()

    def close(self) -> None:
        self.watch.stop()
        self.watch._thread.join(120)
        self.eye.close()

    def print(self, job: Path, header: dict[str, Any], ends: Iterable[int]) -> int:
        """One print with a look at each of these ends; how many checks came of it."""
        self.watch.job_started(Job(job.name, str(job), header))
        self.wait(lambda: self.ledger.status["watching"])
        for end in ends:
            self.comes_by(end)
        self.watch.job_over("done")
        self.wait(lambda: self.ledger.status["blind_code"] == "idle")
        assert self.printer.holds == 0
        return len(self.ledger.checks)

    def comes_by(self, end: int) -> bool:
        """The line that ends there is sent; whether the print was held for it, and has been let go."""
        self.printer.let_go.clear()
        sent = self.watch.holds.line_queuing("G1 X1", end)
        if sent is None:
            return False
        self.watch.holds.line_sent("M114", sent[-1][2])
        self.watch.holds.line_received("ok X:2.00 Y:198.00 Z:0.30 E:1.00 Count")
        assert self.printer.let_go.wait(120), self.ledger.status
        return True

    def wait(self, condition: Callable[[], Any], timeout_s: float = 120.0) -> None:
        until_s = time.monotonic() + timeout_s
        while not condition():
            assert time.monotonic() < until_s, self.ledger.status
            time.sleep(0.001)
