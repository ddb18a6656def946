"""Moving the head out of the picture while the job is held, and back as if nothing had happened.

No mode of the firmware is ever changed: G90 and M82 mean different things to different firmwares, and what they were
before cannot be asked for. The moves are written in the modes that the file has set at that point; where those are
relative, in inches or in doubt, the head stays where it is (or keeps its filament).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from .jobtext import Text, stretches

# a line's end first: regular expressions look for what they begin with many times faster than for anything else
_MODES = tuple(re.compile(b"\n(" + words + rb")(?![\d.])") for words in (b"G9[01]", b"M8[23]", b"G2[01]"))
_AT_BEGIN = re.compile(rb"(G9[01]|M8[23]|G2[01])(?![\d.])")
_MOVE = re.compile(rb"G[0-3][ \t]")
_NUMBER = re.compile(rb"[ \t]*(\d+(?:\.\d*)?)")
_FAR = 1 << 20


@dataclass(frozen=True)
class Modes:
    """What the file has set at one place, so far as it matters here.

    plain      : positions are absolute and in millimetres
    relative_e : whether filament is; None where firmwares do not agree (G90 and G91 change it for some)
    feed       : mm/min that a move without its own would have; None where the file has said none
    """

    plain: bool = True
    relative_e: bool | None = False
    feed: float | None = None

    @classmethod
    def from_json(cls, data: Sequence[Any]) -> Modes:
        return cls(*data)

    def to_json(self) -> list[Any]:
        return [self.plain, self.relative_e, self.feed]


@dataclass(frozen=True)
class Park:
    """at_mm: where the head stands for the picture. It is lifted and the filament drawn back on the way."""

    at_mm: tuple[float, float]
    lift_mm: float
    retract_mm: float
    speed_mm_s: float
    height_mm: float

    def moves(
        self, position_mm: tuple[float, float, float], e_mm: float | None, modes: Modes
    ) -> tuple[list[str], list[str]] | None:
        """(away, back) from where the printer says it stands; None where it must not be moved."""
        if not modes.plain or modes.feed is None or not 0 <= position_mm[2] <= self.height_mm:
            return None
        x, y, z = position_mm
        top = min(z + self.lift_mm, self.height_mm)
        travel = f"F{self.speed_mm_s * 60:.0f}"
        away = [f"G1 Z{top:.3f} F600", f"G1 X{self.at_mm[0]:.3f} Y{self.at_mm[1]:.3f} {travel}"]
        back = [f"G1 X{x:.3f} Y{y:.3f} {travel}", f"G1 Z{z:.3f} F600"]
        if self.retract_mm and modes.relative_e:
            away, back = [f"G1 E-{self.retract_mm:g} F2100", *away], [*back, f"G1 E{self.retract_mm:g} F2100"]
        elif self.retract_mm and modes.relative_e is False and e_mm is not None:
            away = [f"G1 E{e_mm - self.retract_mm:.3f} F2100", *away]
            back = [*back, f"G1 E{e_mm:.3f} F2100"]
        return away, [*back, f"G1 F{modes.feed:g}"]


def read_modes(text: Text, ends: Sequence[int]) -> list[Modes]:
    """The modes at each of these file positions, rising. text: the whole file, as positions count in it.

    A file that never says is taken to be absolute and in millimetres, as firmwares start.
    """
    begin = _AT_BEGIN.match(text)
    words = [(0, begin.group(1))] if begin else []
    for first, last in stretches(text):
        words += sorted(
            (match.start(1), match.group(1)) for mode in _MODES for match in mode.finditer(text, first, last)
        )
    del begin  # which holds on to a mapped text
    found: list[Modes] = []
    relative = inches = e_if_g90_counts = e_if_not = False
    at = 0
    for end in ends:
        while at < len(words) and words[at][0] < end:
            word = words[at][1]
            if word in (b"G90", b"G91"):
                relative = e_if_g90_counts = word == b"G91"
            elif word in (b"M82", b"M83"):
                e_if_g90_counts = e_if_not = word == b"M83"
            else:
                inches = word == b"G20"
            at += 1
        relative_e = e_if_not if e_if_not == e_if_g90_counts else None
        found.append(Modes(not relative and not inches, relative_e, _feed_before(text, end)))
    return found


def _feed_before(text: Text, end: int) -> float | None:
    """The last feed rate of a move before `end`, looking back as far as a layer may be long."""
    at = end
    while (at := text.rfind(b"F", max(end - _FAR, 0), at)) >= 0:
        line_start = text.rfind(b"\n", 0, at) + 1
        before = text[line_start:at]
        number = _NUMBER.match(text, at + 1)
        if number and b";" not in before and _MOVE.match(before):
            return float(number.group(1))
    return None
