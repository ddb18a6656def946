"""What a check saw, painted over its frame for people: matched, missing and extra matter.

Each kind has a pattern of its own, so that nobody has to tell them apart by colour. The page paints the same in
static/js/moop_overlay.js.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np


@dataclass(frozen=True)
class Ink:
    """How one kind of pixel is painted: colour (BGR), how much of it lies on the whole area, and where its lines run."""

    name: str
    colour_bgr: tuple[int, int, int]
    tint_ratio: float
    hatch: str = ""  # any of / and \


# Okabe and Ito's palette, made to be told apart by colour-blind eyes
MATCHED = Ink("matched", (115, 158, 0), 0.18)
MISSING = Ink("missing", (0, 159, 230), 0.3, "/")
EXTRA = Ink("extra", (167, 121, 204), 0.3, "/\\")
INKS = (MATCHED, MISSING, EXTRA)


def difference(frame_bgr: np.ndarray, expected: np.ndarray, observed: np.ndarray, ignored: np.ndarray) -> np.ndarray:
    """The frame, (H, W, 3) uint8 BGR, with the three kinds over it; masks are (H, W) uint8, 0 or 255.

    Ignored pixels stay as they are.
    """
    counted = cv2.bitwise_not(ignored)
    painted = frame_bgr.copy()
    _paint(painted, expected & observed & counted, MATCHED)
    _paint(painted, expected & cv2.bitwise_not(observed) & counted, MISSING)
    _paint(painted, observed & cv2.bitwise_not(expected) & counted, EXTRA)
    return painted


def outlined(frame_bgr: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """The frame with one mask over it, tinted and outlined."""
    painted = frame_bgr.copy()
    _paint(painted, mask, MATCHED)
    return painted


def _paint(picture_bgr: np.ndarray, mask: np.ndarray, ink: Ink) -> None:
    chosen = mask > 0
    if not chosen.any():
        return
    tinted = (1 - ink.tint_ratio) * picture_bgr[chosen] + ink.tint_ratio * np.array(ink.colour_bgr)
    picture_bgr[chosen] = tinted.astype(np.uint8)
    picture_bgr[chosen & _lines(mask.shape, ink.hatch)] = ink.colour_bgr
    edge = cv2.subtract(mask, cv2.erode(mask, np.ones((3, 3), np.uint8), borderValue=0))
    picture_bgr[edge > 0] = ink.colour_bgr


def _lines(shape: tuple[int, int], hatch: str) -> np.ndarray:
    y, x = np.indices(shape, sparse=True)
    period = max(6, shape[1] // 64)
    lines = np.zeros(shape, bool)
    if "/" in hatch:
        lines |= (x + y) % period < max(1, period // 4)
    if "\\" in hatch:
        lines |= (x - y) % period < max(1, period // 4)
    return lines
