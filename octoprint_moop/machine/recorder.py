"""Writing recordings, as FORMATS.md, section 3, fixes them, within a budget of disk space.

Apart from `recording.py`, which reads them, because the server writes and must not load OpenCV to do so.
"""

from __future__ import annotations

import contextlib
import errno
import json
import logging
import os
import re
import shutil
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..core.errors import RecordingError
from .setups import write_json

log = logging.getLogger("octoprint.plugins.moop.recorder")

SPARE_BYTES = 300 * 1024 * 1024
"""What is left to the system: nothing is recorded on a disk with less free space than this."""

_WORSE = ("ok", "unusable", "camera_moved", "suspect", "failed")
PACKING = "job.gcode.gz.part"
"""The job's packed copy while it is being written."""
_KEEP = "keep"
"""An empty file of this name in a recording's folder: the user wants to keep it."""
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,120}")


class Recorder:
    """Writes one print's recording. A disk that is full or broken ends the recording, never the watching."""

    def __init__(
        self,
        root: Path,
        job_name: str,
        header: dict[str, Any],
        budget_bytes: int,
        tell: Callable[[str | None, str], None] = lambda name, why_not: None,
    ) -> None:
        """tell : called with the recording's name, None where nothing is written (any more), and why that is where it should"""
        self._root, self._budget_bytes = root, budget_bytes
        self._header, self._tell = header, tell
        self._outcome: dict[str, Any] = {"job": job_name, "checks": 0, "verdict": "ok", "mode": None, "layer": None}
        self._frames = self._used_bytes = 0
        self.folder: Path | None = None
        """None where nothing is recorded (any more)."""
        self.trouble = ""
        try:
            root.mkdir(parents=True, exist_ok=True)
            self._make_room()
            folder = _new_folder(root, job_name)
            (folder / "frames").mkdir()
            write_json(folder / "recording.json", header)
            write_json(folder / "outcome.json", self._outcome)
            (folder / "frames.jsonl").touch()
            self.folder = folder
            tell(folder.name, "")
        except OSError as error:
            self._give_up(error)

    def add_reference(self, jpeg: bytes, reference: dict[str, Any]) -> None:
        """The empty bed, before the print. reference: what the header says of it."""
        if self.folder is not None:
            self._header = {**self._header, "reference": reference}
            try:
                # The header first: a power cut between the two leaves a place without a picture, which harms nobody.
                write_json(self.folder / "recording.json", self._header)
                (self.folder / "reference.jpg").write_bytes(jpeg)
            except OSError as error:
                self._give_up(error)

    def renew(self, header: dict[str, Any]) -> None:
        """What the header says of the print has changed."""
        self._header = header
        if self.folder is not None:
            try:
                write_json(self.folder / "recording.json", header)
            except OSError as error:
                self._give_up(error)

    def add(self, jpeg: bytes, moment: dict[str, Any], check: dict[str, Any], final: bool = True) -> None:
        """One frame with its moment, and what was concluded. The frame's name is `moment`'s.

        final : False where a second look in the same hold was to confirm it
        """
        self._frames += 1
        if self.folder is None:
            return
        try:
            # The picture first: a power cut between the two leaves a picture too many, never a line without one.
            (self.folder / moment["frame"]).write_bytes(jpeg)
            lines = _append(self.folder / "frames.jsonl", moment) + _append(self.folder / "checks.jsonl", check)
            self._used_bytes += len(jpeg) + lines
            if final:
                self._note(check)
            if self._frames % 50 == 0:
                self._make_room()
        except OSError as error:
            self._give_up(error)

    def end(self, ended: str) -> None:
        """The print is over: `done`, `cancelled` or `failed`."""
        if self.folder is not None:
            self._outcome["ended"] = ended
            try:
                if not (self.folder / PACKING).exists():  # it does not grow any more: to be counted once and for all
                    self._outcome["bytes"] = _size(self.folder)
                write_json(self.folder / "outcome.json", self._outcome)
                self._make_room()
                self._tell(None, "")
            except OSError as error:
                self._give_up(error)

    def _note(self, check: dict[str, Any]) -> None:
        self._outcome["checks"] += 1
        if _WORSE.index(check["verdict"]) > _WORSE.index(self._outcome["verdict"]):
            self._outcome.update(verdict=check["verdict"], mode=check["mode"], layer=check["layer"])
            write_json(self.folder / "outcome.json", self._outcome)  # type: ignore[operator]

    def _make_room(self) -> None:
        """Counted anew only where it may be needed: at the beginning, and when the budget is used up."""
        if not self._frames or self._used_bytes > self._budget_bytes:
            self._used_bytes = make_room(self._root, self._budget_bytes, keep=self.folder)
        if is_disk_full(self._root):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def _give_up(self, error: OSError) -> None:
        full = error.errno == errno.ENOSPC
        deleted = self.folder is not None and isinstance(error, FileNotFoundError)  # by the user: no cause for alarm
        why = "the disk is almost full" if full else "its recording was deleted" if deleted else error.strerror or error
        told = f"This print is not recorded: {why}."
        if self.folder is not None:
            told = f"This print is not recorded any more: {why}."
        if full:
            told = f"{told} Make room, and the next print is recorded again."
        self.folder, self.trouble = None, told
        log.warning(told, exc_info=not (full or deleted))
        self._tell(None, told)


@dataclass(frozen=True)
class Kept:
    """One recording on disk. outcome: job, checks, worst verdict with its mode and layer, ended (absent: cut short).

    keep : the user wants it to stay, however little room there is
    """

    name: str
    bytes: int
    outcome: dict[str, Any]
    keep: bool = False

    def to_json(self) -> dict[str, Any]:
        return {"name": self.name, "bytes": self.bytes, **self.outcome, "keep": self.keep}


def kept(root: Path) -> list[Kept]:
    """All recordings, oldest first (their names begin with the time)."""
    if not root.is_dir():
        return []
    found = []
    for folder in sorted(path for path in root.iterdir() if NAME.fullmatch(path.name) and path.is_dir()):
        try:
            outcome = json.loads((folder / "outcome.json").read_text(encoding="utf-8"))
        except (OSError, ValueError):
            outcome = {}
        if not isinstance(outcome, dict):
            outcome = {}
        size = outcome.pop("bytes", None)
        size = size if isinstance(size, int) and "ended" in outcome else _size(folder)
        found.append(Kept(folder.name, size, outcome, (folder / _KEEP).exists()))
    return found


def _size(folder: Path) -> int:
    """Bytes of all files in a folder and below."""
    size = 0
    with contextlib.suppress(FileNotFoundError), os.scandir(folder) as entries:  # removed meanwhile
        for entry in entries:
            size += _size(Path(entry.path)) if entry.is_dir(follow_symlinks=False) else entry.stat().st_size
    return size


def make_room(root: Path, budget_bytes: int, keep: Path | None = None) -> int:
    """Remove recordings until they fit into the budget: the oldest first, those of failed prints last.

    Those that the user keeps are never removed, and take their room from the others. Answers what is used then.
    keep : the one that is being written, never removed
    """
    recordings = kept(root)
    used = sum(recording.bytes for recording in recordings)
    for recording in sorted(recordings, key=lambda r: (r.outcome.get("verdict") == "failed", r.name)):
        if used <= budget_bytes:
            break
        if not recording.keep and (keep is None or recording.name != keep.name):
            shutil.rmtree(root / recording.name, ignore_errors=True)
            used -= recording.bytes
    return used


def is_disk_full(root: Path) -> bool:
    """Whether nothing is recorded for want of space."""
    while not root.exists() and root != root.parent:
        root = root.parent
    return shutil.disk_usage(root).free < SPARE_BYTES


def find(root: Path, name: str) -> Path | None:
    """The recording's folder; None where there is none of that name, or the name is not one."""
    folder = root / name
    return folder if NAME.fullmatch(name) and folder.is_dir() else None


def set_keep(folder: Path, keep: bool) -> None:
    """Whether this recording stays when room is needed. Raises RecordingError where that cannot be written."""
    try:
        if keep:
            (folder / _KEEP).touch()
        else:
            (folder / _KEEP).unlink(missing_ok=True)
    except OSError as error:
        raise RecordingError(f"{folder.name} cannot be marked: {error.strerror or error}.") from None


def remove(folder: Path) -> None:
    """Raises RecordingError where it cannot be removed."""
    try:
        shutil.rmtree(folder)
    except OSError as error:
        raise RecordingError(f"{folder.name} cannot be removed: {error.strerror or error}.") from None


def _new_folder(root: Path, job_name: str) -> Path:
    stem = re.sub(r"[^A-Za-z0-9._-]+", "_", Path(job_name).stem).strip("._-")[:60] or "print"
    name = f"{time.strftime('%Y-%m-%d_%H-%M-%S')}_{stem}"
    for attempt in range(1000):
        folder = root / (name if not attempt else f"{name}_{attempt}")
        try:
            folder.mkdir()
            return folder
        except FileExistsError:
            continue
    raise OSError(f"no free name for {name}")


def _append(path: Path, line: dict[str, Any]) -> int:
    """Answers how many bytes were written."""
    text = (json.dumps(line) + "\n").encode()
    with open(path, "ab") as file:
        return file.write(text)
