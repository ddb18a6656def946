"""Models that users attached to jobs: the files by the hash of their content, and which job has which."""

from __future__ import annotations

import hashlib
import json
import logging
import os
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any

from ..core.errors import MeshError
from .setups import write_json

log = logging.getLogger("octoprint.plugins.moop.meshes")

SUFFIXES = (".stl", ".obj", ".3mf")
MOST_BYTES = 128 * 1024 * 1024
ROOM_BYTES = 1024 * 1024 * 1024
"""For all of them together."""
_BLOCK_BYTES = 1 << 20
_NAME_LETTERS = 120


class Meshes:
    """In one folder. Used by several threads only through the server, which answers a page's requests in turn."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def get(self, job: str) -> dict[str, Any] | None:
        """What was kept for a job, with `path`, the mesh's file; None where it has no mesh.

        job : the hash of its content, or whatever else tells it from others
        """
        entry = self._read().get(job)
        if not isinstance(entry, dict) or not (self._folder / str(entry.get("file"))).is_file():
            return None
        return {**entry, "path": str(self._folder / entry["file"])}

    def store(self, stream: IO[bytes], name: str) -> str:
        """Keep a file that was sent; answers its name in the folder. What it holds is not looked at here.

        Raises MeshError where its kind is unknown, it is too large, or there is no room.
        """
        suffix = Path(name).suffix.lower()
        if suffix not in SUFFIXES:
            raise MeshError(f"{name[:_NAME_LETTERS]}: models can be {', '.join(SUFFIXES)}. Export it as STL.")
        digest, size = hashlib.sha256(), 0
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            handle, partial = tempfile.mkstemp(prefix=".coming-", dir=self._folder)
            try:
                with open(handle, "wb") as target:
                    while block := stream.read(_BLOCK_BYTES):
                        size += len(block)
                        if size > MOST_BYTES:
                            raise MeshError(f"{name}: is larger than {MOST_BYTES >> 20} MiB. Export it less finely.")
                        digest.update(block)
                        target.write(block)
                file = f"{digest.hexdigest()}{suffix}"
                os.replace(partial, self._folder / file)
            except BaseException:
                Path(partial).unlink(missing_ok=True)
                raise
        except OSError as error:
            raise MeshError(f"{name}: there is no room for it ({error.strerror or error}).") from None
        return file

    def path(self, file: str) -> Path:
        return self._folder / file

    def put(self, job: str, entry: Mapping[str, Any]) -> None:
        """Keep this for a job; `file` in it is what `store` answered. Raises OSError."""
        self._folder.mkdir(parents=True, exist_ok=True)
        known = self._read()
        known.pop(job, None)  # the newest is the last
        known[job] = {name: value for name, value in entry.items() if name != "path"}
        self._make_room(known, job)
        write_json(self._folder / "meshes.json", known)
        self.tidy()

    def _make_room(self, known: dict[str, Any], keep: str) -> None:
        """Forget the models that were attached longest ago, until the others fit."""
        sizes = {path.name: path.stat().st_size for path in self._folder.iterdir() if path.suffix in SUFFIXES}
        for job in [job for job in known if job != keep]:
            used = {entry.get("file") for entry in known.values() if isinstance(entry, dict)}
            if sum(size for name, size in sizes.items() if name in used) <= ROOM_BYTES:
                return
            del known[job]

    def drop(self, job: str) -> None:
        """The job has no mesh any more. Raises OSError."""
        known = self._read()
        if known.pop(job, None) is not None:
            write_json(self._folder / "meshes.json", known)
        self.tidy()

    def tidy(self) -> None:
        """Remove files that no job has any more."""
        used = {entry.get("file") for entry in self._read().values() if isinstance(entry, dict)}
        if not self._folder.is_dir():
            return
        for path in self._folder.iterdir():
            if path.suffix in SUFFIXES and path.name not in used:
                path.unlink(missing_ok=True)

    def _read(self) -> dict[str, Any]:
        try:
            known = json.loads((self._folder / "meshes.json").read_text(encoding="utf-8"))
            return known if isinstance(known, dict) else {}
        except FileNotFoundError:
            return {}
        except (OSError, ValueError):
            log.warning("The list of models cannot be read; they must be attached again", exc_info=True)
            return {}
