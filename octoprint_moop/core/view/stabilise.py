"""Does the camera stand where it stood? How far it turned, and the frame as the calibrated camera would have seen it.

A camera that is knocked turns much more than it travels, so its motion is modelled as a rotation about its centre:
then every pixel's new place follows from three numbers, whatever the depth of what it shows (Hartley and Zisserman,
Multiple View Geometry, section 8.4). The three are found by direct alignment of what does not belong to the print
(Lucas and Kanade 1981 in the form of Baker and Matthews 2004), coarse to fine, with weights that make outliers of a
gantry, a hand and whatever else moves by itself. Pixels on the bed are looked for where the machine has put the bed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from ..camera import BedMotion, Camera

SCALES = (8, 4, 2)  # of the image pyramid at 640 pixels across, coarse to fine
SEARCH_PX, SEARCH_STEP_PX = 48, 16  # at 640 pixels across: where a first guess is looked for
POINTS_PER_CELL = 12
CELLS = (16, 12)
ITERATIONS = 12
GLANCE_EVERY = 3  # of the pixels, to tell that nothing has moved
NOTICEABLE_PX = 0.4
WARP_GRID = 16  # the warp is smooth: it is computed on a coarse grid and interpolated


@dataclass(frozen=True, eq=False)
class CameraTurn:
    """How the camera has turned since the reference picture.

    rvec      : (3,) float64, radians: rotates directions of the calibrated camera into the turned one
    motion_px : by how much a pixel has moved, root mean square over the picture; 0 where it stands still
    """

    rvec: np.ndarray
    motion_px: float


STILL = CameraTurn(np.zeros(3), 0.0)


@dataclass(frozen=True, eq=False)
class _Level:
    """The reference at one scale: n pixels with structure, and what is known of each."""

    scale: int
    rays: np.ndarray  # (n, 3) unit directions, calibrated camera
    on_bed_mm: np.ndarray  # (n, 3) print coordinates, NaN for what is not on the bed
    grey: np.ndarray  # (n,) float32
    slope: np.ndarray  # (n,) float32, length of the grey value's gradient, per pixel of full size
    normal: np.ndarray  # (n, 2) float32, its direction

    def thinned(self, few: slice) -> _Level:
        return _Level(
            self.scale, self.rays[few], self.on_bed_mm[few], self.grey[few], self.slope[few], self.normal[few]
        )


class Stabiliser:
    """Compares frames with a reference picture of the same camera. Frames and reference: (H, W, 3) uint8 BGR."""

    def __init__(
        self,
        camera: Camera,
        bed: BedMotion,
        bed_size_mm: Sequence[float],
        reference_bgr: np.ndarray,
        reference_position_mm: Sequence[float],
        exclude: np.ndarray,
    ) -> None:
        """`exclude`: (H, W) uint8, 255 where the print is or will be. `bed_size_mm`: width and depth, from 0, 0."""
        self._camera, self._bed = camera, bed
        finer = max(1, round(camera.image_size_px[0] / 640))
        self._finer = finer
        self._scales = tuple(scale * finer for scale in SCALES)
        background = cv2.bitwise_not(cv2.dilate(exclude, np.ones((15, 15), np.uint8)))
        shift_mm = bed.room_from_print_mm(reference_position_mm)
        pyramid = _pyramid(reference_bgr, self._scales)
        self._looked_for: tuple[np.ndarray, list[np.ndarray], list[np.ndarray]] | None = None
        self._levels = [
            self._level(scale, grey, background, shift_mm, bed_size_mm) for scale, grey in zip(self._scales, pyramid)
        ]

    def _level(
        self, scale: int, grey: np.ndarray, background: np.ndarray, shift_mm: np.ndarray, bed_size_mm: Sequence[float]
    ) -> _Level:
        right, down = (cv2.Sobel(grey, cv2.CV_32F, *axis, scale=1 / 8) for axis in ((1, 0), (0, 1)))
        gradient = np.stack([right, down], -1)
        strength = (gradient**2).sum(-1)
        strength[cv2.resize(background, grey.shape[::-1], interpolation=cv2.INTER_NEAREST) == 0] = 0
        strength[:2], strength[-2:], strength[:, :2], strength[:, -2:] = 0, 0, 0, 0
        rows, columns = _strongest_in_each_cell(strength)
        pixels = (np.column_stack([columns, rows]) + 0.5) * scale - 0.5
        rays = self._camera.rays(pixels)
        slope = np.sqrt(strength[rows, columns]) / scale
        return _Level(
            scale, rays, self._bed_points_mm(rays, shift_mm, bed_size_mm),
            grey[rows, columns], slope, gradient[rows, columns] / (slope * scale)[:, None],
        )  # fmt: skip

    def _bed_points_mm(self, rays: np.ndarray, shift_mm: np.ndarray, size_mm: Sequence[float]) -> np.ndarray:
        """(n, 3): where each ray meets the bed's surface, in print coordinates; NaN where it does not."""
        rays_room = rays @ cv2.Rodrigues(self._camera.rvec)[0]
        centre = self._camera.centre_mm
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = (shift_mm[2] - centre[2]) / rays_room[:, 2]
            points = centre + rays_room * depth[:, None] - shift_mm
            on_bed = (depth > 0) & ((points[:, :2] >= 0) & (points[:, :2] <= np.asarray(size_mm[:2]))).all(axis=1)
        points[~on_bed] = np.nan
        return points

    def turn(self, frame_bgr: np.ndarray, position_mm: Sequence[float]) -> CameraTurn:
        """How the camera has turned since the reference was taken; `position_mm` is where the machine stands.

        STILL where the picture has too little structure to tell, or where turning explains nothing.
        """
        shift_mm = self._bed.room_from_print_mm(position_mm)
        pyramid = _pyramid(frame_bgr, self._scales)
        finest = self._levels[-1]
        if len(finest.grey) < 100:
            return STILL
        if self._looked_for is None or not np.array_equal(shift_mm, self._looked_for[0]):
            rays = [self._rays_now(level, shift_mm) for level in self._levels]
            self._looked_for = shift_mm, rays, [self._jacobian(*pair) for pair in zip(self._levels, rays)]
        _, rays, jacobians = self._looked_for
        rvec = self._first_guess(rays[0], pyramid[0])
        if not rvec.any():
            some = slice(None, None, GLANCE_EVERY)
            nudge = self._align(
                finest.thinned(some), rays[-1][some], jacobians[-1][some], pyramid[-1], rvec, iterations=2
            )
            if self._motion_px(nudge) < NOTICEABLE_PX:
                return STILL  # the usual case, and the cheap one
        for level, level_rays, jacobian, grey in zip(self._levels, rays, jacobians, pyramid):
            rvec = self._align(level, level_rays, jacobian, grey, rvec, ITERATIONS)
        if self._misfit(finest, rays[-1], pyramid[-1], rvec) > 0.9 * self._misfit(
            finest, rays[-1], pyramid[-1], np.zeros(3)
        ):
            return STILL
        motion_px = self._motion_px(rvec)
        return CameraTurn(rvec, motion_px) if motion_px >= NOTICEABLE_PX else STILL

    def _first_guess(self, rays: np.ndarray, grey: np.ndarray) -> np.ndarray:
        """(3,) the turn, on a coarse grid, under which the picture matches best; zeros where it matches as it is."""
        few = slice(None, None, max(1, len(rays) // 250))
        level = self._levels[0].thinned(few)

        def misfit(right_px: float, down_px: float) -> float:
            return self._misfit(level, rays[few], grey, self._turned_by(right_px, down_px))

        far_px = 1.5 * SEARCH_STEP_PX
        elsewhere = [misfit(*offset) for offset in ((far_px, 0), (-far_px, 0), (0, far_px), (0, -far_px))]
        if misfit(0, 0) < 0.8 * min(elsewhere):
            return np.zeros(3)
        steps = range(-SEARCH_PX, SEARCH_PX + 1, SEARCH_STEP_PX)
        best = min(((right, down) for right in steps for down in steps), key=lambda offset: misfit(*offset))
        return self._turned_by(*best)

    def _turned_by(self, right_px: float, down_px: float) -> np.ndarray:
        """(3,) the rotation vector that moves the picture's middle by so much, pixels at 640 across."""
        return np.array(
            [-down_px * self._finer / self._camera.K[1, 1], right_px * self._finer / self._camera.K[0, 0], 0.0]
        )

    def undo(self, frame_bgr: np.ndarray, turn: CameraTurn) -> tuple[np.ndarray, np.ndarray]:
        """The frame as the calibrated camera would have seen it, and (H, W) uint8, 255 where it saw nothing."""
        width, height = self._camera.image_size_px
        coarse = self._displacement(turn.rvec).astype(np.float32)
        fine = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_LINEAR)
        map_x = fine[..., 0] + np.arange(width, dtype=np.float32)
        map_y = fine[..., 1] + np.arange(height, dtype=np.float32)[:, None]
        steady = cv2.remap(frame_bgr, map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        outside = (map_x < 0) | (map_y < 0) | (map_x > width - 1) | (map_y > height - 1)
        return steady, np.where(outside, np.uint8(255), np.uint8(0))

    def _rays_now(self, level: _Level, shift_mm: np.ndarray) -> np.ndarray:
        """(n, 3): where the level's pixels would be looked for if the camera had not turned."""
        rays = level.rays.copy()
        on_bed = np.isfinite(level.on_bed_mm[:, 0])
        in_camera = (level.on_bed_mm[on_bed] + shift_mm - self._camera.centre_mm) @ cv2.Rodrigues(self._camera.rvec)[
            0
        ].T
        rays[on_bed] = in_camera / np.linalg.norm(in_camera, axis=1, keepdims=True)
        return rays

    def _residual(
        self, level: _Level, rays: np.ndarray, grey: np.ndarray, rvec: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """(n,) difference of grey value and (n,) whether the pixel is in the picture."""
        pixels = (self._camera.turned(rvec).project(rays) + 0.5) / level.scale - 0.5
        height, width = grey.shape
        pixels = np.nan_to_num(pixels, nan=-9.0).astype(np.float32)
        inside = (pixels > 0).all(axis=1) & (pixels[:, 0] < width - 1) & (pixels[:, 1] < height - 1)
        seen = cv2.remap(grey, pixels[:, :1], pixels[:, 1:], cv2.INTER_LINEAR).ravel()
        return seen - level.grey, inside

    def _align(
        self, level: _Level, rays: np.ndarray, jacobian: np.ndarray, grey: np.ndarray, rvec: np.ndarray, iterations: int
    ) -> np.ndarray:
        """Gauss-Newton from `rvec` on the distance that each pixel's edge has moved along its normal.

        In distances, not in grey values: a bright rod that moves by itself must not outweigh a dim bed that stands.
        """
        if len(rays) < 30:
            return rvec
        for _ in range(iterations):
            residual, inside = self._residual(level, rays, grey, rvec)
            residual /= level.slope
            weight = np.where(inside, _tukey(residual), 0.0)
            weighted = jacobian * weight[:, None]
            hessian = jacobian.T @ weighted
            if np.linalg.cond(hessian) > 1e8:
                return rvec
            step = -np.linalg.solve(hessian, weighted.T @ residual)
            rvec = rvec + step
            if np.linalg.norm(step) * self._camera.K[0, 0] < 0.02:
                break
        return rvec

    def _jacobian(self, level: _Level, rays: np.ndarray) -> np.ndarray:
        """(n, 3) by how many pixels along its normal each edge moves for a radian of turn, by central differences.

        Taken where the camera stands still: over the few degrees of a knock it hardly changes.
        """
        step = 1e-4
        columns = [
            self._camera.turned(step * axis).project(rays) - self._camera.turned(-step * axis).project(rays)
            for axis in np.eye(3)
        ]
        return np.einsum("ni,nij->nj", level.normal, np.nan_to_num(np.stack(columns, axis=-1) / (2 * step)))

    def _misfit(self, level: _Level, rays: np.ndarray, grey: np.ndarray, rvec: np.ndarray) -> float:
        residual, inside = self._residual(level, rays, grey, rvec)
        return float(np.median(np.abs(residual[inside]))) if inside.any() else np.inf

    def _displacement(self, rvec: np.ndarray) -> np.ndarray:
        """(WARP_GRID, WARP_GRID, 2) float64 pixels: by how much a grid over the calibrated view has moved."""
        width, height = self._camera.image_size_px
        # cv2.resize interpolates between the cells' centres: the grid is laid where it expects them
        x = (np.arange(WARP_GRID) + 0.5) * width / WARP_GRID - 0.5
        y = (np.arange(WARP_GRID) + 0.5) * height / WARP_GRID - 0.5
        pixels = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        moved = self._camera.turned(rvec).project(self._camera.rays(pixels)) - pixels
        return np.nan_to_num(moved).reshape(WARP_GRID, WARP_GRID, 2)

    def apart_px(self, one: CameraTurn, other: CameraTurn) -> float:
        """By how much a pixel moves between two turns, root mean square over the picture."""
        difference = self._displacement(one.rvec) - self._displacement(other.rvec)
        return float(np.sqrt(np.mean(np.sum(difference**2, axis=-1))))

    def _motion_px(self, rvec: np.ndarray) -> float:
        return float(np.sqrt(np.mean(np.sum(self._displacement(rvec) ** 2, axis=-1))))


def _pyramid(frame_bgr: np.ndarray, scales: Sequence[int]) -> list[np.ndarray]:
    """Float32 pictures at `scales`: fine structure alone, at a set contrast, so that a dimmed lamp is not motion."""
    grey = cv2.cvtColor(frame_bgr, cv2.COLOR_BGR2GRAY)
    levels = []
    for scale in reversed(scales):
        width, height = frame_bgr.shape[1] // scale, frame_bgr.shape[0] // scale
        grey = cv2.resize(grey, (width, height), interpolation=cv2.INTER_AREA)
        small = cv2.GaussianBlur(grey, (0, 0), 1.0).astype(np.float32)
        small -= cv2.boxFilter(small, -1, (31, 31))
        spread = float(cv2.meanStdDev(small)[1][0, 0]) or 1.0
        levels.append(np.clip(small / spread, -3, 3))
    return levels[::-1]


def _strongest_in_each_cell(strength: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
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


def _tukey(residual: np.ndarray) -> np.ndarray:
    """Tukey's biweight, scaled by the median absolute deviation (Huber 1981)."""
    scale = 1.4826 * float(np.median(np.abs(residual))) + 1e-6
    ratio = np.clip(residual / (4.685 * scale), -1, 1)
    return (1 - ratio**2) ** 2
