"""Where a file can be held while nothing lies on the bed yet, for a picture of it."""

from __future__ import annotations

import re
from collections.abc import Iterator

from .jobtext import Text

_MOVE = re.compile(rb"G0*[0-3](?![\d.])")
_ACROSS = re.compile(rb"G0*[0-3](?![\d.]).*[XY]")
# What neither moves the head nor waits for anything: it may stand between a travel and the bead that it leads to.
_STILL = re.compile(
    rb"(?:G0*(?:2[01]|9[0-2])|M0*(?:8[23]|104|10[67]|11[07]|140|20[1-5]|22[01]|486|572|73|900))(?!\d)"
    rb"|SET_|EXCLUDE_"
)
_FURTHEST_LINES = 400


def bare_ends(text: Text, first_end: int) -> list[int]:
    """File positions just before the first bead, rising: where the travel to it begins, and where it ends.

    The head stands aside at the one or at the other: where the start code has left it, or where a line that primes the
    nozzle begins. Empty where nothing comes before the bead.

    text : the whole file, as positions count in it; first_end : the position at which the first bead lies
    """
    departed = arrived = None
    leads_across = False
    for command, end in _commands_before(text, text.rfind(b"\n", 0, first_end - 1) + 1):
        if arrived is None:
            arrived = end
        if leads_across:
            departed = end
        leads_across = _ACROSS.match(command) is not None
        if not _MOVE.match(command) and not _STILL.match(command):
            break
    return sorted({end for end in (departed, arrived) if end is not None})


def _commands_before(text: Text, end: int) -> Iterator[tuple[bytes, int]]:
    """(command, position of its line's end), backwards from a line's beginning; comments and empty lines left out."""
    for _ in range(_FURTHEST_LINES):
        if end <= 0:
            return
        start = text.rfind(b"\n", 0, end - 1) + 1
        command = text[start:end].split(b";")[0].strip()
        if command:
            yield command, end
        end = start
