"""How much of the room that a print head may take up it leaves free: what has been seen of the print and of its bed there.

Nobody measures their print head, so its boxes are generous, and seen from low down they cover the print that lies in plain
sight beneath the nozzle. But a head looks alike from the same side wherever it stands: where matter or the bare bed was
seen beside the nozzle in good checks, there is no head. So matter that is missing later where matter was seen has not just
been hidden, and matter that comes to lie where the bed was seen is no nozzle that shines. A head that looks like the bed
hides the print all the same: where only the bed was seen, nothing counts as missing.
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
OFTEN = 4  # must have, where it hangs together with nothing that is free for certain
ALIKE_COSINE = float(np.cos(np.radians(5)))  # from further about, the head's outline is another
EDGE_PX = 3  # at 640 pixels across: outlines still differ by so much


@dataclass(frozen=True, eq=False)
class _Pose:
    """Where the nozzle is seen: its pixel in the window, how far off it is, and from where (a unit vector)."""

    at_px: np.ndarray
    depth_mm: float
    way: np.ndarray


def in_place(observed: np.ndarray, expected: np.ndarray, head: np.ndarray) -> np.ndarray:
    """Matter that is seen where it must be. All are (h, w) uint8, 0 or 255.

    Within the head's reach what looks like matter may be a nozzle that shines, or a head of the filament's colour: so it
    counts there only where most of what looks like it is in its place.
    """
    lies, reach = observed & expected, observed & head
    trusted = 2 * cv2.countNonZero(lies & reach) >= cv2.countNonZero(reach)
    return lies if trusted else lies & cv2.bitwise_not(reach)


class Clearance:
    """For one camera. Masks are (h, w) uint8, 0 or 255, in the pixels of a window."""

    def __init__(self, camera: Camera, bed: BedMotion) -> None:
        self._camera, self._bed = camera, bed
        self._kept: deque[tuple[Window, _Pose, np.ndarray]] = deque(maxlen=KEPT)

    def learn(self, window: Window, position_mm: Sequence[float], matter: np.ndarray, bed: np.ndarray) -> None:
        """In a good check, with the nozzle at `position_mm`, these were seen although the head might hide them."""
        pose = self._pose(window, position_mm)
        if pose is not None and (matter.any() or bed.any()):
            self._kept.append((window, pose, cv2.merge([matter, matter | bed])))

    def behind(
        self, window: Window, position_mm: Sequence[float], observed: np.ndarray, expected: np.ndarray, head: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Matter that is seen in its place although a head might stand before it, and where within the head's reach nothing
        can be told: neither of matter that may be missing, nor of matter that may be too much."""
        lies = in_place(observed, expected, head)
        matter, either = self.free(window, position_mm, head)
        return lies, head & cv2.bitwise_not(lies | matter | (either & cv2.bitwise_not(expected)))

    def free(self, window: Window, position_mm: Sequence[float], head: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where no head is in the view although it is within its reach `head`, for all that was seen so far: where matter
        was seen, and where matter or the bed was."""
        pose, votes = self._pose(window, position_mm), np.zeros((*window.shape, 2), np.uint8)
        if pose is not None:
            for its_window, before, seen in self._kept:
                if before.way @ pose.way >= ALIKE_COSINE:
                    larger = before.depth_mm / pose.depth_mm * its_window.step / window.step
                    motion = np.column_stack([np.eye(2) * larger, pose.at_px - larger * before.at_px])
                    votes += (cv2.warpAffine(seen, motion, window.shape[::-1]) // 128).astype(np.uint8)
        side = 2 * round(EDGE_PX * max(1.0, window.size_px[0] / 640) / window.step) + 1
        edge = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))
        agreed = votes >= AGREEING
        agreed[..., 1] |= head == 0  # so that nothing is taken off where the head's reach ends
        agreed = np.dstack([agreed, votes[..., :1] >= OFTEN])
        matter, either, often = np.moveaxis(cv2.erode(np.where(agreed, np.uint8(255), np.uint8(0)), edge), 2, 0)
        either = _without_islands(either, head)
        return matter & either | often, either

    def _pose(self, window: Window, position_mm: Sequence[float]) -> _Pose | None:
        """None where the nozzle is not before the camera."""
        nozzle_mm = np.asarray(position_mm, float) + self._bed.room_from_print_mm(position_mm)
        way = nozzle_mm - self._camera.centre_mm
        pixel = self._camera.project(nozzle_mm[None])[0]
        depth_mm = float((cv2.Rodrigues(self._camera.rvec)[0] @ way)[2])
        if depth_mm <= 0 or not np.isfinite(pixel).all():
            return None
        return _Pose((window.from_picture @ [*pixel, 1.0])[:2], depth_mm, way / np.linalg.norm(way))


def _without_islands(free: np.ndarray, head: np.ndarray) -> np.ndarray:
    """uint8: of what seems free within the head's reach, what hangs together with what lies beyond. An island is a part of
    the head that looks like the bed."""
    _, labels = cv2.connectedComponents(free | cv2.bitwise_not(head))
    beyond = np.zeros(int(labels.max()) + 1, np.uint8)
    beyond[labels[head == 0]] = 255
    beyond[0] = 0
    return cv2.bitwise_and(free, beyond[labels])
