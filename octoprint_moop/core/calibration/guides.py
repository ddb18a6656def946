"""Lines by which a person sees that a calibration fits: the bed's grid, and a box of known height, as the camera sees them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..camera import Camera
from ..header import Printer

GRID_MM = 50.0
BOX_MM = (40.0, 40.0, 30.0)  # width, depth, height
_STEP_MM = 5.0  # a lens bends straight lines


@dataclass(frozen=True, eq=False)
class Guide:
    """what : "bed" (its edge), "grid" or "box". points_px : (N, 2) float64, one unbroken line in the picture."""

    what: str
    points_px: np.ndarray

    def to_json(self) -> dict[str, Any]:
        return {"what": self.what, "px": self.points_px.round(2).tolist()}


def guides(camera: Camera, printer: Printer) -> list[Guide]:
    """The lines as seen when the machine stands where the camera was calibrated; parts out of sight are left out."""
    lines = []
    for what, ends_mm in _lines_mm(printer):
        count = max(2, int(np.ceil(np.linalg.norm(ends_mm[1] - ends_mm[0]) / _STEP_MM)) + 1)
        points_mm = ends_mm[0] + np.linspace(0, 1, count)[:, None] * (ends_mm[1] - ends_mm[0])
        lines += [Guide(what, run) for run in _visible(camera, points_mm)]
    return lines


def _lines_mm(printer: Printer) -> Iterator[tuple[str, np.ndarray]]:
    """(what, (2, 3) ends) in print coordinates."""
    width, depth = printer.width_mm, printer.depth_mm
    left, front = (-width / 2, -depth / 2) if printer.origin == "center" else (0.0, 0.0)
    right, back = left + width, front + depth
    corners = [(left, front), (right, front), (right, back), (left, back)]
    for start, end in zip(corners, corners[1:] + corners[:1]):
        yield "bed", np.array([[*start, 0], [*end, 0]])
    for x in np.arange(np.ceil(left / GRID_MM), right / GRID_MM) * GRID_MM:
        yield "grid", np.array([[x, front, 0], [x, back, 0]])
    for y in np.arange(np.ceil(front / GRID_MM), back / GRID_MM) * GRID_MM:
        yield "grid", np.array([[left, y, 0], [right, y, 0]])
    middle = np.array([(left + right) / 2, (front + back) / 2])
    half, height = np.array(BOX_MM[:2]) / 2, BOX_MM[2]
    feet = [middle + half * sign for sign in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    for foot, next_foot in zip(feet, feet[1:] + feet[:1]):
        yield "box", np.array([[*foot, 0], [*next_foot, 0]])
        yield "box", np.array([[*foot, height], [*next_foot, height]])
        yield "box", np.array([[*foot, 0], [*foot, height]])


def _visible(camera: Camera, points_mm: np.ndarray) -> Iterator[np.ndarray]:
    """Runs of points that lie in front of the camera and in the picture or just outside."""
    points_px = camera.project(points_mm)
    margin = 0.25 * np.array(camera.image_size_px)
    with np.errstate(invalid="ignore"):
        near = np.all((points_px > -margin) & (points_px < camera.image_size_px + margin), axis=1)
    for run in np.split(np.arange(len(points_px)), np.flatnonzero(np.diff(near)) + 1):
        if near[run[0]] and len(run) > 1:
            yield points_px[run]
