"""What a G-code file lays down, bead by bead: the print as a function of the position in its file."""

from __future__ import annotations

import mmap
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property

import numpy as np


class Role(IntEnum):
    """What a bead is for. Unknown names count as OUTER, which is always drawn."""

    OUTER = 0  # outer walls, overhangs, anything unknown
    INNER = 1  # inner walls
    INFILL = 2  # sparse and solid infill that later layers cover
    SURFACE = 3  # top and bottom surfaces, bridges, ironing
    SUPPORT = 4
    BRIM = 5  # skirt, brim, raft
    TOWER = 6  # wipe tower, purge and prime lines


NO_OBJECT = -1
_AT_ONCE = 1 << 19  # beads, of what is mapped from a file


@dataclass(frozen=True, eq=False)
class Toolpath:
    """Every bead of one G-code file, in file order (N beads, L layers). Arrays may be memory-mapped; treat as read-only.

    beads_mm    : (N, 8) float32: x0 y0 z0 x1 y1 z1 width height, print coordinates; z is the bead's TOP (nozzle height)
    end_pos     : (N,) int64, never decreasing: file position from which on the bead lies (the end of its command)
    layer_start : (L + 1,) int64: index of each layer's first bead; the last entry is N. No layer is empty
    layer_end_pos : (L,) int64: file position at which the layer is complete: after its last bead and the retraction
                  that directly follows it, or where the file then parks the head itself. A check of the layer belongs here
    layer_z_mm  : (L,) float32: print height of each layer (top of its beads)
    role        : (N,) uint8, see Role
    object_id   : (N,) int16, index into `objects`, or NO_OBJECT
    objects     : names of the labelled objects, in order of appearance
    cancelled   : objects that the file itself cancels: object index -> file position from which on it is not printed
    slicer      : name and version as the file tells it, or ""
    filament_mm : filament used, net of retraction, counted as the slicer counts
    filament_own_mm : what the user's own G-code feeds (start, tool changes), which some slicers count and some do not
    bytes       : length of the file in file positions
    notes       : sentences for the user about what could not be understood, e.g. how many lines were skipped
    cancel_commands : for each object, the command that makes the firmware skip it ("M486 P2", "EXCLUDE_OBJECT NAME=x"),
                  "" where the file holds no labels that the firmware understands
    """

    beads_mm: np.ndarray
    end_pos: np.ndarray
    layer_start: np.ndarray
    layer_end_pos: np.ndarray
    layer_z_mm: np.ndarray
    role: np.ndarray
    object_id: np.ndarray
    objects: tuple[str, ...] = ()
    cancelled: tuple[tuple[int, int], ...] = ()
    slicer: str = ""
    filament_mm: float = 0.0
    bytes: int = 0
    notes: tuple[str, ...] = ()
    cancel_commands: tuple[str, ...] = ()
    filament_own_mm: float = 0.0

    def __len__(self) -> int:
        return len(self.beads_mm)

    @property
    def layers(self) -> int:
        return len(self.layer_z_mm)

    def laid_at(self, file_pos: int) -> int:
        """How many beads lie when every command that ends at or before `file_pos` has been executed."""
        return int(np.searchsorted(self.end_pos, file_pos, side="right"))

    def layer_at(self, file_pos: int) -> int:
        """The layer of the last bead laid at `file_pos`; -1 before the first."""
        laid = self.laid_at(file_pos)
        return int(np.searchsorted(self.layer_start, laid, side="left")) - 1

    def bounds_mm(self) -> np.ndarray:
        """(2, 3) float64: lowest and highest corner of the extruded centre lines; zeros where nothing is extruded.

        z of the lowest corner is the print height of the lowest bead's top.
        """
        return self._bounds_mm.copy()

    def let_go(self) -> None:
        """Take no memory for what is mapped from a file: what was read of it is read again when it is next asked for."""
        for column in (self.beads_mm, self.end_pos, self.role, self.object_id):
            if isinstance(column.base, mmap.mmap) and hasattr(mmap, "MADV_DONTNEED"):
                column.base.madvise(mmap.MADV_DONTNEED)

    @cached_property
    def _bounds_mm(self) -> np.ndarray:
        if not len(self):
            return np.zeros((2, 3))
        lows, highs = [], []
        for first in range(0, len(self), _AT_ONCE):
            beads = self.beads_mm[first : first + _AT_ONCE]
            lows.append(beads.min(axis=0))
            highs.append(beads.max(axis=0))
            self.let_go()
        low, high = np.min(lows, axis=0), np.max(highs, axis=0)
        return np.stack([np.minimum(low[:3], low[3:6]), np.maximum(high[:3], high[3:6])]).astype(np.float64)
