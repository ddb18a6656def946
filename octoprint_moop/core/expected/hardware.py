"""What of the machine stands before the print: the head around the nozzle, and the beam that carries it."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from ..camera import BedMotion, Camera
from ..errors import SettingsError
from .lens import shown

EDGE_PARTS = 16  # an edge is projected in so many parts, since a lens bends it
MARGIN_PX = 1


@dataclass(frozen=True)
class Box:
    """A box around the nozzle's tip, in millimetres from it: x right, y to the back, z up."""

    low_mm: tuple[float, float, float]
    high_mm: tuple[float, float, float]

    def __post_init__(self) -> None:
        try:
            low, high = (tuple(float(side) for side in corner) for corner in (self.low_mm, self.high_mm))
        except (TypeError, ValueError):
            raise SettingsError("A box of the print head needs two corners of three numbers each, in mm.") from None
        if len(low) != 3 or len(high) != 3 or not np.isfinite([low, high]).all():
            raise SettingsError("A box of the print head needs two corners of three numbers each, in mm.")
        if not all(a < b for a, b in zip(low, high)):
            raise SettingsError(f"A box of the print head goes from {low} to {high} mm; each must grow.")
        object.__setattr__(self, "low_mm", low)
        object.__setattr__(self, "high_mm", high)

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Box:
        """Raises SettingsError where a corner is missing or makes no sense."""
        try:
            return cls(data["low_mm"], data["high_mm"])
        except (KeyError, TypeError):
            raise SettingsError("A box of the print head needs low_mm and high_mm, three numbers each.") from None

    def to_json(self) -> dict[str, Any]:
        return {"low_mm": list(self.low_mm), "high_mm": list(self.high_mm)}


@dataclass(frozen=True)
class HeadModel:
    """Boxes that move with the nozzle, and a beam along X that follows it in Y and Z only.

    head       : boxes around the nozzle
    gantry     : the beam's box; its x is where it begins and ends on the machine, not about the nozzle. None for none
    """

    head: tuple[Box, ...]
    gantry: Box | None = None

    @classmethod
    def common(cls, width_mm: float) -> HeadModel:
        """A generous guess for a printer whose bed is `width_mm` wide: heater block, carriage with fans, two rods."""
        return cls(
            head=(Box((-14, -18, 0), (14, 18, 14)), Box((-35, -45, 8), (35, 40, 85))),
            gantry=Box((-70, -15, 25), (width_mm + 70, 45, 85)),
        )

    @classmethod
    def from_text(cls, text: str, width_mm: float) -> HeadModel:
        """The head that a setting describes in JSON; empty for the common one. Raises SettingsError."""
        if not text.strip():
            return cls.common(width_mm)
        try:
            return cls.from_json(json.loads(text))
        except ValueError as error:
            raise SettingsError(
                f"The print head's shape is not JSON ({error}). Empty it to use the common one."
            ) from None

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> HeadModel:
        """Raises SettingsError where a box makes no sense."""
        if not isinstance(data, Mapping) or not isinstance(data.get("head"), (list, tuple)):
            raise SettingsError("The print head's shape needs `head`, a list of boxes, and perhaps `gantry`, one box.")
        gantry = data.get("gantry")
        return cls(tuple(Box.from_json(box) for box in data["head"]), None if gantry is None else Box.from_json(gantry))

    def to_json(self) -> dict[str, Any]:
        return {
            "head": [box.to_json() for box in self.head],
            "gantry": None if self.gantry is None else self.gantry.to_json(),
        }

    def corners_room_mm(self, position_mm: Sequence[float], bed: BedMotion) -> list[np.ndarray]:
        """(2, 3) float64 for each box: its low and high corner in the room when the machine is at `position_mm`."""
        nozzle = np.asarray(position_mm, dtype=np.float64) + bed.room_from_print_mm(position_mm)
        corners = [np.array([box.low_mm, box.high_mm]) + nozzle for box in self.head]
        if self.gantry is not None:
            corners.append(np.array([self.gantry.low_mm, self.gantry.high_mm]) + nozzle * [0, 1, 1])
        return corners

    def mask(self, position_mm: Sequence[float], bed: BedMotion, camera: Camera) -> np.ndarray:
        """(H, W) uint8, 255 where head or gantry may hide the print, in the camera's own pixels."""
        width, height = camera.image_size_px
        mask = np.zeros((height, width), np.uint8)
        for corners in self.corners_room_mm(position_mm, bed):
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
