"""What is behind the print: the picture of the empty bed, kept in step with a bed that moves."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from ..camera import Camera
from ..header import Printer
from .light import Light
from .stabilise import Stabiliser
from .usable import Occluders

SAME_POSE_MM = 0.5
RIM_PX = 15


class Backdrop:
    """A reference picture of one camera's view, and what measures frames by it.

    picture    : (H, W, 3) uint8 BGR, the reference with the bed where it stands now
    unknown    : (H, W) uint8, 255 where the reference cannot say what is behind the print now
    stabiliser, light, occluders : see their modules
    """

    def __init__(
        self,
        camera: Camera,
        printer: Printer,
        reference_bgr: np.ndarray,
        position_mm: Sequence[float],
        exclude: np.ndarray,
    ) -> None:
        """position_mm : where the machine stood; exclude : (H, W) uint8, 255 where the print is or will be."""
        self._camera, self._printer, self._reference_bgr = camera, printer, reference_bgr
        self._reference_shift_mm = printer.bed.room_from_print_mm(position_mm)
        bed_mm = (printer.width_mm, printer.depth_mm)
        self.stabiliser = Stabiliser(camera, printer.bed, bed_mm, reference_bgr, position_mm, exclude)
        self.occluders = Occluders(reference_bgr)
        self._show(self._reference_shift_mm, exclude)

    def follow(self, position_mm: Sequence[float], exclude: np.ndarray) -> None:
        """Have the reference show the bed where it stands when the machine is at `position_mm`."""
        shift_mm = self._printer.bed.room_from_print_mm(position_mm)
        if np.abs(shift_mm - self._shown_mm).max() >= SAME_POSE_MM:
            self._show(shift_mm, exclude)

    def _show(self, shift_mm: np.ndarray, exclude: np.ndarray) -> None:
        self.picture, known = self._moved(shift_mm)
        self.unknown = cv2.bitwise_not(known)
        self.light = Light(self.picture, exclude | self.unknown)
        self.occluders.refer_to(self.picture)
        self._shown_mm = shift_mm

    def _moved(self, shift_mm: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The reference with its bed moved, and (H, W) uint8, 255 where that is known.

        The bed is a plane, so a homography moves it exactly; what stands still behind it stays.
        """
        reference = self._reference_bgr
        everywhere = np.full(reference.shape[:2], 255, np.uint8)
        if np.abs(shift_mm - self._reference_shift_mm).max() < SAME_POSE_MM:
            return reference, everywhere
        width, depth = self._printer.width_mm, self._printer.depth_mm
        corners_mm = np.array([[0, 0, 0], [width, 0, 0], [width, depth, 0], [0, depth, 0]], float)
        before_px = self._camera.project(corners_mm + self._reference_shift_mm)
        now_px = self._camera.project(corners_mm + shift_mm)
        if not (np.isfinite(before_px).all() and np.isfinite(now_px).all()):
            return reference, np.zeros_like(everywhere)
        motion = cv2.getPerspectiveTransform(before_px.astype(np.float32), now_px.astype(np.float32))
        size_px = self._camera.image_size_px
        moved = cv2.warpPerspective(reference, motion, size_px, borderMode=cv2.BORDER_REPLICATE)
        seen = cv2.warpPerspective(everywhere, motion, size_px)
        bed_before, bed_now = np.zeros_like(everywhere), np.zeros_like(everywhere)
        cv2.fillConvexPoly(bed_before, before_px.round().astype(np.int32), 255)
        cv2.fillConvexPoly(bed_now, now_px.round().astype(np.int32), 255)
        picture = np.where(bed_now[..., None] > 0, moved, reference)
        # what the bed stood before is seen now for the first time, and its rim is a thing of its own
        known = np.where(bed_now > 0, seen, cv2.bitwise_not(bed_before))
        beds = cv2.bitwise_or(bed_now, bed_before)
        rim = cv2.morphologyEx(beds, cv2.MORPH_GRADIENT, np.ones((RIM_PX, RIM_PX), np.uint8))
        return picture, cv2.bitwise_and(known, cv2.bitwise_not(rim))
