"""A frame in small. What concerns the whole picture (can it be used, did the camera move, has the light changed, does
something stand before it) needs it no larger, and a quarter of the width is a sixteenth of the work."""

from __future__ import annotations

import cv2
import numpy as np

USUAL_WIDTH_PX = 640


class Glance:
    """One frame, (H, W, 3) uint8 BGR, made smaller once for all who look at the whole of it.

    finer : see `finer`
    """

    def __init__(self, frame_bgr: np.ndarray) -> None:
        self.finer = finer(frame_bgr.shape[1])
        self._sizes = {1: frame_bgr}

    @property
    def half(self) -> np.ndarray:
        """(h, w, 3) uint8: about 320 px wide."""
        return self.at(2 * self.finer)

    @property
    def quarter(self) -> np.ndarray:
        """(h, w, 3) uint8: about 160 px wide."""
        return self.at(4 * self.finer)

    def at(self, step: int) -> np.ndarray:
        """(h, w, 3) uint8: the frame at 1/step of its size."""
        if step not in self._sizes:
            # OpenCV halves a picture many times faster than it does anything else to its size
            larger = step // 2 if step % 4 == 0 else 2 if step % 2 == 0 and step > 2 else 1
            self._sizes[step] = shrunk(self.at(larger), step // larger)
        return self._sizes[step]


def finer(width_px: int) -> int:
    """About how many times wider than USUAL_WIDTH_PX a picture is, at least 1."""
    return max(1, round(width_px / USUAL_WIDTH_PX))


def shrunk(picture: np.ndarray, step: int) -> np.ndarray:
    """A picture (H, W, ...) at 1/step of its size, each pixel the mean of those that it stands for."""
    if step == 1:
        return picture
    size_px = max(picture.shape[1] // step, 1), max(picture.shape[0] // step, 1)
    return cv2.resize(picture, size_px, interpolation=cv2.INTER_AREA)
