"""What is behind the print: the picture of the empty bed, kept in step with a bed that moves."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from ..camera import Camera
from ..expected.views import Expected
from ..header import Printer
from .glance import Glance
from .light import Light
from .stabilise import Stabiliser
from .usable import Occluders

SAME_POSE_MM = 0.5
FAR = 100.0  # pictures
RIM_RATIO = 15 / 640  # of the picture's width


class Backdrop:
    """A reference picture of one camera's view, and what measures frames by it.

    unknown    : (h, w) uint8, of the size of `Glance.quarter`, 255 where the reference cannot say what is behind the print now
    stabiliser, light, occluders : see their modules
    """

    def __init__(
        self,
        camera: Camera,
        printer: Printer,
        reference_bgr: np.ndarray,
        position_mm: Sequence[float],
        expected: Expected,
    ) -> None:
        """position_mm : where the machine stood; expected : the print, which is no part of the backdrop"""
        self._camera, self._printer, self._reference_bgr = camera, printer, reference_bgr
        self._small_bgr = Glance(reference_bgr).quarter
        self._reference_shift_mm = printer.bed.room_from_print_mm(position_mm)
        left, front = printer.bed_low_mm
        bed_mm = ((left, front), (left + printer.width_mm, front + printer.depth_mm))
        self.stabiliser = Stabiliser(camera, printer.bed, bed_mm, reference_bgr, position_mm, expected.complete)
        self.occluders = Occluders(self._small_bgr)
        self._show(self._reference_shift_mm, expected)

    def follow(self, position_mm: Sequence[float], expected: Expected) -> None:
        """Have the reference show the bed where it stands when the machine is at `position_mm`."""
        shift_mm = self._printer.bed.room_from_print_mm(position_mm)
        if np.abs(shift_mm - self._shown_mm).max() >= SAME_POSE_MM:
            self._show(shift_mm, expected)

    def picture(self) -> np.ndarray:
        """(H, W, 3) uint8 BGR: the reference with the bed where it stands now."""
        return self._moved(self._reference_bgr, self._shown_mm)[0]

    def _show(self, shift_mm: np.ndarray, expected: Expected) -> None:
        small_bgr, known = self._moved(self._small_bgr, shift_mm)
        self.unknown = cv2.bitwise_not(known)
        height, width = known.shape
        print_px = cv2.resize(expected.complete, (width, height), interpolation=cv2.INTER_AREA)
        self.light = Light(small_bgr, cv2.bitwise_or(print_px, self.unknown))
        self.occluders.refer_to(small_bgr)
        self._shown_mm = shift_mm

    def _moved(self, reference_bgr: np.ndarray, shift_mm: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """A reference, large or small, with its bed moved, and (H, W) uint8, 255 where that is known.

        The bed is a plane, so a homography moves it exactly; what stands still behind it stays.
        """
        height, width = reference_bgr.shape[:2]
        everywhere = np.full((height, width), 255, np.uint8)
        if np.abs(shift_mm - self._reference_shift_mm).max() < SAME_POSE_MM:
            return reference_bgr, everywhere
        left, front = self._printer.bed_low_mm
        right, back = left + self._printer.width_mm, front + self._printer.depth_mm
        corners_mm = np.array([[left, front, 0], [right, front, 0], [right, back, 0], [left, back, 0]], float)
        size = np.array([width, height]) / self._camera.image_size_px
        before_px, now_px = (
            (self._camera.project(corners_mm + shift) + 0.5) * size - 0.5
            for shift in (self._reference_shift_mm, shift_mm)
        )
        if not (np.isfinite(before_px).all() and np.isfinite(now_px).all()):
            return reference_bgr, np.zeros_like(everywhere)
        motion = cv2.getPerspectiveTransform(before_px.astype(np.float32), now_px.astype(np.float32))
        moved = cv2.warpPerspective(reference_bgr, motion, (width, height), borderMode=cv2.BORDER_REPLICATE)
        seen = cv2.warpPerspective(everywhere, motion, (width, height))
        bed_before, bed_now = np.zeros_like(everywhere), np.zeros_like(everywhere)
        for bed, corners_px in ((bed_before, before_px), (bed_now, now_px)):
            far_px = FAR * max(
                width, height
            )  # a corner beside the camera is seen further off than pixels can be counted
            cv2.fillConvexPoly(bed, corners_px.clip(-far_px, far_px).round().astype(np.int32), 255)
        picture = cv2.copyTo(moved, bed_now, reference_bgr.copy())
        # what the bed stood before is seen now for the first time, and its rim is a thing of its own
        known = np.where(bed_now > 0, seen, cv2.bitwise_not(bed_before))
        beds = cv2.bitwise_or(bed_now, bed_before)
        side = 2 * round(RIM_RATIO * width / 2) + 1
        rim = cv2.morphologyEx(beds, cv2.MORPH_GRADIENT, np.ones((side, side), np.uint8))
        return picture, cv2.bitwise_and(known, cv2.bitwise_not(rim))
