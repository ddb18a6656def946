"""The frame as it would look in the light of the reference picture.

Lamps are dimmed, the sun moves, cameras change exposure and white balance by themselves. All of that multiplies each
colour channel by something that varies slowly over the picture, and it shows on what does not belong to the print:
there the frame divided by the reference gives that factor, and dividing the whole frame by it takes the change out.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

WORK_WIDTH_PX = 40
DARK, BRIGHT = 6.0, 245.0  # grey values outside of which a ratio says little
NOTICEABLE = 0.04
MOST_CHANGE, MOST_TINT = 0.7, 0.3  # logarithms, against the picture as a whole, that light may differ by in places
MIN_BACKGROUND_RATIO = 0.05
REACH_PX = 4.0  # how far, in pixels of the work picture, light is taken to be alike
MOST_GAIN = 8.0
FIELD_STEP = 8  # the cut-out field's pixels are so many of the picture's wide


@dataclass(frozen=True, eq=False)
class LightChange:
    """By how much the light of a frame differs from the reference's.

    brightness_ratio : how bright the background is against the reference
    gain  : (3,) float32, what to multiply the channels by; None where there is nothing to do
    field : (h, w, 3) float32, the same where that varies over the view, for the whole picture in small; else None
    """

    brightness_ratio: float = 1.0
    gain: np.ndarray | None = None
    field: np.ndarray | None = None

    def undone(self, picture_bgr: np.ndarray, box: tuple[float, float, float, float] = (0, 0, 1, 1)) -> np.ndarray:
        """The picture, (H, W, 3) uint8 BGR, in the reference's light.

        box : the part of the view that it shows: left, top, right, bottom in parts of the whole
        """
        if self.gain is None:
            return picture_bgr
        if self.field is None:
            levels = np.clip(np.arange(256)[:, None] * self.gain + 0.5, 0, 255).astype(np.uint8)
            return cv2.LUT(picture_bgr, levels.reshape(256, 1, 3))
        # in bytes, so that OpenCV multiplies many pixels at once: a gain to half a percent is as good as its measurement
        unit = float(self.field.max()) / 255
        coarse = np.round(self.field / unit).astype(np.uint8)
        height, width = picture_bgr.shape[:2]
        # cut out at a coarse size and enlarged, which OpenCV does many times faster than both at once
        cut_px = max(width // FIELD_STEP, 1), max(height // FIELD_STEP, 1)
        left, top, right, bottom = (
            side * whole
            for side, whole in zip(box, (coarse.shape[1], coarse.shape[0], coarse.shape[1], coarse.shape[0]))
        )
        across, down = (right - left) / cut_px[0], (bottom - top) / cut_px[1]
        part = np.array([[across, 0, left + 0.5 * across - 0.5], [0, down, top + 0.5 * down - 0.5]])
        smooth = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        cut = cv2.warpAffine(coarse, part, cut_px, flags=smooth, borderMode=cv2.BORDER_REPLICATE)
        field = cv2.resize(cut, (width, height), interpolation=cv2.INTER_LINEAR)
        return cv2.multiply(picture_bgr, field, scale=unit)


UNCHANGED = LightChange()


class Light:
    """Compares frames with a reference. Frames and reference: (H, W, 3) uint8 BGR of one view, large or small."""

    def __init__(self, reference_bgr: np.ndarray, exclude: np.ndarray) -> None:
        """`exclude`: (H, W) uint8, over 0 where the print is or will be."""
        height, width = reference_bgr.shape[:2]
        self._work_px = (WORK_WIDTH_PX, max(1, WORK_WIDTH_PX * height // width))
        reference = self._small(reference_bgr)
        covered = cv2.resize(exclude, self._work_px, interpolation=cv2.INTER_AREA)
        plain = (_least(reference) > DARK) & (_most(reference) < BRIGHT)
        self._background = (cv2.dilate(covered, np.ones((3, 3), np.uint8)) == 0) & plain
        self._log_reference = np.log(np.maximum(reference, 1.0))

    def change(self, frame_bgr: np.ndarray) -> LightChange:
        small = self._small(frame_bgr)
        known = self._background & (_most(small) < BRIGHT)
        if known.mean() < MIN_BACKGROUND_RATIO:
            return UNCHANGED
        ratio = np.log(np.maximum(small, 1.0)) - self._log_reference
        overall = _medians(ratio[known])
        # what moved in the background (a gantry, a hand) differs by far more than light does around it, or in colour
        rest = ratio - overall
        steady = known & (_most(np.abs(rest)) < MOST_CHANGE) & (_most(rest) - _least(rest) < MOST_TINT)
        local = self._smooth(rest, steady)
        uneven = float(np.abs(local).max()) > NOTICEABLE
        brightness_ratio = float(np.exp(overall.mean()))
        if not uneven and np.abs(overall).max() < NOTICEABLE:
            return LightChange(brightness_ratio)
        gain = np.exp(-overall)
        field = np.minimum(gain * np.exp(-local), MOST_GAIN).astype(np.float32) if uneven else None
        return LightChange(brightness_ratio, gain, field)

    def gain(self, frame_bgr: np.ndarray) -> np.ndarray:
        """(3,) float32: by what to multiply the frame's channels, so that its light is the reference's on the whole."""
        small = self._small(frame_bgr)
        known = self._background & (_most(small) < BRIGHT)
        if known.mean() < MIN_BACKGROUND_RATIO:
            return np.ones(3, np.float32)
        return np.exp(_medians(self._log_reference[known] - np.log(np.maximum(small[known], 1.0))))

    def _small(self, frame_bgr: np.ndarray) -> np.ndarray:
        return cv2.resize(frame_bgr, self._work_px, interpolation=cv2.INTER_AREA).astype(np.float32)

    @staticmethod
    def _smooth(field: np.ndarray, known: np.ndarray) -> np.ndarray:
        """The field where it is known, carried smoothly over the rest (normalised convolution, Knutsson 1993)."""
        weight = known.astype(np.float32)
        # a little weight for "no change" everywhere, so that far from anything known nothing is claimed
        total = cv2.GaussianBlur(weight, (0, 0), REACH_PX) + 0.02
        carried = cv2.GaussianBlur((field * weight[..., None]).astype(np.float32), (0, 0), REACH_PX)
        return carried / total[..., None]


def _medians(values: np.ndarray) -> np.ndarray:
    """(3,) float32: of each column of (N, 3)."""
    return np.median(np.ascontiguousarray(values.T), axis=1).astype(np.float32)


def _most(picture: np.ndarray) -> np.ndarray:
    """(H, W): the largest of the three channels; numpy is slow to reduce so short an axis."""
    return np.maximum(np.maximum(picture[..., 0], picture[..., 1]), picture[..., 2])


def _least(picture: np.ndarray) -> np.ndarray:
    return np.minimum(np.minimum(picture[..., 0], picture[..., 1]), picture[..., 2])
