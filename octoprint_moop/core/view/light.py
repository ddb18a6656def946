"""The frame as it would look in the light of the reference picture.

Lamps are dimmed, the sun moves, cameras change exposure and white balance by themselves. All of that multiplies each
colour channel by something that varies slowly over the picture, and it shows on what does not belong to the print:
there the frame divided by the reference gives that factor, and dividing the whole frame by it takes the change out.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

WORK_WIDTH_PX = 80
DARK, BRIGHT = 6.0, 245.0  # grey values outside of which a ratio says little
NOTICEABLE = 0.04
MIN_BACKGROUND_RATIO = 0.05
REACH_PX = 8.0  # how far, in pixels of the work picture, light is taken to be alike


@dataclass(frozen=True)
class LightChange:
    """brightness_ratio: how bright the background is against the reference; uneven: whether that varies over the view."""

    brightness_ratio: float
    uneven: bool


class Light:
    """Levels frames to a reference. Frames and reference: (H, W, 3) uint8 BGR of one size."""

    def __init__(self, reference_bgr: np.ndarray, exclude: np.ndarray) -> None:
        """`exclude`: (H, W) uint8, 255 where the print is or will be."""
        self._size_px = reference_bgr.shape[1::-1]
        self._work_px = (WORK_WIDTH_PX, max(1, WORK_WIDTH_PX * self._size_px[1] // self._size_px[0]))
        self._reference = self._small(reference_bgr)
        covered = cv2.resize(
            cv2.dilate(exclude, np.ones((9, 9), np.uint8)), self._work_px, interpolation=cv2.INTER_AREA
        )
        plain = (_least(self._reference) > DARK) & (_most(self._reference) < BRIGHT)
        self._background = (covered == 0) & plain

    def level(self, frame_bgr: np.ndarray) -> tuple[np.ndarray, LightChange]:
        """The frame in the reference's light, (H, W, 3) uint8, and by how much that was changed."""
        small = self._small(frame_bgr)
        known = self._background & (_most(small) < BRIGHT)
        if known.mean() < MIN_BACKGROUND_RATIO:
            return frame_bgr, LightChange(1.0, False)
        ratio = np.log(np.maximum(small, 1.0)) - np.log(np.maximum(self._reference, 1.0))
        overall = np.median(ratio[known], axis=0).astype(np.float32)
        # what moved in the background (a gantry, a hand) differs by far more than light does around it
        steady = known & (_most(np.abs(ratio - overall)) < 0.7)
        local = self._smooth(ratio - overall, steady)
        uneven = float(np.abs(local).max()) > NOTICEABLE
        change = LightChange(float(np.exp(overall.mean())), uneven)
        if not uneven and np.abs(overall).max() < NOTICEABLE:
            return frame_bgr, change
        gain = np.exp(-overall).astype(np.float32)
        if not uneven:
            levels = np.clip(np.arange(256)[:, None] * gain + 0.5, 0, 255).astype(np.uint8)
            return cv2.LUT(frame_bgr, levels.reshape(256, 1, 3)), change
        field = cv2.resize(gain * np.exp(-local).astype(np.float32), self._size_px, interpolation=cv2.INTER_LINEAR)
        return cv2.multiply(frame_bgr, field, dtype=cv2.CV_8U), change

    def gain(self, frame_bgr: np.ndarray) -> np.ndarray:
        """(3,) float32: by what to multiply the frame's channels, so that its light is the reference's on the whole."""
        small = self._small(frame_bgr)
        known = self._background & (_most(small) < BRIGHT)
        if known.mean() < MIN_BACKGROUND_RATIO:
            return np.ones(3, np.float32)
        ratio = np.maximum(self._reference[known][::2], 1.0) / np.maximum(small[known][::2], 1.0)
        return np.median(ratio, axis=0).astype(np.float32)

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


def _most(picture: np.ndarray) -> np.ndarray:
    """(H, W): the largest of the three channels; numpy is slow to reduce so short an axis."""
    return np.maximum(np.maximum(picture[..., 0], picture[..., 1]), picture[..., 2])


def _least(picture: np.ndarray) -> np.ndarray:
    return np.minimum(np.minimum(picture[..., 0], picture[..., 1]), picture[..., 2])
