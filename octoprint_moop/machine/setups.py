"""What the set-up found, kept for each printer profile and webcam in one JSON file."""

from __future__ import annotations

import json
import logging
import os
from pathlib import Path
from typing import Any

log = logging.getLogger("octoprint.plugins.moop.setups")


class Setups:
    """Whatever is found once for a printer profile and a webcam, by name: a lens, a plate's markers, `calibrations`."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def get(self, profile: str, webcam: str) -> dict[str, Any] | None:
        return self._read().get(_key(profile, webcam))

    def put(self, profile: str, webcam: str, parts: dict[str, Any]) -> list[str]:
        """Keep these in place of what was kept; answers the names of the parts that changed. Raises OSError."""
        kept = self._read()
        old = kept.get(_key(profile, webcam), {})
        kept[_key(profile, webcam)] = parts
        write_json(self._path, kept)
        return sorted(name for name in old.keys() | parts.keys() if old.get(name) != parts.get(name))

    def _read(self) -> dict[str, Any]:
        try:
            setups = json.loads(self._path.read_text(encoding="utf-8"))
            return setups if isinstance(setups, dict) else {}
        except FileNotFoundError:
            return {}
        except (OSError, ValueError):
            log.warning("%s cannot be read; the set-up must be made again", self._path, exc_info=True)
            return {}


def write_json(path: Path, data: Any) -> None:
    """Write whole or not at all, whatever happens meanwhile. Raises OSError."""
    partial = path.with_name(path.name + ".part")
    with open(partial, "w", encoding="utf-8") as file:
        json.dump(data, file, allow_nan=False)
        file.flush()
        os.fsync(file.fileno())
    os.replace(partial, path)


def _key(profile: str, webcam: str) -> str:
    return json.dumps([profile, webcam])
