"""Pictures in and out of the eye."""

from __future__ import annotations

import cv2
import numpy as np

from ..core.errors import FrameError

MOST_PX = 30_000_000


def decode(jpeg: bytes) -> np.ndarray:
    """(H, W, 3) uint8 BGR, as the camera sent it: what a JPEG says about turning is not followed.

    Raises FrameError where this is not a picture, or one of more than MOST_PX pixels.
    """
    try:
        flags = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
        frame = cv2.imdecode(np.frombuffer(jpeg, np.uint8), flags) if jpeg else None
    except (cv2.error, MemoryError):
        frame = None
    if frame is None or frame.shape[0] * frame.shape[1] > MOST_PX:
        raise FrameError("This is not a picture, or it is damaged, or larger than 30 megapixels. Look at it yourself.")
    return frame


def encode_mask(mask: np.ndarray) -> bytes:
    """PNG of a (H, W) uint8 mask; quickly, since masks are small either way."""
    return cv2.imencode(".png", mask, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1].tobytes()
