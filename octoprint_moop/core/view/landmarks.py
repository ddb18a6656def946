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
REGIONS = (8, 6)  # of the picture, that are asked one by one whether the camera has moved
MOST_CONTRAST = 3.0  # of the picture's: a lamp's reflection must not outweigh the rest
SMOOTH_PX, BOX_PX = 1.0, 15
TELLING = 8.0  # times as unlike beside its place as in it
NEWEST = 0.2  # weight of the newest frame in what pixels have differed by
KEPT_TURNS = 16  # sets of pixels, of two turns or three: a camera that wobbles all print long must not fill the memory


@dataclass(frozen=True, eq=False)
class Level:
    """The reference at one scale: n pixels with structure, and what is known of each.

    apart, beside : (n,) float32, squared grey levels by which the pixel has differed from the reference while the camera
    stood, in its place and a little way off; learned as frames come
    """

    scale: int
    rays: np.ndarray  # (n, 3) unit directions, calibrated camera
    on_bed_mm: np.ndarray  # (n, 3) print coordinates, NaN for what is not on the bed
    height: np.ndarray  # (n,) float32, of the relief
    slope: np.ndarray  # (n,) float32, length of the height's gradient, per pixel of full size
    normal: np.ndarray  # (n, 2) float32, its direction
    region: np.ndarray  # (n,) int, which of REGIONS it lies in
    apart: np.ndarray
    beside: np.ndarray

    @property
    def telling(self) -> np.ndarray:
        """(n,) bool: pixels that would differ if the camera had moved, by much more than they do while it stands.

        The strongest pixel of a plain stretch of bed is noise, and one before which a gantry passes tells
        nothing of the camera.
        """
        return self.beside > TELLING * self.apart

    def learn(self, apart: np.ndarray, beside: np.ndarray, inside: np.ndarray) -> None:
        """What the pixels differ by in a frame of a camera that stands."""
        for kept, now in ((self.apart, apart), (self.beside, beside)):
            kept[inside] += np.float32(NEWEST) * (now - kept)[inside]


@dataclass(frozen=True, eq=False)
class Relief:
    """Fine structure alone: (H, W) float32, grey values less their mean about each pixel."""

    height: np.ndarray

    @classmethod
    def of(cls, grey: np.ndarray) -> Relief:
        smooth = cv2.GaussianBlur(grey, (0, 0), SMOOTH_PX)
        return cls(cv2.subtract(smooth, cv2.boxFilter(smooth, cv2.CV_32F, (BOX_PX, BOX_PX)), dtype=cv2.CV_32F))

    def at(self, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(..., n) float32 at (..., n, 2) float32 positions, and whether each is in the picture."""
        height, width = self.height.shape
        if pixels.size == 0:
            return np.zeros(pixels.shape[:-1], np.float32), np.zeros(pixels.shape[:-1], bool)
        x, y = (np.ascontiguousarray(pixels[..., axis].reshape(-1, pixels.shape[-2])) for axis in (0, 1))
        inside = (x > 0) & (y > 0) & (x < width - 1) & (y < height - 1)
        seen = cv2.remap(self.height, x, y, cv2.INTER_LINEAR)
        return seen.reshape(pixels.shape[:-1]), inside.reshape(pixels.shape[:-1])


def noise(grey: np.ndarray) -> float:
    """Grey levels of noise in a picture's relief, from what no smooth structure gives (Immerkaer 1996)."""
    kernel = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)
    rough = cv2.filter2D(grey.astype(np.float32), cv2.CV_32F, kernel)[1:-1, 1:-1]
    # the median holds where edges do not; white noise keeps 1 / (2 sqrt(pi) sigma) of itself in a Gaussian's mean
    return float(np.median(np.abs(rough))) / 0.6745 / 6 / (2 * np.sqrt(np.pi) * SMOOTH_PX)


class Aim:
    """Where the reference's pixels are looked for while the bed stands in one place; worked out once it is asked for."""

    def __init__(self, camera: Camera, levels: Sequence[Level], shift_mm: np.ndarray) -> None:
        self.shift_mm = shift_mm
        self._camera, self._levels = camera, levels
        self._kept: dict[tuple, np.ndarray] = {}
        self._kept_pixels: dict[tuple, np.ndarray] = {}

    def rays(self, number: int) -> np.ndarray:
        """(n, 3): where the level's pixels would be looked for if the camera had not turned."""
        return self._once(("rays", number), lambda: self._rays(self._levels[number]))

    def jacobian(self, number: int) -> np.ndarray:
        """(n, 3) by how many pixels along its normal each edge moves for a radian of turn."""
        return self._once(("jacobian", number), lambda: self._jacobian(self._levels[number], self.rays(number)))

    def pixels(self, number: int, few: slice, rvecs: tuple[tuple[float, ...], ...]) -> np.ndarray:
        """(turns, n, 2) float32, in the level's picture: where its pixels are if the camera has turned by each rvec."""
        name = number, few.step, rvecs
        if name not in self._kept_pixels:
            while len(self._kept_pixels) >= KEPT_TURNS:
                self._kept_pixels.pop(next(iter(self._kept_pixels)))
            self._kept_pixels[name] = self._pixels(number, few, rvecs)
        return self._kept_pixels[name]

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


def region_of(rows: np.ndarray, columns: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """(n,) int: in which of REGIONS pixels of a picture (height, width) lie."""
    height, width = shape
    return rows * REGIONS[1] // height * REGIONS[0] + columns * REGIONS[0] // width
