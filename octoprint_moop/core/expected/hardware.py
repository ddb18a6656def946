"""What of the machine stands before the print: the head around the nozzle, and the beam that carries it."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from ..camera import BedMotion, Camera
from ..head import HeadModel
from .lens import shown

EDGE_PARTS = 16  # an edge is projected in so many parts, since a lens bends it
MARGIN_PX = 1


def corners_room_mm(head: HeadModel, position_mm: Sequence[float], bed: BedMotion) -> list[np.ndarray]:
    """(2, 3) float64 for each box: its low and high corner in the room when the machine is at `position_mm`."""
    nozzle = np.asarray(position_mm, dtype=np.float64) + bed.room_from_print_mm(position_mm)
    corners = [np.array([box.low_mm, box.high_mm]) + nozzle for box in head.head]
    if head.gantry is not None:
        corners.append(np.array([head.gantry.low_mm, head.gantry.high_mm]) + nozzle * [0, 1, 1])
    return corners


def hidden_by(head: HeadModel, position_mm: Sequence[float], bed: BedMotion, camera: Camera) -> np.ndarray:
    """(H, W) uint8, 255 where head or gantry may hide the print, in the camera's own pixels."""
    width, height = camera.image_size_px
    mask = np.zeros((height, width), np.uint8)
    for corners in corners_room_mm(head, position_mm, bed):
        outline = _silhouette(corners, camera)
        if outline is not None:
            cv2.fillConvexPoly(mask, outline, 255)
    return cv2.dilate(mask, np.ones((2 * MARGIN_PX + 1,) * 2, np.uint8))


def _silhouette(corners_mm: np.ndarray, camera: Camera) -> np.ndarray | None:
    """(N, 1, 2) int32: the outline of a box in pixels; None where the lens cannot show any of it.

    corners_mm : (2, 3), low and high. A box that reaches behind the camera is cut off before it.
    """
    step = np.linspace(0, 1, EDGE_PARTS + 1)
    points = []
    for axis in range(3):
        for other in range(4):
            ends = np.array([[other & 1, other >> 1]] * 2, dtype=np.float64)
            ends = np.insert(ends, axis, [0.0, 1.0], axis=1)
            ends = corners_mm[0] + ends * (corners_mm[1] - corners_mm[0])
            points.append(ends[0] + step[:, None] * (ends[1] - ends[0]))
    seen = np.concatenate(points)
    seen_px = camera.project(seen[shown(seen, camera)])
    if len(seen_px) < 3:
        return None
    reach = 8 * max(camera.image_size_px)
    return cv2.convexHull(np.clip(seen_px, -reach, reach).round().astype(np.int32))
