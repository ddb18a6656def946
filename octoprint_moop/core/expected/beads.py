"""Beads made ready for drawing: chosen, cut where the lens would bend them, in chunks."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..camera import Camera

DRAWN_BEAD = np.dtype([("start", "f4", 3), ("end", "f4", 3), ("size", "f4", 2), ("birth", "u4")])

# A chord of this angle, in radians, leaves its image's curve by less than 0.05 px at 1920 px where k1 = -0.3.
STRAIGHT_RAD = 1 / 25


def straight_mm(bounds_mm: np.ndarray, camera: Camera, room_from_print_mm: np.ndarray) -> float:
    """Length up to which every line within the bounds has a straight image; infinite for a lens that bends none.

    bounds_mm : (2, 3), lowest and highest corner, print coordinates
    """
    if camera.model != "fisheye" and not camera.distortion.any():
        return np.inf
    low, high = bounds_mm
    eye = camera.centre_mm - room_from_print_mm
    return max(1.0, STRAIGHT_RAD * float(np.linalg.norm(eye - np.clip(eye, low, high))))


def drawn_beads(beads_mm: np.ndarray, chosen: np.ndarray | None, longest_mm: float, chunk: int) -> Iterator[np.ndarray]:
    """Chunks of DRAWN_BEAD in file order, `birth` = 1 + the bead's index in `beads_mm`; none longer than `longest_mm`.

    beads_mm : (N, 8) float32, see Toolpath; may be memory-mapped
    chosen   : sorted indices of the beads wanted, None for all
    chunk    : most beads in one chunk
    """
    count = len(beads_mm) if chosen is None else len(chosen)
    for first in range(0, count, chunk):
        last = min(first + chunk, count)
        index = np.arange(first, last) if chosen is None else np.asarray(chosen[first:last])
        rows = np.asarray(beads_mm[first:last] if chosen is None else beads_mm[index], dtype=np.float32)
        drawn = np.empty(len(rows), dtype=DRAWN_BEAD)
        drawn["start"], drawn["end"], drawn["size"], drawn["birth"] = rows[:, :3], rows[:, 3:6], rows[:, 6:], index + 1
        if np.isfinite(longest_mm):
            run = drawn["end"] - drawn["start"]
            pieces = np.ceil(np.sqrt(np.einsum("ij,ij->i", run, run)) / longest_mm).astype(np.int64).clip(1)
            if pieces.max() > 1:
                # group by group, so that many long beads before a near camera do not fill the memory
                groups = np.searchsorted(np.cumsum(pieces), np.arange(chunk, pieces.sum(), chunk))
                for some in np.split(np.arange(len(drawn)), groups):
                    parts = _cut(drawn[some], run[some], pieces[some])
                    for begin in range(0, len(parts), chunk):
                        yield parts[begin : begin + chunk]
                continue
        yield drawn


def _cut(drawn: np.ndarray, run: np.ndarray, pieces: np.ndarray) -> np.ndarray:
    """Each bead as `pieces` equal parts in a row, each with its bead's birth."""
    parts = np.repeat(drawn, pieces)
    number = np.arange(len(parts)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    step = np.repeat(run / pieces[:, None], pieces, axis=0)
    parts["end"] = parts["start"] + step * (number + 1)[:, None]
    parts["start"] += step * number[:, None]
    return parts
