"""Files read before anybody prints them, so that the first layers are watched too."""

from __future__ import annotations

import logging
import os
import threading
from collections import deque
from dataclasses import dataclass, field
from pathlib import Path

from ..core.errors import MoopError
from .ledger import Ledger
from .link import EyeLink, Interrupted

log = logging.getLogger("octoprint.plugins.moop.watch")

READING_S = 90.0
"""So long may pass without any progress."""


@dataclass(frozen=True, eq=False)
class Ahead:
    """A file that is to be read.

    unwanted : set where something else comes first
    printed  : set before that where it is this file's own print, for which it goes on being read
    """

    path: str
    unwanted: threading.Event = field(default_factory=threading.Event)
    printed: threading.Event = field(default_factory=threading.Event)

    def stamp(self) -> tuple[str, float, int]:
        """What changes when the file does; all of it zero where there is no such file."""
        try:
            found = os.stat(self.path)
        except OSError:
            return self.path, 0.0, 0
        return self.path, found.st_mtime, found.st_size


class Reading:
    """The files that wait to be read; what is read is kept by the eye, under the hash of the content.

    `expect` and `make_way` are called by any thread, `read` by the watching one.
    """

    def __init__(self, eye: EyeLink, ledger: Ledger, cache: Path) -> None:
        self._eye, self._ledger, self._cache = eye, ledger, cache
        self._waiting: deque[Ahead] = deque()
        self._last: tuple[str, float, int] | None = None

    def expect(self, path: str) -> Ahead:
        ahead = Ahead(path)
        self._waiting.append(ahead)
        return ahead

    def make_way(self, path: str | None) -> None:
        """This file is printed now: no other one is to be read before it, and nobody waits for it but its print."""
        for ahead in tuple(self._waiting):
            if ahead.path == path:
                ahead.printed.set()
            ahead.unwanted.set()

    def read(self, ahead: Ahead) -> None:
        """Read it, unless it was just read. An error is left for the print to tell."""
        stamp = ahead.stamp()
        try:
            if ahead.unwanted.is_set() or (self._eye.pid is not None and stamp == self._last):
                return
            result, _ = self._eye.ask(
                "index", timeout_s=READING_S, interrupted=ahead.unwanted, progress=self.so_far,
                job=ahead.path, cache=str(self._cache),
            )  # fmt: skip
            self._last = stamp
            self._ledger.note(renderer=result["renderer"])
        except Interrupted:
            if not ahead.printed.is_set():
                self._eye.close()  # it would go on reading
        except MoopError as error:
            log.info("%s: %s", ahead.path, error)
        finally:
            self._waiting.remove(ahead)
            self._ledger.note(reading=None)

    def so_far(self, ratio: float) -> None:
        self._ledger.note(reading=ratio)
