"""Which way the bed moves, measured: two pictures at two machine positions, and what the bed did between them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from ..camera import BedMotion, Camera
from ..errors import CalibrationError
from ..header import Printer
from .plate import bed_middle_mm

_BLOCK_PX = 24
_LEAST_BLOCKS = 6
_LIKENESS = 0.5  # correlation from which a block says anything
_LEAST_SHIFT_PX = 3.0


@dataclass(frozen=True)
class MeasuredMotion:
    """motion : of the bed, its reference the first picture's position. votes : parts of the bed that say so, by motion.

    A vote is a block of the picture that looks most like the first picture moved in that way.
    """

    motion: BedMotion
    votes: dict[str, int]

    def to_json(self) -> dict[str, Any]:
        x, y, z = self.motion.reference_mm
        return {"bed_motion": self.motion.kind, "bed_reference_mm": {"x": x, "y": y, "z": z}, "votes": self.votes}


def measure_bed_motion(
    first: np.ndarray,
    second: np.ndarray,
    camera: Camera,
    printer: Printer,
    first_mm: Sequence[float],
    second_mm: Sequence[float],
) -> MeasuredMotion:
    """How the bed of this printer moves in the camera's view.

    first, second : (H, W, 3) uint8 at the machine positions first_mm, second_mm (X, Y, Z); `camera` holds at the first
    Raises CalibrationError where the positions do not differ enough to tell, where the bed has too little to see, and
    where it moved against what its axis says.
    """
    if first.shape != second.shape or first.shape[1::-1] != camera.image_size_px:
        raise CalibrationError("The two pictures and the camera must be of one size. Take the pictures again.")
    moved = np.subtract(second_mm, first_mm).astype(np.float64)
    reference = (float(first_mm[0]), float(first_mm[1]), float(first_mm[2]))
    shifts = {
        "fixed": np.zeros(3), "y": np.array([0, -moved[1], 0]), "z": np.array([0, 0, -moved[2]]),
        "y reversed": np.array([0, moved[1], 0]), "z reversed": np.array([0, 0, moved[2]]),
    }  # fmt: skip
    corners_mm = _bed_grid_mm(printer)
    for axis, kind in ((1, "y"), (2, "z")):
        seen_px = np.linalg.norm(camera.project(corners_mm + shifts[kind]) - camera.project(corners_mm), axis=1)
        if not np.nanmedian(seen_px) >= _LEAST_SHIFT_PX:
            raise CalibrationError(
                f"Between the pictures {'XYZ'[axis]} moved by {abs(moved[axis]):g} mm, too little to see. Move Y and Z "
                "by 20 mm or more each, and take the second picture again."
            )
    flat = [_flat_grey(picture, camera) for picture in (first, second)]
    votes = _vote(flat[0], flat[1], camera.undistorted(), printer, shifts)
    won = max(votes, key=lambda kind: votes[kind])
    total = sum(votes.values())
    if votes[won] < _LEAST_BLOCKS or votes[won] < 0.5 * total:
        raise CalibrationError(
            f"The bed's motion cannot be told: {votes[won]} of {total} parts of the bed agree. Put something with a "
            "pattern on the bed (the marker plate, a printed sheet), move the head aside, and take both pictures again."
        )
    if won.endswith("reversed"):
        raise CalibrationError(
            f"The bed moves along {won[0].upper()}, but against what the machine's position says. The picture is "
            "mirrored, or the pose was found with exchanged points: calibrate the pose again."
        )
    return MeasuredMotion(BedMotion(won, reference), votes)


def _bed_grid_mm(printer: Printer) -> np.ndarray:
    """(49, 3) float64: points spread over the bed."""
    low = bed_middle_mm(printer) - [printer.width_mm / 2, printer.depth_mm / 2]
    x, y = np.meshgrid(np.linspace(0, printer.width_mm, 7), np.linspace(0, printer.depth_mm, 7))
    return np.column_stack([low[0] + x.ravel(), low[1] + y.ravel(), np.zeros(49)])


def _flat_grey(picture: np.ndarray, camera: Camera) -> np.ndarray:
    """(H, W) float32: without distortion, and with the light's slow changes taken out."""
    grey = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY).astype(np.float32)
    if camera.model == "fisheye":
        flat = cv2.fisheye.undistortImage(grey, camera.K, camera.distortion, Knew=camera.K)
    else:
        flat = cv2.undistort(grey, camera.K, camera.distortion)
    return np.asarray(cv2.GaussianBlur(flat, (0, 0), 1.0) - cv2.GaussianBlur(flat, (0, 0), 6.0))


def _vote(
    first: np.ndarray, second: np.ndarray, camera: Camera, printer: Printer, shifts: dict[str, np.ndarray]
) -> dict[str, int]:
    """For each block of the bed in the second picture, which shift of the first picture it looks like."""
    room = camera.camera_from_room
    height, width = first.shape
    middle_mm = np.append(bed_middle_mm(printer), 0.0)
    half_mm = np.array([printer.width_mm, printer.depth_mm]) / 2

    def picture_from_bed(shift: np.ndarray) -> np.ndarray:
        return camera.K @ np.column_stack([room[:3, 0], room[:3, 1], room[:3, :3] @ shift + room[:3, 3]])

    likeness = {}
    for kind, shift in shifts.items():
        warp = picture_from_bed(shift) @ np.linalg.inv(picture_from_bed(np.zeros(3)))
        predicted = cv2.warpPerspective(first, warp, (width, height), flags=cv2.INTER_LINEAR)
        x, y = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))
        bed = np.linalg.inv(picture_from_bed(shift)) @ np.stack([x.ravel(), y.ravel(), np.ones(x.size)])
        on_bed = (np.abs(bed[:2] / bed[2] - middle_mm[:2, None]) < half_mm[:, None]).all(axis=0) & (bed[2] > 0)
        seen = cv2.warpPerspective(np.ones_like(first), warp, (width, height)) > 0.99
        valid = (on_bed.reshape(height, width) & seen).astype(np.float32)
        sums = [_blocks(part * valid) for part in (predicted * second, predicted**2, second**2)]
        correlation = sums[0] / np.sqrt(np.maximum(sums[1] * sums[2], 1e-6))
        textured = (sums[2] > 4.0 * _blocks(valid)) & (_blocks(valid) > 0.8 * _BLOCK_PX**2)
        likeness[kind] = np.where(textured, correlation, -1.0)
    table = np.stack(list(likeness.values()))
    best, second_best = np.sort(table, axis=0)[-1], np.sort(table, axis=0)[-2]
    clear = (best > _LIKENESS) & (best > second_best + 0.1)
    winners = table.argmax(axis=0)[clear]
    return {kind: int((winners == index).sum()) for index, kind in enumerate(likeness)}


def _blocks(values: np.ndarray) -> np.ndarray:
    rows, columns = values.shape[0] // _BLOCK_PX, values.shape[1] // _BLOCK_PX
    cut = values[: rows * _BLOCK_PX, : columns * _BLOCK_PX]
    return cut.reshape(rows, _BLOCK_PX, columns, _BLOCK_PX).sum(axis=(1, 3))
