"""Spots of a mask: which of them mean something, by their size and by what they touch."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np

SPECK_PX = 6
HOLLOW_RIM_PX, HOLLOW_LEAST_PX = 1.5, 3
AROUND_PX, AMID_RATIO = (
    3.0,
    0.7,
)  # how far about a spot, and how much of that ring, is matter in its place about a hollow

Window = tuple  # (slice, slice): rows and columns


def about(where: np.ndarray) -> Window:
    """The rows and columns that hold all pixels of a bool mask, one at least; beyond, nothing needs to be worked out."""
    x, y, w, h = cv2.boundingRect(where.view(np.uint8))
    return slice(y, y + max(h, 1)), slice(x, x + max(w, 1))


def placed(where: np.ndarray, few: Window, values: np.ndarray) -> np.ndarray:
    """bool, of the shape of `where`: of its pixels, those of which the bool `values` of the `few` rows and columns say so."""
    whole = np.zeros(where.shape, bool)
    np.logical_and(values, where[few], out=whole[few])
    return whole


def near_to(wanted: np.ndarray, mask: np.ndarray, reach_px: float) -> np.ndarray:
    """The mask's spots that come as near to the expected mask (uint8): what has to do with the print begins at it."""
    if not mask.any():
        return mask
    if not wanted.any():
        return np.zeros_like(mask)
    few = about(mask)
    labels, areas_px = spots_of(mask[few])
    begins = np.bincount(labels[within(wanted, reach_px)[few] & mask[few]], minlength=len(areas_px)) > 0
    return placed(mask, few, begins[labels])


def without_hollows(lost: np.ndarray, wanted: np.ndarray, lying: np.ndarray) -> np.ndarray:
    """The lost spots that reach the expected mask's (uint8) edge, and do not end at matter in its place nearly all around.

    lying : bool, matter that is seen where it is expected
    Matter that stood does not go from amid what still stands: there a hollow has become dark as walls rose around it, or
    something narrow has come to stand before the print.
    """
    if not lost.any():
        return lost
    margin = int(AROUND_PX) + 1
    few = about(cv2.dilate(lost.view(np.uint8), np.ones((2 * margin + 1,) * 2, np.uint8)) > 0)
    labels, areas_px = spots_of(lost[few])
    rim = (wanted[few] > 0) & (cv2.erode(wanted, disc(HOLLOW_RIM_PX))[few] == 0)
    at_rim_px = np.bincount(labels[rim & lost[few]], minlength=len(areas_px))
    # what is lost keeps a pixel's distance from what is still seen
    near, around = (cv2.dilate(labels.astype(np.float32), disc(reach_px)) for reach_px in (AROUND_PX - 1, AROUND_PX))
    ring = np.where(near > 0, 0, around).astype(np.int32)
    around_px, amid_px = (
        np.bincount(ring[one], minlength=len(areas_px)) for one in (ring > 0, (ring > 0) & lying[few])
    )
    open_ended = amid_px <= AMID_RATIO * np.maximum(around_px, 1)
    return placed(lost, few, ((at_rim_px >= HOLLOW_LEAST_PX) & open_ended)[labels] & lost[few])


def within(wanted: np.ndarray, reach_px: float) -> np.ndarray:
    """bool: pixels so near to a mask (uint8), to about 4 px: the distance is measured at a quarter of the size."""
    coarse = cv2.dilate(wanted, np.ones((4, 4), np.uint8))[::4, ::4]
    near = cv2.distanceTransform(cv2.bitwise_not(coarse), cv2.DIST_L2, 3) < reach_px / 4
    return cv2.resize(near.view(np.uint8), wanted.shape[::-1], interpolation=cv2.INTER_NEAREST) > 0


def spots_of(mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The number of each pixel's spot, 0 outside of the mask (bool), and the spots' areas."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats(np.ascontiguousarray(mask).view(np.uint8), connectivity=8)
    return labels, stats[:, cv2.CC_STAT_AREA]


@lru_cache(maxsize=32)
def disc(radius_px: float) -> np.ndarray:
    """A round structuring element, uint8."""
    side = 2 * int(np.ceil(radius_px)) + 1
    y, x = np.mgrid[:side, :side] - side // 2
    return (x * x + y * y <= radius_px * radius_px + 0.5).astype(np.uint8)


def without_specks(mask: np.ndarray, least_px: int = SPECK_PX) -> np.ndarray:
    """The mask without spots of fewer pixels: noise comes in specks, strands do not."""
    if np.count_nonzero(mask) < least_px:
        return np.zeros_like(mask)
    few = about(mask)
    labels, areas_px = spots_of(mask[few])
    return placed(mask, few, (areas_px >= least_px)[labels])
