"""Draws beads with OpenCV's projection and numpy alone: where OpenGL does not work, and as its judge in tests."""

from __future__ import annotations

import numpy as np

from .beads import drawn_beads, straight_mm
from .camera import Camera
from .lens import shown
from .toolpath import Toolpath

CHUNK = 1 << 14
LONGEST_MM = 12.0  # longer beads are drawn in parts, since the loop below runs over the rows of the tallest


class CvRenderer:
    """A MaskRenderer without OpenGL, of the same shapes; pixels whose centres lie on an edge may differ."""

    name = "OpenCV"

    def __enter__(self) -> CvRenderer:
        return self

    def __exit__(self, *exception: object) -> None:
        self.release()

    def release(self) -> None:
        """Nothing is held."""

    def birth_map(
        self,
        toolpath: Toolpath,
        camera: Camera,
        room_from_print_mm: np.ndarray,
        beads: np.ndarray | None = None,
    ) -> np.ndarray:
        """As MaskRenderer says."""
        shift_mm = np.asarray(room_from_print_mm, dtype=np.float64)
        width, height = camera.image_size_px
        births = np.full((height, width), np.iinfo(np.uint32).max, dtype=np.uint32)
        longest_mm = min(straight_mm(toolpath, camera, shift_mm), LONGEST_MM)
        for drawn in drawn_beads(toolpath.beads_mm, beads, longest_mm, CHUNK):
            start, end = drawn["start"] + shift_mm, drawn["end"] + shift_mm
            seen = shown(start, camera) & shown(end, camera)
            corners = outline(start[seen], end[seen], drawn["size"][seen].astype(np.float64), camera.centre_mm)
            corners_px = camera.project(corners.reshape(-1, 3)).reshape(-1, 6, 2)
            whole = np.isfinite(corners_px).all(axis=(1, 2))
            fill_convex(births, corners_px[whole], drawn["birth"][seen][whole])
        births[births == np.iinfo(np.uint32).max] = 0
        return births


def outline(start_mm: np.ndarray, end_mm: np.ndarray, size_mm: np.ndarray, eye_mm: np.ndarray) -> np.ndarray:
    """(N, 6, 3) float64: points around the outline of each bead as seen from `eye_mm`.

    A bead is a line (the nozzle's path, at its top) swept by the ellipsoid of its width and height, so its outline is
    that of an ellipse at either end. The six points are both tips, and both flanks at both ends: the ellipsoid's
    points with a normal at right angles to the view.
    """
    run = end_mm - start_mm
    view = eye_mm - (start_mm + end_mm) / 2
    view /= np.linalg.norm(view, axis=1, keepdims=True)
    along = run - view * np.einsum("ij,ij->i", run, view)[:, None]
    length = np.linalg.norm(along, axis=1, keepdims=True)
    end_on = length[:, 0] <= 1e-5
    if end_on.any():
        along[end_on] = np.cross(view[end_on], [0.6, 0.64, 0.48])
        length[end_on] = np.linalg.norm(along[end_on], axis=1, keepdims=True)
    along /= length
    half_axes = size_mm[:, [0, 0, 1]] / 2
    across = _touching(np.cross(view, along), half_axes)
    along = _touching(along, half_axes)
    middle_start, middle_end = start_mm.copy(), end_mm.copy()
    middle_start[:, 2] -= half_axes[:, 2]
    middle_end[:, 2] -= half_axes[:, 2]
    return np.stack(
        [
            middle_end + along, middle_end + across, middle_start + across,
            middle_start - along, middle_start - across, middle_end - across,
        ],
        axis=1,
    )  # fmt: skip


def _touching(normal: np.ndarray, half_axes: np.ndarray) -> np.ndarray:
    """(N, 3): where a plane of this normal touches the ellipsoid."""
    scaled = half_axes * normal
    return half_axes * scaled / np.linalg.norm(scaled, axis=1, keepdims=True)


def fill_convex(births: np.ndarray, corners_px: np.ndarray, birth: np.ndarray) -> None:
    """Lowers every pixel of `births` whose centre lies in a polygon to that polygon's birth, where it is less.

    births     : (H, W) uint32, changed
    corners_px : (N, M, 2) float64, convex, in either direction round
    birth      : (N,) uint32, ascending
    """
    height, width = births.shape
    x, y = corners_px[..., 0], corners_px[..., 1]
    edge_x, edge_y = np.roll(x, -1, axis=1) - x, np.roll(y, -1, axis=1) - y
    turn = np.sign((x * np.roll(y, -1, axis=1) - y * np.roll(x, -1, axis=1)).sum(axis=1))
    down = edge_y * turn[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = edge_x / edge_y
        foot = x - slope * y
    # y·slope + foot is where the edge crosses a row; edges that do not bound on that side are put out of the way
    left_slope, left_foot = np.where(down < 0, slope, 0.0), np.where(down < 0, foot, -np.inf)
    right_slope, right_foot = np.where(down > 0, slope, 0.0), np.where(down > 0, foot, np.inf)
    row = np.maximum(np.ceil(y.min(axis=1)), 0)
    last_row = np.minimum(np.floor(y.max(axis=1)), height - 1)
    flat = births.reshape(-1)
    alive = np.flatnonzero(row <= last_row)
    while alive.size:
        at = row[alive, None]
        left = np.ceil((left_slope[alive] * at + left_foot[alive]).max(axis=1)).clip(0, width)
        right = np.floor((right_slope[alive] * at + right_foot[alive]).min(axis=1)).clip(-1, width - 1)
        many = np.maximum(right - left + 1, 0).astype(np.int64)
        first = (row[alive] * width + left).astype(np.int64)
        begins = np.cumsum(many) - many
        pixel = np.repeat(first - begins, many) + np.arange(int(many.sum()))
        born = np.repeat(birth[alive], many)
        earlier = born < flat[pixel]
        # of several values for one pixel the last assigned stays, so the earliest is assigned last
        flat[pixel[earlier][::-1]] = born[earlier][::-1]
        row[alive] += 1
        alive = alive[row[alive] <= last_row[alive]]
