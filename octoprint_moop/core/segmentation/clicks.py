"""A print cut out of one picture by a few points that somebody clicked on it.

By random walks (Grady 2006, with a prior by colour as in Grady 2005): a pixel is filament if whoever walks from it at
random, rather along even parts of the picture than across its edges, comes to a filament click before he comes to a
background click or to the region's end. So shades of a shaded print that nobody clicked are reached, and a background
of the filament's colour is not. The colours of the print so cut out then draw the walk.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from ..errors import SegmentationError
from .appearance import ColourModel, count_colours, evidence, opponent

_SIDE_PX, _SPOT_PX = 128, 2  # the size at which the picture is cut, and what is taken about a click
_EDGE = 0.2  # in mean squares of the difference between neighbours: beyond it, a walker turns back
_CROSSING = 1e-4  # how readily the strongest edge is crossed
_END = 0.5  # how much the region's end draws, as background; a click draws absolutely
_COLOUR = 0.003  # how much a pixel's colour draws, against its neighbours
_ROUNDS = 2  # of learning colours from the cut
_CUT_COUNT, _CLICK_COUNT = 3000.0, 1000.0  # pixels for which the cut and the clicks count in the colours
_REACH, _REACH_LEAST = 1.0, 0.12  # around the clicks on filament: in their spread, in the picture's diagonal
_STEPS_MOST, _SOLVED = 300, 1e-8

Region = tuple[int, int, int, int]  # x0, y0, x1, y1


def label_from_clicks(
    frame_bgr: np.ndarray,
    filament_px: Sequence[tuple[int, int]],
    background_px: Sequence[tuple[int, int]],
    region: Region | None = None,
) -> np.ndarray:
    """(H, W) uint8, 255 on what the clicks point out as filament.

    frame_bgr : (H, W, 3) uint8
    filament_px, background_px : (x, y) in the frame, at least one each
    region    : (x0, y0, x1, y1) that holds the whole print; about the clicks on filament, where None
    Raises SegmentationError where points are missing or outside of the frame or region.
    """
    height, width = frame_bgr.shape[:2]
    x0, y0, x1, y1 = region or (0, 0, width, height)
    x0, y0, x1, y1 = max(x0, 0), max(y0, 0), min(x1, width), min(y1, height)
    for what, points in (("filament", filament_px), ("background", background_px)):
        if not len(points):
            raise SegmentationError(f"No point on {what} was clicked. Click at least one, better three.")
        for x, y in points:
            if not (x0 <= x < x1 and y0 <= y < y1):
                raise SegmentationError(f"The point {(x, y)} on {what} lies outside of the picture. Click it again.")
    if region is None:
        x0, y0, x1, y1 = _around(filament_px, (width, height))
    crop = frame_bgr[y0:y1, x0:x1]
    scale = min(1.0, _SIDE_PX / max(crop.shape[:2]))
    small = cv2.resize(crop, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    spots = []
    for points in (filament_px, background_px):
        spot = np.zeros(small.shape[:2], np.uint8)
        for x, y in points:
            if x0 <= x < x1 and y0 <= y < y1:
                cv2.circle(spot, (int((x - x0) * scale), int((y - y0) * scale)), _SPOT_PX, 255, cv2.FILLED)
        spots.append(spot > 0)
    cut = _cut_out(small, spots[0], spots[1] & ~spots[0])
    label = np.zeros((height, width), np.uint8)
    label[y0:y1, x0:x1] = cv2.resize(
        np.where(cut, np.uint8(255), np.uint8(0)), crop.shape[1::-1], interpolation=cv2.INTER_NEAREST
    )
    return label


def _around(points: Sequence[tuple[int, int]], size_px: tuple[int, int]) -> Region:
    """A print is rarely much larger than the points clicked on it are apart."""
    low, high = np.min(points, axis=0), np.max(points, axis=0)
    reach = int(max(_REACH * (high - low).max(), _REACH_LEAST * np.hypot(*size_px)))
    x0, y0 = np.maximum(low - reach, 0)
    x1, y1 = np.minimum(high + reach + 1, size_px)
    return int(x0), int(y0), int(x1), int(y1)


def _cut_out(picture_bgr: np.ndarray, filament: np.ndarray, background: np.ndarray) -> np.ndarray:
    """(H, W) bool: filament, by the pixels (bool) known to be filament and known to be background."""
    across, down = _ease(picture_bgr)
    end = np.zeros(filament.shape)
    end[[0, -1]], end[:, [0, -1]] = _END, _END
    end[filament] = 0
    known, filament_odds = filament | background, filament.astype(float)
    chance = _walk(across, down, end, np.zeros_like(end), known, filament_odds)
    colours = opponent(cv2.medianBlur(picture_bgr, 3))
    for _ in range(_ROUNDS):
        cut = chance > 0.5
        on, off = (
            _CUT_COUNT * _shares(colours, where) + _CLICK_COUNT * _shares(colours, clicked)
            for where, clicked in ((cut, filament), (~cut, background))
        )
        likely = 1 / (1 + np.exp(-evidence(colours, ColourModel(on, off)).astype(float)))
        chance = _walk(across, down, end + _COLOUR, _COLOUR * likely, known, filament_odds)
    return chance > 0.5


def _shares(colours: np.ndarray, where: np.ndarray) -> np.ndarray:
    counts = count_colours(colours, where)
    return counts / max(float(counts.sum()), 1.0)


def _ease(picture_bgr: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(H, W-1) and (H-1, W) float64: how readily one walks to the neighbour on the right, and to the one below."""
    colours = opponent(cv2.GaussianBlur(picture_bgr, (3, 3), 0)).astype(float)
    steps = [(np.diff(colours, axis=axis) ** 2).sum(axis=-1) for axis in (1, 0)]
    usual = max(float(np.concatenate([step.ravel() for step in steps]).mean()), 1e-9)
    across, down = (np.exp(-step / (_EDGE * usual)) + _CROSSING for step in steps)
    return across, down


def _walk(
    across: np.ndarray, down: np.ndarray, pull: np.ndarray, towards: np.ndarray, known: np.ndarray, value: np.ndarray
) -> np.ndarray:
    """(H, W) float64, 0..1: the chance that a walker from each pixel ends on filament.

    across, down : from `_ease`
    pull, towards: a pixel ends the walk with the weight `pull`, on filament with the part `towards` of it
    known, value : there the chance is given
    Solves (Laplacian + pull) chance = towards by conjugate gradients, as preconditioner its diagonal.
    """

    def flow(chance: np.ndarray) -> np.ndarray:
        right, below = across * np.diff(chance, axis=1), down * np.diff(chance, axis=0)
        result = pull * chance
        result[:, 1:] += right
        result[:, :-1] -= right
        result[1:] += below
        result[:-1] -= below
        return result

    free = ~known
    diagonal = pull.copy()
    diagonal[:, 1:] += across
    diagonal[:, :-1] += across
    diagonal[1:] += down
    diagonal[:-1] += down
    chance = np.where(known, value, 0.0)
    rest = (towards - flow(chance)) * free
    scaled = rest / diagonal * free
    step, size = scaled, float((rest * scaled).sum())
    for _ in range(_STEPS_MOST):
        if size < _SOLVED:
            break
        along = flow(step) * free
        length = size / float((step * along).sum())
        chance = chance + length * step
        rest = rest - length * along
        scaled = rest / diagonal * free
        before, size = size, float((rest * scaled).sum())
        step = scaled + size / before * step
    return chance
