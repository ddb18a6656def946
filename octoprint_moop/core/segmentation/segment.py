"""Which pixels of a frame are filament."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import cv2
import numpy as np

from ..errors import SegmentationError
from ..expected.views import Expected

CLICK_RADIUS_PX = 4  # what is averaged about a clicked point
GREYISH = 0.15  # saturation below which a hue is noise
HUE_MARGIN_DEG = 8.0


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
    return _band(pixels)


def _band(pixels: np.ndarray) -> HsvThresholds:
    hue = np.deg2rad(pixels[:, 0].astype(np.float64))
    middle_deg = np.rad2deg(np.arctan2(np.sin(hue).mean(), np.cos(hue).mean()))
    offset_deg = (pixels[:, 0] - middle_deg + 180) % 360 - 180
    low, high = np.percentile(offset_deg, [5, 95])
    # one grey level below, since S and V must exceed their limits and white filament often is as bright as can be
    saturation, value = np.maximum(np.percentile(pixels[:, 1:], 5, axis=0) - 1 / 255, 0)
    return HsvThresholds(
        float((middle_deg + low) % 360), float((middle_deg + high) % 360), float(saturation), float(value)
    )


def suggest_thresholds(
    frame_bgr: np.ndarray, filament_px: Sequence[tuple[int, int]], background_px: Sequence[tuple[int, int]] = ()
) -> HsvThresholds:
    """Thresholds that take in the clicked filament and leave out the clicked background, as far as a band can.

    filament_px, background_px : (x, y) in the frame
    Raises SegmentationError where no filament is clicked, a point lies outside of the frame, or there is no colour.
    """
    filament = _pixels_about(frame_bgr, filament_px)
    if not len(filament):
        raise SegmentationError("No point on filament was clicked. Click at least one, better three.")
    background = _pixels_about(frame_bgr, background_px)
    saturation, value = np.percentile(filament[:, 1:], 2, axis=0)
    if not filament[:, 1].any():
        raise SegmentationError(
            "This picture has no colour (a monochrome or infrared camera), and thresholds need a hue. "
            "Use the adaptive segmentation, which can do without."
        )
    hues = (0.0, 360.0)
    if np.median(filament[:, 1]) > GREYISH:
        tight = _band(filament)
        hues = ((tight.hue_min_deg - HUE_MARGIN_DEG) % 360, (tight.hue_max_deg + HUE_MARGIN_DEG) % 360)
    floors = []
    for channel, low in ((1, saturation), (2, value)):
        darker = background[:, channel][background[:, channel] < low] if len(background) else background[:, channel]
        # midway to the background below, but never so close to the filament that its shaded side is lost
        floors.append(max(0.0, min((low + darker.max()) / 2, 0.8 * low)) if len(darker) else 0.6 * low)
    return HsvThresholds(float(hues[0]), float(hues[1]), float(floors[0]), float(floors[1]))


def _pixels_about(frame_bgr: np.ndarray, points_px: Sequence[tuple[int, int]]) -> np.ndarray:
    """(N, 3) float32 hue, saturation, value of the pixels about the points. Raises SegmentationError."""
    height, width = frame_bgr.shape[:2]
    spots = np.zeros((height, width), np.uint8)
    for x, y in points_px:
        if not (0 <= x < width and 0 <= y < height):
            raise SegmentationError(f"The point {(x, y)} lies outside of the {width}x{height} picture. Click it again.")
        cv2.circle(spots, (int(x), int(y)), CLICK_RADIUS_PX, 255, cv2.FILLED)
    return hsv(frame_bgr[spots > 0][None])[0] if spots.any() else np.zeros((0, 3), np.float32)


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
