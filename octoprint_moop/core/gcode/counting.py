"""How slicers count the filament that they say they use: with the user's own G-code (start, tool change, end), or without.

Found by comparing files with their own words: see docs/rendering.md. Where nothing is known of a slicer, all is counted.
"""

from __future__ import annotations

import re
from typing import NamedTuple


class Counting(NamedTuple):
    """own_gcode    : what the user's own G-code feeds is counted
    compensations : how often the filament compensation that the file declares is multiplied into the figure"""

    own_gcode: bool = True
    compensations: int = 0


_WAYS = (
    # Up to 2.5 PrusaSlicer adds up what its own writer feeds, as do those that come from it; from 2.6 on it reads the
    # finished file.
    (re.compile(r"PrusaSlicer (?:1\.|2\.[0-5]\b)"), Counting(own_gcode=False)),
    (re.compile(r"SuperSlicer|Slic3r|OrcaSlicer|BambuStudio", re.IGNORECASE), Counting(own_gcode=False)),
    (re.compile(r"Cura"), Counting(own_gcode=False)),
    # The firmware multiplies by the compensation once, since the file has it as M221, too.
    (re.compile(r"ideaMaker", re.IGNORECASE), Counting(own_gcode=False, compensations=2)),
)


def counting(slicer: str) -> Counting:
    """slicer : name and version, as the file tells it"""
    return next((way for pattern, way in _WAYS if pattern.search(slicer)), Counting())
