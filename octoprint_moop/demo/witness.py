"""A plugin for the demo's OctoPrint alone: notes what has been sent to the virtual printer, for the webcam to see.

It is copied into the server's plugin folder and imports nothing of this package. What it knows stands in a small
mapped file, so that the hook does no more than a write to memory: a print is never delayed by it.
"""

from __future__ import annotations

import mmap
import os
import re
import struct
from pathlib import Path

__plugin_name__ = "MOOP demo witness"
__plugin_version__ = "1"
__plugin_description__ = "Tells the demo's simulated webcam what has been sent to the virtual printer."
__plugin_pythoncompat__ = ">=3.9,<4"

NAME = "moop_demo_witness"
FILE_ENV = "MOOP_DEMO_WITNESS"
# Written first and last: where they differ, the reader came between.
_RECORD = struct.Struct("<qqdddq")
_WORD = re.compile(r"([XYZ])\s*([-+]?\d*\.?\d+)")


def make(path: Path) -> None:
    """An empty file for a witness that has seen nothing."""
    path.write_bytes(_RECORD.pack(0, 0, 0.0, 0.0, 0.0, 0))


def read(path: Path) -> tuple[int, tuple[float, float, float]]:
    """(file position, machine position in mm) of the last command that was sent."""
    while True:
        first, file_pos, x, y, z, last = _RECORD.unpack(path.read_bytes()[: _RECORD.size])
        if first == last:
            return file_pos, (x, y, z)


class Witness:
    """Follows file position and machine position through the commands that go out."""

    def __init__(self, path: Path) -> None:
        with path.open("r+b") as file:
            self._record = mmap.mmap(file.fileno(), _RECORD.size)
        self._sent, self._file_pos = 0, 0
        self._position = {"X": 0.0, "Y": 0.0, "Z": 0.0}
        self._relative = False

    def on_sent(self, comm, phase, cmd, cmd_type, gcode, subcode=None, tags=None, *args, **kwargs):  # type: ignore[no-untyped-def]
        """OctoPrint's hook octoprint.comm.protocol.gcode.sent."""
        for tag in tags or ():
            if tag.startswith("filepos:"):
                self._file_pos = int(tag[8:])
        if gcode in ("G0", "G1", "G2", "G3"):
            for axis, value in _WORD.findall(cmd):
                self._position[axis] = float(value) + (self._position[axis] if self._relative else 0.0)
        elif gcode in ("G90", "G91"):
            self._relative = gcode == "G91"
        elif gcode == "G28":
            named = [axis for axis in "XYZ" if axis in cmd[3:]]
            self._position.update(dict.fromkeys(named or "XYZ", 0.0))
        self._sent += 1
        self._record[:] = _RECORD.pack(self._sent, self._file_pos, *self._position.values(), self._sent)


def __plugin_load__():  # type: ignore[no-untyped-def]
    global __plugin_hooks__
    __plugin_hooks__ = {"octoprint.comm.protocol.gcode.sent": Witness(Path(os.environ[FILE_ENV])).on_sent}
