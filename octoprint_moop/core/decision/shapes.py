"""Masks (bool) moved, turned and filled: what a part of a print would look like elsewhere."""

from __future__ import annotations

import cv2
import numpy as np

from .spots import Window, about, disc

LEAST_REACH_PX, REACH_RATIO = 24, 0.6  # how far a part is looked for: a share of its size
BESIDE_PX = 2.0  # at 640 pixels across; contours are so uncertain


def middle_of(mask: np.ndarray) -> np.ndarray:
    """(2,) float64: the mean column and row of its pixels; zeros where it has none."""
    few = about(mask)
    sums = cv2.moments(mask[few].view(np.uint8), binaryImage=True)
    corner = np.array([few[1].start, few[0].start])
    return (np.array([sums["m10"], sums["m01"]]) + sums["m00"] * corner) / max(sums["m00"], 1.0)


def box_of(mask: np.ndarray, margin_px: int) -> Window:
    """Rows and columns that hold a mask's pixels, and so much more."""
    x, y, w, h = cv2.boundingRect(mask.view(np.uint8))
    return slice(max(y - margin_px, 0), y + h + margin_px), slice(max(x - margin_px, 0), x + w + margin_px)


def best_place(part: np.ndarray, pays: np.ndarray, reach_px: int | None = None) -> tuple[int, int]:
    """(right, down) in pixels: where the mask `part` would cover most of what `pays`, float32; outside nothing does.

    reach_px : how far is looked; None for a part of the part's own size
    """
    x, y, w, h = cv2.boundingRect(part.view(np.uint8))
    reach = max(LEAST_REACH_PX, int(REACH_RATIO * max(w, h))) if reach_px is None else reach_px
    pays = cv2.copyMakeBorder(pays, reach, reach, reach, reach, cv2.BORDER_CONSTANT, value=-1.0)
    field = pays[y : y + h + 2 * reach, x : x + w + 2 * reach]
    score = cv2.matchTemplate(field, part[y : y + h, x : x + w].astype(np.float32), cv2.TM_CCORR)
    column, row = cv2.minMaxLoc(score)[3]
    return column - reach, row - reach


def displaced(mask: np.ndarray, offset_px: tuple[int, int]) -> np.ndarray:
    """bool: the mask moved by so much to the right and down."""
    height, width = mask.shape
    right, down = min(max(offset_px[0], -width), width), min(max(offset_px[1], -height), height)
    there = np.zeros_like(mask)
    there[max(down, 0) : height + min(down, 0), max(right, 0) : width + min(right, 0)] = mask[
        max(-down, 0) : height - max(down, 0), max(-right, 0) : width - max(right, 0)
    ]
    return there


def turned(mask: np.ndarray, turn_deg: float) -> np.ndarray:
    """bool: the mask turned about its middle, in the picture."""
    if not turn_deg or not mask.any():
        return mask
    x, y = middle_of(mask)
    matrix = cv2.getRotationMatrix2D((float(x), float(y)), turn_deg, 1.0)
    return cv2.warpAffine(mask.astype(np.uint8), matrix, mask.shape[::-1]) > 0


def turned_on_bed(mask: np.ndarray, turn_deg: float, middle: np.ndarray, mm_per_px: np.ndarray) -> np.ndarray:
    """bool: what lies flat there, turned about that pixel on the bed as the camera sees it.

    mm_per_px : (2, 2), the step on the bed, in columns, for a step of one pixel to the right and one down
    """
    if not turn_deg or abs(np.linalg.det(mm_per_px)) < 1e-9:
        return mask
    turn = np.radians(turn_deg)
    on_bed = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    in_picture = np.linalg.solve(mm_per_px, on_bed @ mm_per_px)
    matrix = np.column_stack([in_picture, middle - in_picture @ middle])
    return cv2.warpAffine(mask.view(np.uint8), matrix, mask.shape[::-1]) > 0


def drawn(pixels: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """bool: a mask of that shape with pixels (N, 2) that have been pulled apart a little."""
    column, row = np.rint(pixels).astype(int).T
    height, width = shape
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    mask = np.zeros(shape, np.uint8)
    mask[row[inside], column[inside]] = 1
    return cv2.morphologyEx(mask, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8)) > 0


def filled(mask: np.ndarray) -> np.ndarray:
    """bool: all within the outer contours of a mask."""
    whole = closed(mask, BESIDE_PX).view(np.uint8)
    contours = cv2.findContours(whole, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]
    return cv2.drawContours(np.zeros_like(whole), contours, -1, 1, cv2.FILLED) > 0


def closed(mask: np.ndarray, radius_px: float) -> np.ndarray:
    """bool: with gaps closed that a disc of that radius does not fit into."""
    rim = int(np.ceil(radius_px)) + 1
    wide = cv2.copyMakeBorder(mask.view(np.uint8), rim, rim, rim, rim, cv2.BORDER_CONSTANT)
    return cv2.morphologyEx(wide, cv2.MORPH_CLOSE, disc(radius_px))[rim:-rim, rim:-rim] > 0
