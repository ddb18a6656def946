"""Can this picture be used at all? And does something stand before the print?"""

from __future__ import annotations

import cv2
import numpy as np

from ..errors import FrameError

WORK_WIDTH_PX = 160
TORN_ROWS_RATIO = 0.03
OCCLUDER_RATIO = 0.012
COLOUR_STEP = 28.0
STILL_APART, STILL_NEAR = 1, 3  # for how many frames more a thing must lie as it did to be part of the scene


def refuse_unusable(frame_bgr: np.ndarray, previous_bgr: np.ndarray | None) -> None:
    """Raises FrameError with the reason where nothing can be seen in the frame, (H, W, 3) uint8 BGR."""
    small = cv2.resize(frame_bgr, (WORK_WIDTH_PX, 120), interpolation=cv2.INTER_AREA)
    blue, green, red = cv2.split(small)
    brightest, darkest = cv2.max(cv2.max(blue, green), red), cv2.min(cv2.min(blue, green), red)
    if np.partition(brightest.ravel(), -brightest.size // 100)[-brightest.size // 100] < 16:
        raise FrameError("The picture is black. Is the lamp on, and the camera's lens free?")
    if np.count_nonzero(darkest > 250) > 0.9 * darkest.size:
        raise FrameError("The picture is white throughout. Lower the camera's exposure.")
    if cv2.meanStdDev(small)[1].max() < 2:
        raise FrameError("The picture shows nothing but one colour. Is something held before the lens?")
    if previous_bgr is not None and previous_bgr.shape == frame_bgr.shape and _same(previous_bgr, frame_bgr):
        raise FrameError("The camera delivers the same picture again. Restart the webcam's stream.")
    if _flat_rows(frame_bgr) > TORN_ROWS_RATIO * len(frame_bgr):
        raise FrameError("The picture is torn: its lower part is missing. Check the webcam's cable or network.")


def _same(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether two pictures are equal to the last bit; a few rows tell most of those that are not."""
    return np.array_equal(a[::97], b[::97]) and np.array_equal(a, b)


def _flat_rows(frame_bgr: np.ndarray) -> int:
    """How many rows at the bottom hold one single value: a picture cut off in transfer ends so, a sensor's never does."""
    flat = 0
    for row in frame_bgr[::-1]:
        if not (row == row[0, 0]).all():
            break
        flat += 1
    return flat


class Occluders:
    """Finds what newly stands in the view and is not filament: a hand, a tool, the head where it should not be.

    Hands come and go. A gantry that stood elsewhere for the reference, a door that was shut, a box put beside the
    printer: what lies as it did a frame ago belongs to the scene from then on. Where it may hide the print that takes longer.
    """

    def __init__(self, reference_bgr: np.ndarray) -> None:
        self._size_px = reference_bgr.shape[1::-1]
        self._work_px = (WORK_WIDTH_PX, max(1, WORK_WIDTH_PX * self._size_px[1] // self._size_px[0]))
        self._reference = self._recent = self._small(reference_bgr)
        self._last: np.ndarray | None = None
        self._still_for = np.zeros(self._reference.shape[:2], np.int16)

    def refer_to(self, reference_bgr: np.ndarray) -> None:
        """The reference with the bed where it stands now; what was seen since stays known."""
        self._reference = self._small(reference_bgr)

    def find(self, frame_bgr: np.ndarray, filament: np.ndarray, place: np.ndarray) -> np.ndarray:
        """(H, W) uint8, 255 where something hides the view.

        frame_bgr : in the reference's light and view; filament : (H, W) uint8, 255 where filament is or may be;
        place : (H, W) uint8, 255 where the complete print will be.
        Compared with the reference and with the last good frame: a gantry that climbs differs from the first only.
        """
        small = self._small(frame_bgr)
        changed = np.minimum(_difference(small, self._reference), _difference(small, self._recent)) > COLOUR_STEP
        still = changed & (_difference(small, small if self._last is None else self._last) < COLOUR_STEP / 2)
        self._still_for = np.where(still & (self._last is not None), self._still_for + 1, 0).astype(np.int16)
        self._last = small
        changed &= self._near(filament) == 0
        blobs = cv2.morphologyEx(changed.astype(np.uint8), cv2.MORPH_OPEN, np.ones((5, 5), np.uint8))
        count, labels, stats, _ = cv2.connectedComponentsWithStats(blobs)
        large = stats[:, cv2.CC_STAT_AREA] > OCCLUDER_RATIO * labels.size
        large[0] = False
        hiding = np.zeros(labels.shape, np.uint8)
        for label in np.flatnonzero(large):
            blob = labels == label
            hides = cv2.bitwise_and(blob.astype(np.uint8), self._near(place)).any()
            if np.median(self._still_for[blob]) < (STILL_NEAR if hides else STILL_APART):
                hiding[blob] = 255
        if not hiding.any():
            return np.zeros(frame_bgr.shape[:2], np.uint8)
        return cv2.resize(cv2.dilate(hiding, np.ones((9, 9), np.uint8)), self._size_px, interpolation=cv2.INTER_NEAREST)

    def _near(self, mask: np.ndarray) -> np.ndarray:
        """The mask and what is near it, in the work picture's pixels."""
        return cv2.resize(cv2.dilate(mask, np.ones((13, 13), np.uint8)), self._work_px, interpolation=cv2.INTER_AREA)

    def accept(self, frame_bgr: np.ndarray) -> None:
        """The frame is good: what it shows is what the view looks like now."""
        self._recent = self._small(frame_bgr)

    def _small(self, frame_bgr: np.ndarray) -> np.ndarray:
        return cv2.resize(frame_bgr, self._work_px, interpolation=cv2.INTER_AREA).astype(np.int16)


def _difference(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    blue, green, red = cv2.split(cv2.absdiff(a, b))
    return cv2.max(cv2.max(blue, green), red)
