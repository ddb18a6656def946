"""Whether what looks like the bed, pixel by pixel, has its fine detail: a dark head before a dark bed has none."""

from __future__ import annotations

import cv2
import numpy as np

from .spots import about

SIDE, LEAST_PX, LEAST, LEFT = (5, 5), 30, 0.5, 0.25  # grey levels, and what of them is left


def lacks_grain(look: np.ndarray, where: np.ndarray, bed: np.ndarray) -> bool:
    """Whether the pixels `where` show so little of fine detail, a quarter of what the bed shows, that something smooth is seen.

    look : (3, h, w) uint8, smoothed already; where, bed : (h, w) bool
    Both are seen in the same picture and so in the same light. What the bed looked like is not asked: what was last seen bare
    beside matter has something of its colour.
    """
    here, there = (cv2.erode(mask.view(np.uint8), np.ones(SIDE, np.uint8)) > 0 for mask in (where, bed))
    if min(np.count_nonzero(here), np.count_nonzero(there)) < LEAST_PX:
        return False
    had = _grain(look, there)
    return had > len(look) * LEAST**2 and _grain(look, here) < LEFT**2 * had


def _grain(look: np.ndarray, where: np.ndarray) -> float:
    """The variance of pixels against the mean about them, summed over the planes."""
    few = about(where)
    differences = (cv2.subtract(plane[few], cv2.blur(plane[few], SIDE), dtype=cv2.CV_32F) for plane in look)
    return sum(float(one[where[few]].var()) for one in differences)
