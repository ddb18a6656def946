"""Whether what looks like the bed, pixel by pixel, has its fine detail: a dark head before a dark bed has none."""

from __future__ import annotations

import cv2
import numpy as np

from .spots import about

RIM, LEAST_PX, LEAST, LEFT = (5, 5), 30, 1.0, 0.25  # grey levels, and what of them is left


def lacks_grain(look: np.ndarray, bare: np.ndarray, where: np.ndarray, beside: np.ndarray) -> bool:
    """Whether the pixels `where` show so little of fine detail, a quarter of what the bare bed has there, that something
    smooth must be seen instead, of the bed's colour.

    The bed `beside` must have as much: what was last seen bare beside matter has something of its colour.
    look, bare : (3, h, w) uint8, what is seen and how the bed looks without matter; where, beside : (h, w) bool
    """
    inside, around = (cv2.erode(mask.view(np.uint8), np.ones(RIM, np.uint8)) > 0 for mask in (where, beside))
    if min(np.count_nonzero(inside), np.count_nonzero(around)) < LEAST_PX:
        return False
    now, there, elsewhere = (_grain(*one) for one in ((look, inside), (bare, inside), (bare, around)))
    had = min(there, elsewhere)
    return had > len(look) * LEAST**2 and now < LEFT**2 * had


def _grain(look: np.ndarray, where: np.ndarray) -> float:
    """The variance of what changes within some 15 pixels in the planes, smoothed already, summed over them."""
    few = about(where)
    inside = where[few]
    return sum(
        float((plane[few].astype(np.float32) - cv2.blur(plane[few], (15, 15)).astype(np.float32))[inside].var())
        for plane in look
    )
