"""The part of a view that is looked at closely: where a print will ever be seen, and what is around it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from ..expected.views import Expected, PrintMap, Silhouette, surroundings
from .glance import Glance, finer, shrunk

WORK_WIDTH_PX = 900  # a picture twice as wide is looked at in half the size, and so on


@dataclass(frozen=True)
class Window:
    """Rows and columns of a camera's picture, looked at in 1/step of their size.

    size_px        : (width, height) of the whole picture
    x0, y0, x1, y1 : the window's sides, the last two just outside; they lie between the pixels of `Glance.quarter` too
    """

    size_px: tuple[int, int]
    x0: int
    y0: int
    x1: int
    y1: int
    step: int = 1

    @classmethod
    def about(cls, complete: np.ndarray) -> Window:
        """About the complete print, (H, W) uint8, and what is around it; see `surroundings`."""
        height, width = complete.shape
        unit = 4 * finer(width)
        step = max(step for step in range(1, max(width // WORK_WIDTH_PX, 1) + 1) if unit % step == 0)
        rows, columns = surroundings(complete, 24 * step)
        x0, x1 = _sides(columns.start, columns.stop, width, unit)
        y0, y1 = _sides(rows.start, rows.stop, height, unit)
        return cls((width, height), x0, y0, x1, y1, step)

    def holds(self, complete: np.ndarray) -> bool:
        """Whether that is still a good window for this complete print: not much of its surroundings is cut off."""
        if complete.shape[::-1] != self.size_px:
            return False
        x, y, w, h = cv2.boundingRect(complete)
        margin = max(w, h) // 8
        width, height = self.size_px
        within_x = self.x0 <= max(x - margin, 0) and min(x + w + margin, width - self._unit) <= self.x1
        within_y = self.y0 <= max(y - margin, 0) and min(y + h + margin, height - self._unit) <= self.y1
        return within_x and within_y

    @property
    def shape(self) -> tuple[int, int]:
        """(height, width) of what `of` gives."""
        return (self.y1 - self.y0) // self.step, (self.x1 - self.x0) // self.step

    @property
    def _unit(self) -> int:
        """A pixel of `Glance.quarter` is so many of the picture's wide."""
        return 4 * finer(self.size_px[0])

    @property
    def box(self) -> tuple[float, float, float, float]:
        """Left, top, right and bottom in parts of the whole picture."""
        width, height = self.size_px
        return self.x0 / width, self.y0 / height, self.x1 / width, self.y1 / height

    @property
    def from_picture(self) -> np.ndarray:
        """(3, 3): the window's pixels from the picture's, homogeneous."""
        middle = (1 - self.step) / 2 / self.step
        return np.array(
            [
                [1 / self.step, 0, middle - self.x0 / self.step],
                [0, 1 / self.step, middle - self.y0 / self.step],
                [0, 0, 1],
            ]
        )

    def in_picture(self, pixels: np.ndarray) -> np.ndarray:
        """(N, 2) float64: the picture's pixels from the window's."""
        return np.asarray(pixels, float) * self.step + [self.x0, self.y0] + np.array((self.step - 1) / 2)

    @property
    def part(self) -> tuple[slice, slice]:
        """Rows and columns of the picture."""
        return slice(self.y0, self.y1), slice(self.x0, self.x1)

    @property
    def _small(self) -> tuple[slice, slice]:
        """Rows and columns of `Glance.quarter`."""
        unit = self._unit
        return slice(self.y0 // unit, self.y1 // unit), slice(self.x0 // unit, self.x1 // unit)

    def cut(self, picture: np.ndarray) -> np.ndarray:
        """The window's part of a whole picture (H, W, ...), in full size; not a copy."""
        return picture[self.part]

    def within(self, rows: slice, columns: slice) -> Window:
        """Of the window, these rows and columns."""
        step = self.step
        return replace(
            self, x0=self.x0 + columns.start * step, x1=self.x0 + columns.stop * step,
            y0=self.y0 + rows.start * step, y1=self.y0 + rows.stop * step,
        )  # fmt: skip

    def sharp(self) -> Window:
        """The same part of the picture, in the picture's own size."""
        return replace(self, step=1)

    def of(self, frame: Glance) -> np.ndarray:
        """What a frame shows in the window, each pixel the mean of those that it stands for."""
        return np.ascontiguousarray(
            frame.at(self.step)[
                self.y0 // self.step : self.y1 // self.step, self.x0 // self.step : self.x1 // self.step
            ]
        )

    def resized(self, part: np.ndarray) -> np.ndarray:
        """What was cut, in the window's size."""
        return shrunk(np.ascontiguousarray(part), self.step)

    def sampled(self, labels: np.ndarray) -> np.ndarray:
        """The window of a picture of numbers, of which no means can be taken: those of the pixels in the middle. No copy."""
        middle = self.step // 2
        return self.cut(labels)[middle :: self.step, middle :: self.step]

    def enlarged(self, mask: np.ndarray) -> np.ndarray:
        """A mask (uint8, 0 or 255) of the window in the full size of what was cut."""
        if self.step == 1:
            return mask
        large = cv2.resize(mask, (self.x1 - self.x0, self.y1 - self.y0), interpolation=cv2.INTER_LINEAR)
        return cv2.threshold(large, 127, 255, cv2.THRESH_BINARY)[1]

    def placed(self, mask: np.ndarray) -> np.ndarray:
        """A mask (uint8, 0 or 255) of the window in a whole picture that is empty elsewhere."""
        width, height = self.size_px
        whole = np.zeros((height, width), np.uint8)
        self.cut(whole)[:] = self.enlarged(mask)
        return whole

    def in_small(self, mask: np.ndarray, small: np.ndarray) -> None:
        """Mark a mask of the window, (h, w) uint8, in one of the size of `Glance.quarter`."""
        small[self._small] |= shrunk(mask, self._unit // self.step)

    def from_small(self, small: np.ndarray) -> np.ndarray:
        """The window's part of a mask of the size of `Glance.quarter`."""
        return cv2.resize(small[self._small], self.shape[::-1], interpolation=cv2.INTER_NEAREST)

    def expected(self, expected: Expected, silhouette: Silhouette | None = None) -> Expected:
        """What must be seen in the window. silhouette : the complete print's in it, where it is there already"""
        return Expected(
            self.sampled(expected.birth) if silhouette is None else silhouette.birth,
            expected.laid, expected.doubt,
            None if expected.hidden is None else self.sampled(expected.hidden),
            None if expected.volume is None else self.sampled(expected.volume), silhouette,
        )  # fmt: skip

    def print_map(self, whole: PrintMap) -> PrintMap:
        return PrintMap(
            self.sampled(whole.layer), self.sampled(whole.owner), self.sampled(whole.nearest), whole.objects
        )


def _sides(low: int, high: int, end: int, unit: int) -> tuple[int, int]:
    """The next multiples of the unit outwards, within 0..end."""
    return max(low, 0) // unit * unit, min(-(-high // unit), end // unit) * unit
