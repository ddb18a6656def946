"""The copy, among OctoPrint's own files, of a file that the printer reads from its own storage."""

from __future__ import annotations

import os
import re
from pathlib import Path

_SHORT = re.compile(r"(.+)~\d+")


def find_copy(folder: Path, name: str, size_bytes: int | None) -> Path | None:
    """The newest file of the same name and size below a folder; None where there is none.

    That it is the same one shows while it is printed: see `passing`.

    name       : as the printer tells it: in full, or cut to eight letters and three
    size_bytes : None where the printer did not tell it
    """
    found: list[tuple[float, Path]] = []
    for below, _, files in os.walk(folder):
        for file in files:
            path = Path(below, file)
            try:
                stat = path.stat()
            except OSError:  # removed meanwhile
                continue
            if size_bytes in (None, stat.st_size) and is_same_name(file, name):
                found.append((stat.st_mtime, path))
    return max(found)[1] if found else None


def is_same_name(here: str, on_printer: str) -> bool:
    """Whether a printer may call the file so that is called `here`."""
    mine, theirs = Path(here.lower()), Path(Path(on_printer.lower()).name)
    if mine.name == theirs.name:
        return True
    if mine.suffix[:4] != theirs.suffix[:4]:
        return False
    short = _SHORT.fullmatch(theirs.stem)
    begin = short.group(1) if short else theirs.stem if len(theirs.stem) == 8 else None
    return begin is not None and _plain(mine.stem).startswith(_plain(begin))


def _plain(text: str) -> str:
    return re.sub(r"[^a-z0-9]", "", text)
