"""Which pixels of a frame are filament."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import cv2
import numpy as np

from ..errors import SegmentationError
from ..expected.views import Expected


@dataclass(frozen=True)
class HsvThresholds:
    """The paper's thresholds (equation 12): hue in degrees, through 0 where hue_min > hue_max; S, V in 0..1."""

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
    least = (
        np.nextafter(np.float32(limit), np.float32(2)) for limit in (thresholds.saturation_min, thresholds.value_min)
    )
    saturation_min, value_min = (float(limit) for limit in least)
    low, high = thresholds.hue_min_deg, thresholds.hue_max_deg
    if low <= high:
        return cv2.inRange(picture, (low, saturation_min, value_min), (high, 2, 2))
    above = cv2.inRange(picture, (low, saturation_min, value_min), (360, 2, 2))
    return cv2.bitwise_or(above, cv2.inRange(picture, (0, saturation_min, value_min), (high, 2, 2)))


def thresholds_of(frame_bgr: np.ndarray, mask: np.ndarray) -> HsvThresholds:
    """The band that holds the colours of labelled filament: 5 % of it is left out at each end that limits.

    mask : (H, W) uint8, non-zero on filament. Raises SegmentationError where it holds none.
    """
    pixels = hsv(frame_bgr)[mask > 0]
    if not len(pixels):
        raise SegmentationError("No filament is marked in this picture. Mark some.")
    hue = np.deg2rad(pixels[:, 0].astype(np.float64))
    middle_deg = np.rad2deg(np.arctan2(np.sin(hue).mean(), np.cos(hue).mean()))
    offset_deg = (pixels[:, 0] - middle_deg + 180) % 360 - 180
    low, high = np.percentile(offset_deg, [5, 95])
    # one grey level below, since S and V must exceed their limits and white filament often is as bright as can be
    saturation, value = np.maximum(np.percentile(pixels[:, 1:], 5, axis=0) - 1 / 255, 0)
    return HsvThresholds(
        float((middle_deg + low) % 360), float((middle_deg + high) % 360), float(saturation), float(value)
    )


@dataclass(frozen=True, eq=False)
class Observation:
    """What a frame shows, each (H, W) uint8, 0 or 255, in the frame's own pixels.

    mask   : filament
    unsure : neither can be said; such pixels are left out of the comparison
    """

    mask: np.ndarray
    unsure: np.ndarray

    def within(self, shape: tuple[int, int], region: tuple[int, int, int, int]) -> Observation:
        """The same in a frame of `shape` of which this was the region (x0, y0, x1, y1); nothing is seen outside."""
        x0, y0, x1, y1 = region
        mask, unsure = np.zeros(shape, np.uint8), np.zeros(shape, np.uint8)
        mask[y0:y1, x0:x1], unsure[y0:y1, x0:x1] = self.mask, self.unsure
        return Observation(mask, unsure)


class Segmenter(Protocol):
    """Tells filament from everything else, check by check."""

    def observe(self, frame_bgr: np.ndarray, expected: Expected | None) -> Observation:
        """frame_bgr : (H, W, 3) uint8; expected : what should be seen, None where nothing is known."""

    def learn(self, frame_bgr: np.ndarray, expected: Expected, observed: Observation) -> None:
        """Called with what `observe` gave, only after a check in which all was well."""

    def look_elsewhere(self) -> None:
        """From now on frames show another part of the view: what was learned of single pixels is of no use."""


class ThresholdSegmenter:
    """The paper's equation 12 alone. Learns nothing, is never unsure."""

    def __init__(self, material: HsvThresholds) -> None:
        self._material = material

    def observe(self, frame_bgr: np.ndarray, expected: Expected | None = None) -> Observation:
        mask = segment_hsv(frame_bgr, self._material)
        return Observation(mask, np.zeros_like(mask))

    def learn(self, frame_bgr: np.ndarray, expected: Expected, observed: Observation) -> None:
        """Nothing: the thresholds are the user's."""

    def look_elsewhere(self) -> None:
        """Nothing: it knows no pixel from another."""
