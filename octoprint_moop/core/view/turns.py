"""Turns of a camera about its centre: by how much they move what it sees, and pictures as if it had not turned."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from ..camera import Camera

WARP_GRID = 16  # the warp is smooth: it is computed on a coarse grid and interpolated

Part = tuple  # (slice, slice): rows and columns of the whole picture


@dataclass(frozen=True, eq=False)
class CameraTurn:
    """How the camera has turned since the reference picture.

    rvec      : (3,) float64, radians: rotates directions of the calibrated camera into the turned one
    motion_px : by how much a pixel has moved, root mean square over the picture; 0 where it stands still
    """

    rvec: np.ndarray
    motion_px: float


STILL = CameraTurn(np.zeros(3), 0.0)


class Turns:
    """What turns of one calibrated camera do to its pictures. Turns are rotation vectors, as CameraTurn has them."""

    def __init__(self, camera: Camera) -> None:
        self._camera = camera
        width, height = camera.image_size_px
        # where cv2.resize expects the pixels that it interpolates between
        x = (np.arange(WARP_GRID) + 0.5) * width / WARP_GRID - 0.5
        y = (np.arange(WARP_GRID) + 0.5) * height / WARP_GRID - 0.5
        self._grid_px = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        self._grid_rays = camera.rays(self._grid_px)
        self._undone: tuple[CameraTurn, dict] = STILL, {}

    def apart_px(self, one: np.ndarray, other: np.ndarray) -> float:
        """By how much a pixel moves between two turns, root mean square over the picture."""
        return 0.0 if one is other else _root_mean_square(self._displacement(one) - self._displacement(other))

    def motion_px(self, rvec: np.ndarray) -> float:
        """The same from the calibrated camera to a turned one."""
        return _root_mean_square(self._displacement(rvec))

    def undo(
        self, picture_bgr: np.ndarray, turn: CameraTurn, part: Part | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """A picture of the whole view, large or small, as the calibrated camera would have seen it, or only the rows and
        columns `part` of that; and uint8 of the same height and width, 255 where it saw nothing."""
        if self._undone[0] is not turn:
            self._undone = turn, {}
        height, width = picture_bgr.shape[:2]
        rows, columns = part or (slice(0, height), slice(0, width))
        wanted = (width, height, rows.start, rows.stop, columns.start, columns.stop)
        if wanted not in self._undone[1]:
            self._undone[1][wanted] = self._maps(turn, (width, height), rows, columns)
        map_x, map_y, outside = self._undone[1][wanted]
        return cv2.remap(picture_bgr, map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), outside

    def _maps(
        self, turn: CameraTurn, size_px: tuple[int, int], rows: slice, columns: slice
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Two maps for cv2.remap, and where they lead out of the picture."""
        width, height = size_px
        scale = np.divide(size_px, self._camera.image_size_px)
        coarse = (self._displacement(turn.rvec) * scale).astype(np.float32)
        fine = cv2.resize(coarse, size_px, interpolation=cv2.INTER_LINEAR)[rows, columns]
        x = fine[..., 0] + np.arange(width, dtype=np.float32)[columns]
        y = fine[..., 1] + np.arange(height, dtype=np.float32)[rows, None]
        outside = (x < 0) | (y < 0) | (x > width - 1) | (y > height - 1)
        return (*cv2.convertMaps(x, y, cv2.CV_16SC2), np.where(outside, np.uint8(255), np.uint8(0)))

    def _displacement(self, rvec: np.ndarray) -> np.ndarray:
        """(WARP_GRID, WARP_GRID, 2) float64 pixels: by how much a grid over the calibrated view has moved."""
        moved = self._camera.turned(rvec).project(self._grid_rays) - self._grid_px
        return np.nan_to_num(moved).reshape(WARP_GRID, WARP_GRID, 2)


def _root_mean_square(displacement: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.sum(displacement**2, axis=-1))))
