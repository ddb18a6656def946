"""From beads and what was said about them to layers, widths, heights, roles and objects: the second half of reading."""

from __future__ import annotations

import math
from array import array

import numpy as np

from .said import Changes, Said
from .store import Column
from .travels import FAR_MM, Travels

CHUNK_ROWS = 1 << 20
SAME_HEIGHT_MM = 0.02  # heights nearer than this are one print height
STEEPEST_SPIRAL = 0.5  # rise over run: a bead that climbs more steeply moves to another height, it is no vase
WIDEST_NOZZLES, NARROWEST_NOZZLES = 3.0, 0.5  # a bead's width, in nozzles
HIGHEST_NOZZLES, LOWEST_MM = 1.25, 0.04  # a bead's height


class Held:
    """Which value holds for each bead. `values[i]` holds from bead `starts[i]` on."""

    def __init__(self, changes: Changes, unsaid: float) -> None:
        self.starts = np.concatenate([[0], np.array(changes.bead, np.int64)])
        self.values = np.concatenate([[unsaid], np.array(changes.value)]).astype(np.float32)

    def lengths(self, count: int) -> np.ndarray:
        """For how many of `count` beads each value holds."""
        return np.diff(np.minimum(np.append(self.starts, count), count))

    def at(self, bead: int) -> float:
        return float(self.values[np.searchsorted(self.starts, bead, side="right") - 1])

    def of(self, first: int, last: int) -> np.ndarray:
        """(last - first,) float32, the values of beads [first, last)."""
        return _spread(self.starts, self.values, first, last)


def _spread(starts: np.ndarray, values: np.ndarray, first: int, last: int) -> np.ndarray:
    """(last - first,): `values[i]` from `starts[i]` on, as a copy."""
    low = int(np.searchsorted(starts, first, side="right")) - 1
    high = int(np.searchsorted(starts, last, side="left"))
    bounds = np.append(np.maximum(starts[low:high], first), last)
    return np.repeat(values[low:high], np.diff(bounds))


def layer_starts(beads: Column, said: Said) -> np.ndarray:
    """(L + 1,) int64: index of each layer's first bead, then the number of beads.

    The kind of layer comment that divides the print most finely decides; without any, the print's heights do.
    What is laid before the first comment belongs to the first layer.
    """
    count = len(beads)
    best = np.zeros(0, np.int64)
    for marks in said.layers.values():
        starts = np.array(marks, np.int64)
        starts = starts[(starts < count) & (np.diff(starts, append=count) > 0)]  # a layer of no beads is none
        if len(starts) > len(best):
            best = starts
    if len(best):
        best[0] = 0
        return np.append(best, count)
    return np.append(starts_by_height(beads), count)


def starts_by_height(beads: Column) -> np.ndarray:
    """Index of the first bead at each new print height; in a spiral, of the first bead of each turn.

    Heights that are only travelled through (z-hops) are none. The print is cut into runs, between which the nozzle
    goes to another height; a run that climbs gently by itself is a spiral.
    """
    first_bead, z_begin, z_first, z_before, climbs = _runs(beads)
    last_bead = np.append(first_bead[1:], len(beads))
    z_end = np.append(z_before[1:], beads.read(len(beads) - 1, len(beads))[0, 5])
    starts: list[np.ndarray] = []
    level = -math.inf
    for i in range(len(first_bead)):
        first, last = int(first_bead[i]), int(last_bead[i])
        if abs(z_end[i] - z_begin[i]) > SAME_HEIGHT_MM and not climbs[i] and last - first > 2:
            starts.append(_turns(beads, first, last))
            level = z_end[i]
        elif abs(z_first[i] - level) > SAME_HEIGHT_MM:
            starts.append(np.array([first]))
            level = z_first[i]
    return np.concatenate(starts).astype(np.int64)


def _runs(beads: Column) -> tuple[np.ndarray, ...]:
    """Where the height changes otherwise than by a gentle climb: index of the bead, z at its start and at its end, z
    at the end of the bead before, and whether the bead itself climbs steeply."""
    parts = []
    before = -math.inf
    for first, last in beads.blocks():
        block = beads.read(first, last).astype(np.float64)
        z0, z1 = block[:, 2], block[:, 5]
        run = np.hypot(block[:, 3] - block[:, 0], block[:, 4] - block[:, 1])
        steep = np.abs(z1 - z0) > np.maximum(run * STEEPEST_SPIRAL, SAME_HEIGHT_MM)
        z_before = np.concatenate([[before], z1[:-1]])
        at = np.flatnonzero((np.abs(z0 - z_before) > SAME_HEIGHT_MM) | steep)
        parts.append((at + first, z0[at], z1[at], z_before[at], steep[at]))
        before = z1[-1]
    return tuple(np.concatenate(column) for column in zip(*parts))


def _turns(beads: Column, first: int, last: int) -> np.ndarray:
    """Index of the first bead of each round of a spiral [first, last).

    Rounds are told by the tangent, which turns by 2π in one round of any simple closed curve.
    """
    starts = [np.array([first])]
    turned, most, rounds = 0.0, 0.0, 0
    heading: float | None = None
    for begin in range(first, last, CHUNK_ROWS):
        block = beads.read(begin, min(begin + CHUNK_ROWS, last)).astype(np.float64)
        headings = np.arctan2(block[:, 4] - block[:, 1], block[:, 3] - block[:, 0])
        change = np.diff(headings, prepend=headings[0] if heading is None else heading)
        total = turned + np.cumsum((change + math.pi) % (2.0 * math.pi) - math.pi)
        furthest = np.maximum(np.maximum.accumulate(np.abs(total)), most)
        done = np.floor(furthest / (2.0 * math.pi) + 1e-6).astype(np.int64)
        starts.append(begin + np.flatnonzero(np.diff(done, prepend=rounds)))
        turned, most, rounds, heading = float(total[-1]), float(furthest[-1]), int(done[-1]), float(headings[-1])
    return np.concatenate(starts)


def layer_shapes(beads: Column, starts: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Each layer's height, (L,) float32, and its lowest and highest corner in X and Y, (L, 2) float32 each.

    The height is that at which most of a layer is laid; in a spiral the highest.
    """
    low, high = _corners(beads, starts)
    heights = high[:, 5].copy()
    for i in np.flatnonzero(high[:, 5] - low[:, 5] > 1e-4).tolist():
        block = beads.read(int(starts[i]), min(int(starts[i + 1]), int(starts[i]) + CHUNK_ROWS))
        levels, which = np.unique(np.round(block[:, 5], 3), return_inverse=True)
        lengths = np.hypot(block[:, 3] - block[:, 0], block[:, 4] - block[:, 1])
        shares = np.bincount(which.ravel(), weights=lengths)
        if shares.max() >= 0.25 * shares.sum():
            heights[i] = levels[shares.argmax()]
    return heights, np.minimum(low[:, :2], low[:, 3:5]), np.maximum(high[:, :2], high[:, 3:5])


def _corners(beads: Column, starts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(L, 6) float32 each: the lowest and the highest of a layer's x0 y0 z0 x1 y1 z1."""
    low = np.full((len(starts) - 1, 6), np.inf, np.float32)
    high = -low
    for first, last in beads.blocks():
        layers = slice(int(np.searchsorted(starts, first, side="right")) - 1, int(np.searchsorted(starts, last)))
        heads = np.maximum(starts[layers] - first, 0)
        columns = np.ascontiguousarray(beads.read(first, last)[:, :6].T)
        low[layers] = np.minimum(low[layers], np.minimum.reduceat(columns, heads, axis=1).T)
        high[layers] = np.maximum(high[layers], np.maximum.reduceat(columns, heads, axis=1).T)
    return low, high


def layer_steps(heights_mm: np.ndarray, usual_mm: float | None, nozzle_mm: float) -> np.ndarray:
    """(L,) float32: how far each layer lies above what is under it, for beads whose height no comment tells."""
    tallest = HIGHEST_NOZZLES * nozzle_mm
    below = np.concatenate([[0.0], heights_mm[:-1]])
    steps = heights_mm - below
    for i in np.flatnonzero(steps < -SAME_HEIGHT_MM):  # the next object of a sequential print starts on the bed
        under = heights_mm[:i][heights_mm[:i] < heights_mm[i] - SAME_HEIGHT_MM]
        steps[i] = heights_mm[i] - under.max() if len(under) else heights_mm[i]
    sane = (steps > SAME_HEIGHT_MM) & (steps <= tallest)
    if usual_mm is None or not LOWEST_MM <= usual_mm <= tallest:
        usual_mm = float(np.median(steps[sane])) if sane.any() else 0.5 * nozzle_mm
    return np.where(sane, steps, min(max(usual_mm, LOWEST_MM), tallest)).astype(np.float32)


def step_of(z_mm: np.ndarray, first: int, starts: np.ndarray, steps_mm: np.ndarray, nozzle_mm: float) -> np.ndarray:
    """(n,) float32: height of the beads from `first` on, by their layers; in the first layer, over the bed."""
    step = _spread(starts[:-1], steps_mm, first, first + len(z_mm))
    ground = max(min(int(starts[1]) - first, len(z_mm)), 0)
    step[:ground] = np.clip(z_mm[:ground], LOWEST_MM, HIGHEST_NOZZLES * nozzle_mm)
    return step


def widths_and_heights(
    area_mm2: np.ndarray,
    width_mm: np.ndarray,
    height_mm: np.ndarray,
    step_mm: np.ndarray,
    nozzle_mm: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Width and height of each bead, (N,) float32: as said, where it was said; else from the extruded volume.

    The cross-section is a rectangle with round sides, A = h (w - h) + π h²/4, so w = A/h + h (1 - π/4).

    area_mm2 : (N,) volume over length. step_mm : (N,) height where none was said
    """
    height = np.where(height_mm > 0.0, height_mm, step_mm)
    height = np.clip(height, LOWEST_MM, 2.0 * HIGHEST_NOZZLES * nozzle_mm)
    by_volume = area_mm2 / height + height * (1.0 - math.pi / 4.0)
    by_volume = np.clip(by_volume, NARROWEST_NOZZLES * nozzle_mm, WIDEST_NOZZLES * nozzle_mm)
    width = np.where(width_mm > 0.0, np.clip(width_mm, 0.05, 4.0 * WIDEST_NOZZLES * nozzle_mm), by_volume)
    return width.astype(np.float32), height.astype(np.float32)


def layer_ends(end_pos: Column, starts: np.ndarray, tails: tuple[array[int], array[int]]) -> np.ndarray:
    """(L,) int64: end of each layer's last bead, or of the retraction that directly follows it."""
    last = starts[1:] - 1
    ends = np.concatenate(
        [end_pos.read(*block)[last[slice(*np.searchsorted(last, block))] - block[0]] for block in end_pos.blocks()]
    )
    if len(tails[0]):
        beads, positions = (np.array(tail, np.int64) for tail in tails)
        found = np.searchsorted(beads, last, side="right") - 1
        hit = (found >= 0) & (beads[found] == last)
        ends[hit] = positions[found[hit]]
    return ends


def layer_parks(
    ends: np.ndarray, starts: np.ndarray, low_mm: np.ndarray, high_mm: np.ndarray, travels: Travels
) -> np.ndarray:
    """(L,) int64: `ends`, moved on to where the file itself parks the head before the next layer.

    A park is a travel from one layer to the next that goes FAR_MM or more beyond both, in X or in Y: a slicer's
    layer change G-code, put there so that a camera sees the print. Of several the farthest counts.
    """
    bead, end_pos = np.array(travels.bead, np.int64), np.array(travels.end_pos, np.int64)
    layer = np.searchsorted(starts[1:] - 1, bead)
    between = np.flatnonzero(starts[1:].take(layer, mode="clip") - 1 == bead)
    bead, end_pos, layer = bead[between], end_pos[between], layer[between]
    place = np.column_stack([np.array(travels.x), np.array(travels.y)])[between]
    after = np.minimum(layer + 1, len(ends) - 1)
    low, high = np.minimum(low_mm[layer], low_mm[after]), np.maximum(high_mm[layer], high_mm[after])
    beyond = np.maximum(low - place, place - high).max(axis=1)
    order = np.lexsort((-beyond, layer))  # of each layer the farthest first, of equally far ones the first
    _, first = np.unique(layer[order], return_index=True)
    far = order[first][beyond[order[first]] >= FAR_MM]
    found = ends.copy()
    found[layer[far]] = np.maximum(ends[layer[far]], end_pos[far])
    return found
