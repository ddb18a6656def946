"""A frame in small. What concerns the whole picture (can it be used, did the camera move, has the light changed, does
something stand before it) needs it no larger, and a quarter of the width is a sixteenth of the work."""

from __future__ import annotations

from functools import cached_property

import cv2
import numpy as np

USUAL_WIDTH_PX = 640


class Glance:
    """One frame, (H, W, 3) uint8 BGR, made smaller once for all who look at the whole of it.

    finer : see `finer`
    """

    def __init__(self, frame_bgr: np.ndarray) -> None:
        self.finer = finer(frame_bgr.shape[1])
        self._frame_bgr = frame_bgr

    @cached_property
    def half(self) -> np.ndarray:
        """(h, w, 3) uint8: about 320 px wide."""
        return shrunk(self._frame_bgr, 2 * self.finer)

    @cached_property
    def quarter(self) -> np.ndarray:
        """(h, w, 3) uint8: about 160 px wide."""
        return shrunk(self.half, 2)


def finer(width_px: int) -> int:
    """About how many times wider than USUAL_WIDTH_PX a picture is, at least 1."""
    return max(1, round(width_px / USUAL_WIDTH_PX))


def shrunk(picture: np.ndarray, step: int) -> np.ndarray:
    """A picture (H, W, ...) at 1/step of its size, each pixel the mean of those that it stands for."""
    while step % 2 == 0 and step > 2:  # OpenCV halves a picture many times faster than it does anything else to its size
        picture, step = shrunk(picture, 2), step // 2
    if step == 1:
        return picture
    size_px = max(picture.shape[1] // step, 1), max(picture.shape[0] // step, 1)
    return cv2.resize(picture, size_px, interpolation=cv2.INTER_AREA)
