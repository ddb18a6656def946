"""Draws beads with OpenCV's projection and numpy alone: where OpenGL does not work, and as its judge in tests."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..camera import Camera
from ..toolpath import Toolpath
from .beads import drawn_beads, straight_mm
from .lens import shown
from .solid import MICROMETRES, Solid

CHUNK = 1 << 14
UNTOUCHED = np.uint32(0xFFFFFFFF)
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
        births = _untouched(camera)
        longest_mm = min(straight_mm(toolpath.bounds_mm(), camera, shift_mm), LONGEST_MM)
        for drawn in drawn_beads(toolpath.beads_mm, beads, longest_mm, CHUNK):
            start, end = drawn["start"] + shift_mm, drawn["end"] + shift_mm
            seen = shown(start, camera) & shown(end, camera)
            corners = outline(start[seen], end[seen], drawn["size"][seen].astype(np.float64), camera.centre_mm)
            corners_px = camera.project(corners.reshape(-1, 3)).reshape(-1, 6, 2)
            whole = np.isfinite(corners_px).all(axis=(1, 2))
            birth = drawn["birth"][seen][whole]
            flat = births.reshape(-1)
            for bead, pixel in covered(corners_px[whole], births.shape):
                born = birth[bead]
                earlier = born < flat[pixel]
                # of several values for one pixel the last assigned stays, and beads come in file order
                flat[pixel[earlier][::-1]] = born[earlier][::-1]
            toolpath.let_go()
        births[births == UNTOUCHED] = 0
        return births

    def solid_map(self, solid: Solid, camera: Camera, room_from_print_mm: np.ndarray) -> np.ndarray:
        """As MaskRenderer says."""
        shift_mm = np.asarray(room_from_print_mm, dtype=np.float64)
        heights = _untouched(camera)
        flat = heights.reshape(-1)
        longest_mm = min(straight_mm(solid.bounds_mm(), camera, shift_mm), LONGEST_MM)
        triangles = solid.cut(longest_mm)
        for first in range(0, len(triangles), CHUNK):
            corners = triangles[first : first + CHUNK].astype(np.float64)
            room = corners.reshape(-1, 3) + shift_mm
            seen = shown(room, camera).reshape(-1, 3).all(axis=1)
            corners, room = corners[seen], room.reshape(-1, 3, 3)[seen]
            corners_px = camera.project(room.reshape(-1, 3)).reshape(-1, 3, 2)
            depth = room @ camera.camera_from_room[2, :3] + camera.tvec_mm[2]
            height, near = _across(corners_px, corners[:, :, 2] / depth), _across(corners_px, 1 / depth)
            for triangle, pixel in covered(corners_px, heights.shape):
                at = np.stack([pixel % heights.shape[1], pixel // heights.shape[1], np.ones_like(pixel)], axis=1)
                height_mm = (height[triangle] * at).sum(axis=1) / (near[triangle] * at).sum(axis=1)
                low_mm, high_mm = corners[triangle, :, 2].min(axis=1), corners[triangle, :, 2].max(axis=1)
                found = 1 + np.rint(np.clip(height_mm, low_mm, high_mm).clip(0) * MICROMETRES).astype(np.uint32)
                lower = np.flatnonzero(found < flat[pixel])
                lower = lower[np.argsort(found[lower])[::-1]]
                flat[pixel[lower]] = found[lower]
        heights[heights == UNTOUCHED] = 0
        return heights


def _untouched(camera: Camera) -> np.ndarray:
    width, height = camera.image_size_px
    return np.full((height, width), UNTOUCHED, dtype=np.uint32)


def _across(corners_px: np.ndarray, values: np.ndarray) -> np.ndarray:
    """(N, 3) float64: a, b, c of the plane a·x + b·y + c over the picture that has `values` (N, 3) at the corners."""
    ones = np.ones((*corners_px.shape[:2], 1))
    corners = np.concatenate([corners_px, ones], axis=2)
    flat = np.abs(np.linalg.det(corners)) < 1e-9  # seen edge on: it covers no pixel's centre
    corners[flat] = np.eye(3)
    return np.linalg.solve(corners, values[:, :, None])[:, :, 0]


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


def covered(corners_px: np.ndarray, shape: tuple[int, int]) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Which pixels' centres lie in which polygon, a row of each polygon at a time.

    corners_px : (N, M, 2) float64, convex, in either direction round
    shape      : (height, width) of the picture
    Yields (K,) indices of polygons, ascending, and (K,) flat indices of pixels.
    """
    height, width = shape
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
    alive = np.flatnonzero((row <= last_row) & (turn != 0))
    while alive.size:
        at = row[alive, None]
        left = np.ceil((left_slope[alive] * at + left_foot[alive]).max(axis=1)).clip(0, width)
        right = np.floor((right_slope[alive] * at + right_foot[alive]).min(axis=1)).clip(-1, width - 1)
        many = np.maximum(right - left + 1, 0).astype(np.int64)
        first = (row[alive] * width + left).astype(np.int64)
        begins = np.cumsum(many) - many
        yield np.repeat(alive, many), np.repeat(first - begins, many) + np.arange(int(many.sum()))
        row[alive] += 1
        alive = alive[row[alive] <= last_row[alive]]
