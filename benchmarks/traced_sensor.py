"""A webcam's way from light to bytes, for the path-traced recordings."""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np


@dataclass(eq=False)
class Sensor:
    """A webcam's way from light to JPEG: optics, exposure, noise, mosaic, tone curve, sharpening."""

    seed: int
    noise: float = 1.0
    quality: int = 85
    gain: float | None = None
    _balance: np.ndarray = field(init=False, default=None, repr=False)

    def __post_init__(self) -> None:
        rng = np.random.default_rng([self.seed, 41])
        self._blur, self._sharp, self._vignette = (
            0.5 + 0.4 * rng.random(),
            0.1 + 0.4 * rng.random(),
            0.1 + 0.25 * rng.random(),
        )
        self._warm = rng.normal(0, 0.05, 3)
        self._saturation, self._contrast = 1.0 + 0.25 * rng.random(), 0.2 + 0.4 * rng.random()
        self._photons = (3000 + 4000 * rng.random()) / self.noise**2

    def meter(self, empty: np.ndarray, complete: np.ndarray, matter: np.ndarray) -> None:
        """White balance and exposure as a webcam sets them, in part; the finished print just fits into the range."""
        mean = empty.reshape(-1, 3).mean(axis=0)
        self._balance = (mean.mean() / mean) ** 0.6 * (1 + self._warm)
        self.gain = 0.25 / float(np.mean(np.minimum(empty.mean(axis=2), np.percentile(empty, 97))))
        if matter.any():
            self.gain = min(self.gain, 0.85 / float(np.percentile((complete * self._balance)[matter].max(axis=1), 96)))

    def develop(self, rgb: np.ndarray, number: int, *, exposure: float = 1.0, warmth: float = 0.0) -> np.ndarray:
        """(H, W, 3) uint8 BGR."""
        rng = np.random.default_rng([self.seed, 42, number + 1])
        height, width = rgb.shape[:2]
        y, x = np.mgrid[:height, :width]
        r2 = ((x - width / 2) ** 2 + (y - height / 2) ** 2) / ((width / 2) ** 2 + (height / 2) ** 2)
        light = rgb * self._balance * self.gain * exposure * np.array([1 + warmth, 1.0, 1 - warmth])
        light = cv2.GaussianBlur(light * (1 - self._vignette * r2)[..., None], (0, 0), self._blur)
        light = np.clip(light, 0, 1.15)
        light = light + rng.normal(0, 1, light.shape) * np.sqrt(light / self._photons + (0.0025 * self.noise) ** 2)
        raw = np.zeros((height, width), np.uint16)
        counts = np.clip(light * 55000, 0, 65535).astype(np.uint16)
        raw[0::2, 0::2], raw[0::2, 1::2] = counts[0::2, 0::2, 0], counts[0::2, 1::2, 1]
        raw[1::2, 0::2], raw[1::2, 1::2] = counts[1::2, 0::2, 1], counts[1::2, 1::2, 2]
        bgr = cv2.cvtColor(raw, cv2.COLOR_BayerBG2BGR).astype(np.float32) / 55000
        grey = bgr.mean(axis=2, keepdims=True)
        bgr = np.clip(grey + self._saturation * (bgr - grey), 0, 1)
        tone = bgr ** (1 / 2.2)
        tone = (1 - self._contrast) * tone + self._contrast * (tone * tone * (3 - 2 * tone))
        tone = tone + self._sharp * (tone - cv2.GaussianBlur(tone, (0, 0), 1.1))
        return np.clip(tone * 255 + 0.5, 0, 255).astype(np.uint8)
