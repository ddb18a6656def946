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
FAR = 2.0  # pictures: what was seen further off is not seen now, and a lens bends it beyond measure
GRID = (64, 48)  # rays over the picture, at which the bed is looked for
FITTED = 60  # of the points where they meet it tell about so many how it has moved
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
        self._bed_mm = bed_mm = ((left, front), (left + printer.width_mm, front + printer.depth_mm))
        grid_px = np.stack(np.meshgrid(*(np.arange(n) for n in GRID)), -1).reshape(-1, 2)
        pixels = (grid_px + 0.5) * np.array(camera.image_size_px) / GRID - 0.5
        self._bed_before: dict[tuple[int, int], np.ndarray] = {}  # by the picture's size
        self._rays_in_room = camera.rays(pixels) @ camera.camera_from_room[:3, :3]
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
        if (width, height) not in self._bed_before:
            self._bed_before[width, height] = self._bed_seen(self._reference_shift_mm, (width, height))[0]
        bed_before, (bed_now, points_mm) = self._bed_before[width, height], self._bed_seen(shift_mm, (width, height))
        motion = self._motion(points_mm, shift_mm, (width, height))
        if motion is None:
            return reference_bgr, cv2.bitwise_not(cv2.bitwise_or(bed_now, bed_before))
        moved = cv2.warpPerspective(reference_bgr, motion, (width, height), borderMode=cv2.BORDER_REPLICATE)
        seen = cv2.warpPerspective(everywhere, motion, (width, height))
        picture = cv2.copyTo(moved, bed_now, reference_bgr.copy())
        # what the bed stood before is seen now for the first time, and its rim is a thing of its own
        known = np.where(bed_now > 0, seen, cv2.bitwise_not(bed_before))
        beds = cv2.bitwise_or(bed_now, bed_before)
        side = 2 * round(RIM_RATIO * width / 2) + 1
        rim = cv2.morphologyEx(beds, cv2.MORPH_GRADIENT, np.ones((side, side), np.uint8))
        return picture, cv2.bitwise_and(known, cv2.bitwise_not(rim))

    def _bed_seen(self, shift_mm: np.ndarray, size_px: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
        """Where the bed's surface is in the picture, (H, W) uint8, 0 or 255, and (n, 3) points of it that are seen.

        Asked of the picture's pixels, since a bed's corners may lie beside a camera that stands near, or behind it.
        """
        centre_mm, (left_front_mm, right_back_mm) = self._camera.centre_mm, self._bed_mm
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = (shift_mm[2] - centre_mm[2]) / self._rays_in_room[:, 2]
            points_mm = centre_mm + self._rays_in_room * depth[:, None] - shift_mm
            on_bed = (depth > 0) & (points_mm[:, :2] >= left_front_mm).all(axis=1)
            on_bed &= (points_mm[:, :2] <= right_back_mm).all(axis=1)
        coarse = np.where(on_bed, np.uint8(255), np.uint8(0)).reshape(GRID[::-1])
        bed = cv2.resize(coarse, size_px, interpolation=cv2.INTER_LINEAR)
        return cv2.threshold(bed, 127, 255, cv2.THRESH_BINARY)[1], points_mm[on_bed]

    def _motion(self, points_mm: np.ndarray, shift_mm: np.ndarray, size_px: tuple[int, int]) -> np.ndarray | None:
        """(3, 3): where pixels of the reference's bed are now, fitted to where these points were seen and are; None where
        too few were."""
        few_mm = points_mm[:: max(len(points_mm) // FITTED, 1)]
        size = np.array(size_px) / self._camera.image_size_px
        before_px, now_px = (
            (self._camera.project(few_mm + shift) + 0.5) * size - 0.5 for shift in (self._reference_shift_mm, shift_mm)
        )
        both = np.isfinite(before_px).all(axis=1) & (np.abs(before_px) < FAR * max(size_px)).all(axis=1)
        return cv2.findHomography(before_px[both], now_px[both])[0] if np.count_nonzero(both) >= 4 else None
