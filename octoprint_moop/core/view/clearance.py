"""How much of the room that a print head may take up it leaves free: what has been seen of the print there.

Nobody measures their print head, so its boxes are generous, and seen from low down they cover the print that lies in plain
sight beneath the nozzle. But a head looks alike from the same side wherever it stands: where matter was seen beside the
nozzle in good checks, there is no head there, and matter that is missing there later has not just been hidden.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from ..camera import BedMotion, Camera
from .window import Window

KEPT = 12  # good checks; more would cost time and tell little
AGREEING = 2  # of them must have shown matter at a place
ALIKE_COSINE = float(np.cos(np.radians(5)))  # from further about, the head's outline is another
EDGE_PX = 3  # at 640 pixels across: outlines still differ by so much


@dataclass(frozen=True, eq=False)
class _Pose:
    """Where the nozzle is seen: its pixel in the window, how far off it is, and from where (a unit vector)."""

    at_px: np.ndarray
    depth_mm: float
    way: np.ndarray


class Clearance:
    """For one camera. Masks are (h, w) uint8, 0 or 255, in the pixels of a window."""

    def __init__(self, camera: Camera, bed: BedMotion) -> None:
        self._camera, self._bed = camera, bed
        self._kept: deque[tuple[Window, _Pose, np.ndarray]] = deque(maxlen=KEPT)

    def learn(self, window: Window, position_mm: Sequence[float], matter: np.ndarray) -> None:
        """In a good check, with the nozzle at `position_mm`, matter was seen there although the head might hide it."""
        pose = self._pose(window, position_mm)
        if pose is not None and matter.any():
            self._kept.append((window, pose, matter.copy()))

    def free(self, window: Window, position_mm: Sequence[float]) -> np.ndarray:
        """Where no head is in the view, for all that was seen so far."""
        pose, votes = self._pose(window, position_mm), np.zeros(window.shape, np.uint8)
        if pose is None:
            return votes
        for its_window, before, matter in self._kept:
            if its_window == window and before.way @ pose.way >= ALIKE_COSINE:
                larger = before.depth_mm / pose.depth_mm
                motion = np.column_stack([np.eye(2) * larger, pose.at_px - larger * before.at_px])
                votes += (cv2.warpAffine(matter, motion, window.shape[::-1]) // 128).astype(np.uint8)
        free = np.where(votes >= AGREEING, np.uint8(255), np.uint8(0))
        edge = 2 * round(EDGE_PX * max(1.0, window.size_px[0] / 640) / window.step) + 1
        return cv2.erode(free, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (edge, edge)))

    def _pose(self, window: Window, position_mm: Sequence[float]) -> _Pose | None:
        """None where the nozzle is not before the camera."""
        nozzle_mm = np.asarray(position_mm, float) + self._bed.room_from_print_mm(position_mm)
        way = nozzle_mm - self._camera.centre_mm
        pixel = self._camera.project(nozzle_mm[None])[0]
        depth_mm = float((cv2.Rodrigues(self._camera.rvec)[0] @ way)[2])
        if depth_mm <= 0 or not np.isfinite(pixel).all():
            return None
        return _Pose((window.from_picture @ [*pixel, 1.0])[:2], depth_mm, way / np.linalg.norm(way))
