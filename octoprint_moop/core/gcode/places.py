"""Where a file's coordinates have their origin: G92, and the places of work G54 to G59.3.

As in Marlin and RepRapFirmware: G92 moves the origin of the place that is selected, and each place remembers its own;
machine coordinates (place 0) do not, so that going back to them takes every offset away.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

MACHINE = 0


class Places:
    """offset : mm, added to the file's X, Y and Z to get the place over the bed"""

    def __init__(self) -> None:
        self.offset = [0.0, 0.0, 0.0]
        self._selected: int | None = None  # before any is, files mean G54 where they define it
        self._known: dict[int, list[float]] = {}

    def select(self, place: int) -> None:
        """0 for machine coordinates, 1 to 6 for G54 to G59, 7 to 9 for G59.1 to G59.3."""
        if self._selected:
            self._known[self._selected] = self.offset
        self._selected = place
        self.offset = [0.0, 0.0, 0.0] if place == MACHINE else list(self._known.get(place, (0.0, 0.0, 0.0)))

    def reset(self) -> None:
        self.offset = [0.0, 0.0, 0.0]

    def define(self, words: Mapping[str, float | None], position_mm: Sequence[float], unit_mm: float) -> None:
        """G10 L2 puts a place's origin at X, Y, Z of the machine; L20 so that the nozzle stands at X, Y, Z of it."""
        place = int(words.get("P") or 0) or self._selected or 1
        current = place == (self._selected or 1)
        offset = self.offset if current else self._known.setdefault(place, [0.0, 0.0, 0.0])
        for i, axis in enumerate("XYZ"):
            value = words.get(axis)
            if value is not None and abs(value) < 1e6:
                offset[i] = value * unit_mm if words.get("L") == 2.0 else position_mm[i] - value * unit_mm
