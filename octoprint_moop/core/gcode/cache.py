"""What was read from a G-code file, kept under the hash of its content, so that it is read once.

An entry is a folder: the long columns as .npy files, which are mapped, and `entry.json` with the rest and with the
columns' checksums. It appears whole or not at all (built aside, then renamed). One that does not check out is built
again.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import shutil
import tempfile
import zlib
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from ..toolpath import Toolpath

VERSION = 3  # raised when the same file would now be read differently
KEPT_ENTRIES = 8
_BLOCK_BYTES = 1 << 20
_ENTRY = "entry.json"


class Cache:
    """The entry of one file, read with certain parameters."""

    def __init__(self, folder: Path, file: BinaryIO, parameters: tuple[float, ...]) -> None:
        digest = hashlib.blake2b(repr((VERSION, parameters)).encode(), digest_size=16)
        file.seek(0)
        while block := file.read(_BLOCK_BYTES):
            digest.update(block)
        self._folder, self._entry = folder, folder / digest.hexdigest()

    def load(self) -> Toolpath | None:
        """The Toolpath with its long columns mapped, or None where there is no sound entry."""
        try:
            entry = json.loads((self._entry / _ENTRY).read_text("utf-8"))
            columns = {}
            for name, checksum in entry["checksums"].items():
                path = self._entry / name
                if _checksum(path) != checksum:
                    return None
                columns[path.stem] = np.load(path, mmap_mode="r", allow_pickle=False)
            toolpath = Toolpath(**columns, **_from_json(entry["toolpath"]))
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            return None
        with contextlib.suppress(OSError):
            os.utime(self._entry)
        return toolpath

    @contextlib.contextmanager
    def building(self) -> Iterator[Path]:
        """A folder to build the entry in; gone afterwards, unless `keep` has made it the entry."""
        self._folder.mkdir(parents=True, exist_ok=True)
        building = Path(tempfile.mkdtemp(prefix=".building-", dir=self._folder))
        try:
            yield building
        finally:
            shutil.rmtree(building, ignore_errors=True)

    def keep(self, building: Path, toolpath: Toolpath) -> None:
        """Make what was built the entry. `toolpath` tells everything but the long columns, which are files already."""
        for name in ("layer_start", "layer_end_pos", "layer_z_mm"):
            np.save(building / f"{name}.npy", getattr(toolpath, name))
        entry = {
            "checksums": {path.name: _checksum(path) for path in sorted(building.glob("*.npy"))},
            "toolpath": _to_json(toolpath),
        }
        with open(building / _ENTRY, "w", encoding="utf-8") as file:
            json.dump(entry, file)
            file.flush()
            os.fsync(file.fileno())
        shutil.rmtree(self._entry, ignore_errors=True)
        with contextlib.suppress(OSError):  # another process was quicker: its entry is as good
            building.rename(self._entry)
        self._forget_old()

    def _forget_old(self) -> None:
        entries = [path for path in self._folder.iterdir() if (path / _ENTRY).is_file() and path != self._entry]
        entries.sort(key=lambda path: path.stat().st_mtime, reverse=True)
        for path in entries[KEPT_ENTRIES - 1 :]:
            shutil.rmtree(path, ignore_errors=True)


def _checksum(path: Path) -> int:
    checksum = 0
    with open(path, "rb") as file:
        while block := file.read(_BLOCK_BYTES):
            checksum = zlib.crc32(block, checksum)
    return checksum


def _to_json(toolpath: Toolpath) -> dict[str, Any]:
    values = {field.name: getattr(toolpath, field.name) for field in fields(toolpath)}
    return {name: value for name, value in values.items() if not isinstance(value, np.ndarray)}


def _from_json(data: dict[str, Any]) -> dict[str, Any]:
    """Lists become the tuples that a Toolpath has."""
    tuples = {name: tuple(value) for name, value in data.items() if isinstance(value, list)}
    tuples["cancelled"] = tuple((int(k), int(position)) for k, position in data["cancelled"])
    return {**data, **tuples}
