"""Lines that are no rows: what each does, asked of the line alone, so that what recurs is understood once."""

from __future__ import annotations

import re
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from .commands import MEANT_M, QUIET_M, QUIET_WORDS
from .dialects import Feature, Layer, Meaning, Width, meaning
from .rows import Lines

MOST_WIDTH_MM = 100.0
_SEMICOLON = ord(";")
_WIDTHS = (b";WIDTH:", b"; LINE_WIDTH: ")
# Lines that cannot change how moves are read: object labels, macros, and M codes other than these.
_STATELESS = re.compile(rb"@|[A-FH-LO-QU-Z]|[RS](?!ESTORE_GCODE|AVE_GCODE)|M(?!\s*0*(?:82|83|200|221)(?!\d))\s*\d")
_PLAIN_WORD = re.compile(rb"([A-Z_]+)(?:[ \t][^;]*)?$")
_PLAIN_M = re.compile(rb"M0{0,4}(\d{1,4})(?![\d.])[^;]*$")


class Remark(NamedTuple):
    """What a line does that is no row.

    breaks     : rows after it may be read otherwise than rows before it
    breaks_own : the same, where what is read is the user's own G-code, see `Interpreter.own_gcode`
    meanings   : of a comment, else ()
    idle       : a command that does nothing but end the tail of a retraction; any other is the interpreter's
    """

    breaks: bool
    breaks_own: bool
    meanings: tuple[Meaning, ...] = ()
    idle: bool = False


@lru_cache(maxsize=4096)
def remark_of(raw: bytes) -> Remark | None:
    """None of a line that does nothing: most comments, and settings of fans and acceleration, of which there are as many."""
    if raw[0] == _SEMICOLON:
        meanings = meaning(raw[1:].decode("utf-8", "replace"))
        return _of_comment(meanings) if meanings else None
    if not _STATELESS.match(raw):
        return Remark(True, True)
    found = _PLAIN_WORD.match(raw)
    if found and found.group(1).decode("ascii") in QUIET_WORDS:
        return None
    found = _PLAIN_M.match(raw)
    number = int(found.group(1)) if found else None
    if number is None or number in MEANT_M:
        return Remark(False, False)
    return None if number in QUIET_M else Remark(False, False, idle=True)


def _of_comment(meanings: tuple[Meaning, ...]) -> Remark:
    # The user's own G-code begins with a feature, and ends with one or with a layer. Widths that `told_widths` does not
    # find must not come between those that it does.
    breaks = any(isinstance(said, Width) or (isinstance(said, Feature) and said.custom) for said in meanings)
    return Remark(breaks, breaks or any(isinstance(said, (Feature, Layer)) for said in meanings), meanings)


def told_widths(chunk: bytes, lines: Lines, others: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lines like `;WIDTH:0.45`, a quarter of all lines of some slicers: which of `others` they are, bool, and the widths,
    (n,) float64, mm."""
    text, told = np.frombuffer(chunk, np.uint8), np.zeros(len(others), bool)
    start, end = lines.start[others], lines.end[others]
    end -= (text.take(end - 1) == ord("\r")) & (end > start)
    widths_mm = np.empty(len(others))
    for said in _WIDTHS:
        tell = np.arange(len(others))
        for i in reversed(range(len(said))):  # the last letter tells most
            tell = tell[text.take(start[tell] + i, mode="clip") == said[i]]
        widths_mm[tell], told[tell] = lines.figures.numbers(start[tell] + len(said), end[tell])
    told &= widths_mm < MOST_WIDTH_MM
    return told, widths_mm[told]
