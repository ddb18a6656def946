"""Expected against observed: the paper's error signal, to the letter."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np


@dataclass(frozen=True)
class Comparison:
    """How far one frame is from what was expected. Pixels that are ignored count nowhere but in `ignored_px`.

    expected_px, observed_px : foreground of the expected and of the observed mask
    missing_px, extra_px     : expected but not observed; observed but not expected
    total_px                 : foreground of the expected mask of the COMPLETE object in this view
    """

    expected_px: int
    observed_px: int
    missing_px: int
    extra_px: int
    ignored_px: int
    total_px: int

    @property
    def xor_px(self) -> int:
        """Wrong pixels, the numerator of equation 2."""
        return self.missing_px + self.extra_px

    @property
    def error_ratio(self) -> float:
        """E of Lyngby et al. 2017, equations 1 and 2: wrong pixels / foreground pixels of the complete object."""
        return self.xor_px / max(self.total_px, 1)


def compare(
    expected: np.ndarray, observed: np.ndarray, complete: np.ndarray, ignored: np.ndarray | None = None
) -> Comparison:
    """The counts behind E. All masks (H, W) uint8, 0 or 255, of one size. Raises ValueError where sizes differ."""
    for mask in (observed, complete) if ignored is None else (observed, complete, ignored):
        if mask.shape != expected.shape:
            raise ValueError(f"masks of different sizes: {mask.shape} and {expected.shape}")
    ignored_px = 0
    if ignored is not None:
        ignored_px = cv2.countNonZero(ignored)
        keep = cv2.bitwise_not(ignored)
        expected, observed, complete = (cv2.bitwise_and(mask, keep) for mask in (expected, observed, complete))
    expected_px, observed_px = cv2.countNonZero(expected), cv2.countNonZero(observed)
    both_px = cv2.countNonZero(cv2.bitwise_and(expected, observed))
    return Comparison(
        expected_px=expected_px,
        observed_px=observed_px,
        missing_px=expected_px - both_px,
        extra_px=observed_px - both_px,
        ignored_px=ignored_px,
        total_px=cv2.countNonZero(complete),
    )
