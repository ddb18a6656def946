"""What does not belong to the print, and where in a frame it is looked for: the pixels with structure of a reference picture.

Pictures are looked at as reliefs, fine structure at a set contrast; pixels on the bed are looked for where the machine
has put the bed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from ..camera import Camera

POINTS_PER_CELL = 12
CELLS = (16, 12)
MOST_CONTRAST = 3.0  # a lamp's reflection must not outweigh the rest


@dataclass(frozen=True, eq=False)
class Level:
    """The reference at one scale: n pixels with structure, and what is known of each."""

    scale: int
    rays: np.ndarray  # (n, 3) unit directions, calibrated camera
    on_bed_mm: np.ndarray  # (n, 3) print coordinates, NaN for what is not on the bed
    grey: np.ndarray  # (n,) float32
    slope: np.ndarray  # (n,) float32, length of the grey value's gradient, per pixel of full size
    normal: np.ndarray  # (n, 2) float32, its direction


@dataclass(frozen=True, eq=False)
class Relief:
    """Fine structure alone, at a set contrast, so that a dimmed lamp is not motion.

    height   : (H, W) float32, grey values less their mean about each pixel
    contrast : what to divide them by
    """

    height: np.ndarray
    contrast: float

    @classmethod
    def of(cls, grey: np.ndarray) -> Relief:
        smooth = cv2.GaussianBlur(grey, (0, 0), 1.0)
        height = cv2.subtract(smooth, cv2.boxFilter(smooth, cv2.CV_32F, (31, 31)), dtype=cv2.CV_32F)
        return cls(height, float(cv2.meanStdDev(height)[1][0, 0]) or 1.0)

    def all(self) -> np.ndarray:
        return np.clip(self.height / self.contrast, -MOST_CONTRAST, MOST_CONTRAST)

    def at(self, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(..., n) float32 at (..., n, 2) float32 positions, and whether each is in the picture."""
        height, width = self.height.shape
        flat = pixels.reshape(-1, 2)
        inside = (flat > 0).all(axis=1) & (flat[:, 0] < width - 1) & (flat[:, 1] < height - 1)
        seen = cv2.remap(self.height, flat[:, :1], flat[:, 1:], cv2.INTER_LINEAR).ravel()
        seen *= np.float32(1 / self.contrast)
        np.clip(seen, -MOST_CONTRAST, MOST_CONTRAST, out=seen)
        return seen.reshape(pixels.shape[:-1]), inside.reshape(pixels.shape[:-1])


class Aim:
    """Where the reference's pixels are looked for while the bed stands in one place; worked out once it is asked for."""

    def __init__(self, camera: Camera, levels: Sequence[Level], shift_mm: np.ndarray) -> None:
        self.shift_mm = shift_mm
        self._camera, self._levels = camera, levels
        self._kept: dict[tuple, np.ndarray] = {}

    def rays(self, number: int) -> np.ndarray:
        """(n, 3): where the level's pixels would be looked for if the camera had not turned."""
        return self._once(("rays", number), lambda: self._rays(self._levels[number]))

    def jacobian(self, number: int) -> np.ndarray:
        """(n, 3) by how many pixels along its normal each edge moves for a radian of turn."""
        return self._once(("jacobian", number), lambda: self._jacobian(self._levels[number], self.rays(number)))

    def pixels(self, number: int, few: slice, rvecs: tuple[tuple[float, ...], ...]) -> np.ndarray:
        """(turns, n, 2) float32, in the level's picture: where its pixels are if the camera has turned by each rvec."""
        return self._once(("pixels", number, few.step, rvecs), lambda: self._pixels(number, few, rvecs))

    def _once(self, name: tuple, work: Callable[[], np.ndarray]) -> np.ndarray:
        if name not in self._kept:
            self._kept[name] = work()
        return self._kept[name]

    def _rays(self, level: Level) -> np.ndarray:
        rays = level.rays.copy()
        on_bed = np.isfinite(level.on_bed_mm[:, 0])
        from_camera = level.on_bed_mm[on_bed] + self.shift_mm - self._camera.centre_mm
        in_camera = from_camera @ cv2.Rodrigues(self._camera.rvec)[0].T
        rays[on_bed] = in_camera / np.linalg.norm(in_camera, axis=1, keepdims=True)
        return rays

    def _jacobian(self, level: Level, rays: np.ndarray) -> np.ndarray:
        """By central differences, where the camera stands still: over the few degrees of a knock it hardly changes."""
        step = 1e-4
        columns = [
            self._camera.turned(step * axis).project(rays) - self._camera.turned(-step * axis).project(rays)
            for axis in np.eye(3)
        ]
        return np.einsum("ni,nij->nj", level.normal, np.nan_to_num(np.stack(columns, axis=-1) / (2 * step)))

    def _pixels(self, number: int, few: slice, rvecs: tuple[tuple[float, ...], ...]) -> np.ndarray:
        rays = self.rays(number)[few]
        turned = np.concatenate([rays @ cv2.Rodrigues(np.array(rvec))[0].T for rvec in rvecs])
        return in_level(self._camera.turned(np.zeros(3)).project(turned), self._levels[number].scale).reshape(
            len(rvecs), len(rays), 2
        )


def in_level(pixels: np.ndarray, scale: int) -> np.ndarray:
    """(n, 2) float32: pixels of the frame in a picture at 1/scale of its size; far outside where the lens shows nothing."""
    return np.nan_to_num((pixels + 0.5) / scale - 0.5, nan=-9.0).astype(np.float32)


def strongest_in_each_cell(strength: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of the pixels with most structure, spread over the picture."""
    height, width = strength.shape
    row_cell = np.arange(height) * CELLS[1] // height
    column_cell = np.arange(width) * CELLS[0] // width
    floor = 0.1 * float(np.percentile(strength[strength > 0], 90)) if (strength > 0).any() else np.inf
    rows, columns = np.nonzero(strength > floor)
    cell = row_cell[rows] * CELLS[0] + column_cell[columns]
    order = np.lexsort((-strength[rows, columns], cell))
    first_of_cell = np.searchsorted(cell[order], cell[order], side="left")
    chosen = order[np.arange(len(order)) - first_of_cell < POINTS_PER_CELL]
    return rows[chosen], columns[chosen]
