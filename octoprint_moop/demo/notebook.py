"""Where the demo's witness, in OctoPrint's process, writes down what was sent, and the webcam, in ours, reads it."""

from __future__ import annotations

import mmap
import re
import struct
from collections.abc import Collection, Iterable
from pathlib import Path
from typing import Any

# Written first and last: where they differ, the reader came between.
_RECORD = struct.Struct("<qqdddq")
_WORD = re.compile(r"([XYZ])\s*([-+]?\d*\.?\d+)")


def make(path: Path) -> None:
    """An empty notebook: nothing was sent, no file is being printed."""
    path.write_bytes(_RECORD.pack(0, 0, 0.0, 0.0, 0.0, 0))
    _job_file(path).write_text("")


def read(path: Path) -> tuple[int, tuple[float, float, float]]:
    """(file position, machine position in mm) of the last command that was sent."""
    while True:
        first, file_pos, x, y, z, last = _RECORD.unpack(path.read_bytes()[: _RECORD.size])
        if first == last:
            return file_pos, (x, y, z)


def read_job(path: Path) -> Path | None:
    """The file that is being printed, or was last."""
    name = _job_file(path).read_text()
    return Path(name) if name else None


def _job_file(path: Path) -> Path:
    return path.with_suffix(".job")


class Witness:
    """Follows file position and machine position through the commands that go out."""

    def __init__(self, path: Path) -> None:
        self._path = path
        with path.open("r+b") as file:
            self._record = mmap.mmap(file.fileno(), _RECORD.size)
        self._sent, self._file_pos = 0, 0
        self._position = {"X": 0.0, "Y": 0.0, "Z": 0.0}
        self._relative = False

    def job(self, file: str) -> None:
        """A print of that file begins."""
        _job_file(self._path).write_text(file)

    def sent(self, cmd: str, gcode: str | None, tags: Collection[str] | None) -> None:
        """A command has gone out; arguments as OctoPrint's hook gcode.sent has them."""
        for tag in tags or ():
            if tag.startswith("filepos:"):
                self._file_pos = int(tag[8:])
        if gcode in ("G0", "G1", "G2", "G3"):
            for axis, value in _WORD.findall(cmd):
                self._position[axis] = float(value) + (self._position[axis] if self._relative else 0.0)
        elif gcode in ("G90", "G91"):
            self._relative = gcode == "G91"
        elif gcode == "G28":
            named: Iterable[Any] = [axis for axis in "XYZ" if axis in cmd[3:]]
            self._position.update(dict.fromkeys(named or "XYZ", 0.0))
        self._sent += 1
        self._record[:] = _RECORD.pack(self._sent, self._file_pos, *self._position.values(), self._sent)
