"""How far the pixels that the last layers should have covered are covered: the first sign that no matter comes.

A layer adds a line of a pixel or two along the print's upper rim. Whether that line has come is too fine a question for a
mask of what is seen: blur alone carries the filament's colour as far. But what a pixel shows that filament covers in part
lies on the way from the bare bed's look to the filament's, and how far along is the part that is covered (matting with both
ends known, Smith and Blinn 1996). On the mean of a hundred pixels a quarter of a layer more or less is seen.
"""

from __future__ import annotations

import cv2
import numpy as np

from .spots import about

NEAR_PX = 10  # so far away at most is the filament whose look is taken,
NEAR_LEAST = 0.05  # where there is at least so much of it about
TELLING = 18.0  # grey levels between bed and filament, in any channel; less tells nothing


def coverage(
    look: np.ndarray, bare: np.ndarray, matter: np.ndarray, where: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Which of the pixels `where` can tell, (h, w) bool, and how far each of them is covered, (n,) float32 from 0 to 1.

    look, bare : (3, h, w) uint8, what is seen, and how the bed looks without matter
    matter     : (h, w) bool, filament that is seen in its place and has lain there before
    """
    tells = np.zeros_like(where)
    if not (where.any() and matter.any()):
        return tells, np.zeros(0, np.float32)
    few = tuple(slice(max(part.start - NEAR_PX, 0), part.stop + NEAR_PX) for part in about(where))
    asked, lying = np.flatnonzero(where[few]), matter[few].view(np.uint8) * np.uint8(255)
    amount = _mean_about(lying).take(asked) / np.float32(255)
    near = amount > NEAR_LEAST
    amount = np.maximum(amount, NEAR_LEAST)
    way = moved = most = np.zeros(len(amount), np.float32)
    for now, then in zip(look, bare):
        now, then = now[few], then[few].take(asked).astype(np.float32)
        apart = _mean_about(now & lying).take(asked) / amount - then
        way, moved = way + apart * apart, moved + apart * (now.take(asked) - then)
        most = np.maximum(most, np.abs(apart))
    near &= most > TELLING
    tells[few][where[few]] = near
    return tells, np.clip(moved[near] / way[near], 0.0, 1.0)


def _mean_about(plane: np.ndarray) -> np.ndarray:
    return cv2.blur(plane, (2 * NEAR_PX + 1,) * 2, borderType=cv2.BORDER_CONSTANT)
