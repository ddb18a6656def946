"""Which pixels of a frame are filament."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Mapping

import cv2
import numpy as np

from .errors import SegmentationError


@dataclass(frozen=True)
class HsvThresholds:
    """The paper's thresholds (equation 12). Hue in degrees, wrapping through 0 where hue_min > hue_max; S, V in 0..1."""

    hue_min_deg: float
    hue_max_deg: float
    saturation_min: float
    value_min: float

    def __post_init__(self) -> None:
        hues = (self.hue_min_deg, self.hue_max_deg)
        if not all(0 <= hue <= 360 for hue in hues):
            raise SegmentationError(f"The hue limits {hues} must lie between 0 and 360 degrees.")
        if not (0 <= self.saturation_min <= 1 and 0 <= self.value_min <= 1):
            raise SegmentationError("Saturation and value limits must lie between 0 and 1.")

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> HsvThresholds:
        """Raises SegmentationError naming what is missing or out of range."""
        try:
            low, high = data["hue_deg"]
            return cls(float(low), float(high), float(data["saturation_min"]), float(data["value_min"]))
        except KeyError as missing:
            raise SegmentationError(f"The material has no {missing.args[0]!r}.") from None
        except (TypeError, ValueError) as error:
            raise SegmentationError(f"The material has a value that makes no sense ({error}).") from None

    def to_json(self) -> dict[str, Any]:
        return {
            "hue_deg": [self.hue_min_deg, self.hue_max_deg],
            "saturation_min": self.saturation_min,
            "value_min": self.value_min,
        }


def hsv(frame_bgr: np.ndarray) -> np.ndarray:
    """(H, W, 3) float32: hue in degrees 0..360, saturation and value 0..1.

    Smith's hexcone model, equations 3 to 11 of Lyngby et al. 2017; hue and saturation are 0 where undefined.
    """
    return cv2.cvtColor(frame_bgr.astype(np.float32) / 255, cv2.COLOR_BGR2HSV)


def segment_hsv(frame_bgr: np.ndarray, thresholds: HsvThresholds) -> np.ndarray:
    """(H, W) uint8, 255 where the pixel is filament: hue in [min, max], S > S_t and V > V_t (equation 12).

    frame_bgr : (H, W, 3) uint8
    """
    picture = hsv(frame_bgr)
    # S and V must exceed their limits, and inRange counts its limits in
    least = (np.nextafter(np.float32(limit), np.float32(2)) for limit in (thresholds.saturation_min, thresholds.value_min))
    saturation_min, value_min = (float(limit) for limit in least)
    low, high = thresholds.hue_min_deg, thresholds.hue_max_deg
    if low <= high:
        return cv2.inRange(picture, (low, saturation_min, value_min), (high, 2, 2))
    above = cv2.inRange(picture, (low, saturation_min, value_min), (360, 2, 2))
    return cv2.bitwise_or(above, cv2.inRange(picture, (0, saturation_min, value_min), (high, 2, 2)))
