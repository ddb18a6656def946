"""Can this picture be used at all? And does something stand before the print?"""

from __future__ import annotations

import cv2
import numpy as np

from ..camera import Camera
from ..errors import FrameError
from .glance import Glance

TORN_ROWS_RATIO = 0.03
OCCLUDER_RATIO = 0.012
COLOUR_STEP = 28
STILL_APART, STILL_NEAR = 1, 3  # for how many frames more a thing must lie as it did to be part of the scene
HIDES_PX = 5
"""How near to the print, in a glance's pixels, a thing may stand before it as well."""
FOREIGN_RATIO = 0.25
"""Of what came in through the picture's rim, that looks like filament beside the print: else it is told by its colour."""
BARED_RATIO = 0.25
"""Of what came in, as much of the print's place as shows the bed again: else it may be the print that came off."""
REPEATED_ROWS, REPEATED_RATIO, LIVE_RATIO, LIVE_FRAMES = 7, 0.9, 0.5, 2
"""Every so many rows are compared to tell a live picture; the shares of a picture that are those of the last to the last
bit: in one that was delivered again, and at most in live ones, of which so many pairs must have been seen."""
REST_STEP, REST_RATIO = 20.0, 0.001  # grey levels, and the share of a picture at rest that may differ by more


def fit_frame(frame_bgr: np.ndarray, camera: Camera) -> np.ndarray:
    """(H, W, 3) uint8 BGR: the frame at the camera's size. Raises FrameError where it is of another shape."""
    width, height = camera.image_size_px
    frame_height, frame_width = frame_bgr.shape[:2]
    if (frame_width, frame_height) == (width, height):
        return frame_bgr
    if abs(frame_width * height - frame_height * width) > 0.01 * frame_height * width:
        raise FrameError(
            f"The frame is {frame_width} x {frame_height} px, but the camera was calibrated at {width} x {height} px. "
            "Set the webcam back, or calibrate it again."
        )
    return cv2.resize(frame_bgr, (width, height), interpolation=cv2.INTER_AREA)


def refuse_unusable(frame_bgr: np.ndarray, glance: Glance | None = None) -> None:
    """Raises FrameError with the reason where nothing can be seen in the frame, (H, W, 3) uint8 BGR.

    glance : of the frame, where it is there already
    """
    small = (glance or Glance(frame_bgr)).quarter
    blue, green, red = cv2.split(small)
    brightest, darkest = cv2.max(cv2.max(blue, green), red), cv2.min(cv2.min(blue, green), red)
    if np.count_nonzero(brightest >= 16) < brightest.size / 100:
        raise FrameError("The picture is black. Is the lamp on, and the camera's lens free?")
    if np.count_nonzero(darkest > 250) > 0.9 * darkest.size:
        raise FrameError("The picture is white throughout. Lower the camera's exposure.")
    if cv2.meanStdDev(small)[1].max() < 2:
        raise FrameError("The picture shows nothing but one colour. Is something held before the lens?")
    if _flat_rows(frame_bgr) > TORN_ROWS_RATIO * len(frame_bgr):
        raise FrameError("The picture is torn: its lower part is missing. Check the webcam's cable or network.")


def is_still(first_bgr: np.ndarray, second_bgr: np.ndarray) -> bool:
    """Whether two frames, (H, W, 3) uint8, show the same scene but for noise and the light: nothing in it has moved."""
    if first_bgr.shape != second_bgr.shape:
        return False
    first, second = Glance(first_bgr).quarter, Glance(second_bgr).quarter
    change = second.astype(np.float32) - first
    change -= np.median(change.reshape(-1, 3), axis=0)
    return bool(np.count_nonzero(np.abs(change).max(axis=2) > REST_STEP) <= REST_RATIO * change[..., 0].size)


class Repeats:
    """Refuses a picture that was delivered before. One of a live sensor never is another to the last bit, and hardly a pixel
    of it is where there is noise; one that was delivered again may have had the time written over it since.

    Cameras that smooth noise away repeat most of what stands still: in their pictures only one that repeats all is refused.
    """

    def __init__(self) -> None:
        self._previous_bgr: np.ndarray | None = None
        self._live_ratios: list[float] = []

    def refuse(self, frame_bgr: np.ndarray) -> None:
        """frame_bgr : (H, W, 3) uint8, in time order. Raises FrameError with the reason."""
        previous_bgr, self._previous_bgr = self._previous_bgr, frame_bgr
        if previous_bgr is None or previous_bgr.shape != frame_bgr.shape:
            return
        rows, others = frame_bgr[::REPEATED_ROWS], previous_bgr[::REPEATED_ROWS]
        same = cv2.inRange(cv2.absdiff(rows, others), (0, 0, 0), (0, 0, 0))
        ratio = cv2.countNonZero(same) / same.size
        live = len(self._live_ratios) >= LIVE_FRAMES and max(self._live_ratios) < LIVE_RATIO
        if (ratio == 1 and np.array_equal(frame_bgr, previous_bgr)) or (live and ratio > REPEATED_RATIO):
            raise FrameError("The camera delivers the same picture again. Restart the webcam's stream.")
        self._live_ratios = [*self._live_ratios, ratio][-LIVE_FRAMES:]


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
    printer: what lies as it did a frame ago belongs to the scene from then on. Where it may hide the print that takes longer,
    and beside the print what the first frame shows has not newly come: between it and the reference much was moved.

    A thing of the filament's colour is told by where it came from: only through the picture's rim does anything come before
    the camera, and what a print sheds begins at the print. So what hangs together with the rim, and is no strand, is none
    of the print's, whatever its colour, for as long as it stays; unless the bed shows where the print stood.

    Pictures are `Glance.quarter`s, (h, w, 3) uint8 BGR, and masks of their size, (h, w) uint8, over 0 where they hold.
    """

    def __init__(self, reference_bgr: np.ndarray) -> None:
        self._reference = self._recent = reference_bgr
        self._last: np.ndarray | None = None
        self._accepted = False
        self._still_for = np.zeros(reference_bgr.shape[:2], np.int16)
        self.foreign: np.ndarray = np.zeros(reference_bgr.shape[:2], np.uint8)
        """255 where in the last frame something stands that looks like filament and came in through the picture's rim."""

    def refer_to(self, reference_bgr: np.ndarray) -> None:
        """The reference with the bed where it stands now; what was seen since stays known."""
        self._reference = reference_bgr

    def find(
        self, small_bgr: np.ndarray, filament: np.ndarray, place: np.ndarray, unknown: np.ndarray | None = None
    ) -> np.ndarray:
        """(h, w) uint8, 255 where something hides the view.

        small_bgr : in the reference's light and view; filament : where filament is seen or may be; place : where the
        complete print will be; unknown : where nothing can be told by the reference. Compared with the reference and with
        the last good frame: a gantry that climbs differs from the first only.
        """
        from_reference, from_recent = (_difference(small_bgr, known) for known in (self._reference, self._recent))
        change = cv2.min(from_reference, from_recent)
        changed = cv2.inRange(change, COLOUR_STEP + 1, 255)
        if self._last is not None:
            still = (changed > 0) & (_difference(small_bgr, self._last) < COLOUR_STEP // 2)
            self._still_for = (self._still_for + 1) * still
        self._last = small_bgr
        if unknown is not None:
            changed[_about(unknown) > 0] = 0
        came_in = [blob for blob in _large(_opened(changed)) if _through_rim(blob, place)]
        if came_in:  # where the bed has come to light, it is the print that went there
            bared = (place > 0) & (from_reference < COLOUR_STEP // 2) & (from_recent > COLOUR_STEP)
            came_in = [blob for blob in came_in if np.count_nonzero(bared) < BARED_RATIO * np.count_nonzero(blob)]
        changed[_about(filament) > 0] = 0
        blobs = _opened(changed)
        for blob in came_in:
            blobs[blob] = 255
        # what a thing shows beside the print was cut off from what it shows before it, with a margin all around
        print_and_about = cv2.dilate(place | filament, np.ones((2 * HIDES_PX + 1, 2 * HIDES_PX + 1), np.uint8)) > 0
        hiding, self.foreign = np.zeros((2, *blobs.shape), np.uint8)
        for blob in _large(blobs):
            hides = (blob & print_and_about).any()
            if np.median(self._still_for[blob]) < (STILL_NEAR if hides else STILL_APART if self._accepted else 0):
                hiding[blob] = 255
        beside = (filament > 0) & (_about(place) == 0)
        for blob in came_in:
            if np.count_nonzero(blob & beside) > FOREIGN_RATIO * np.count_nonzero(blob):
                self.foreign[blob] = 255
        around = np.ones((9, 9), np.uint8)
        self.foreign = cv2.dilate(self.foreign, around)
        return cv2.dilate(hiding, around)

    def accept(self, small_bgr: np.ndarray) -> None:
        """The frame is good: what it shows is what the view looks like now, but for what does not belong there."""
        if self.foreign.any():
            small_bgr = np.where(self.foreign[..., None] > 0, self._recent, small_bgr)
        self._recent, self._accepted = small_bgr, True


def _opened(changed: np.ndarray) -> np.ndarray:
    """The mask without strands, and without the edges of what has moved a little."""
    return cv2.morphologyEx(changed, cv2.MORPH_OPEN, np.ones((5, 5), np.uint8))


def _large(blobs: np.ndarray) -> list[np.ndarray]:
    """(h, w) bool each: the mask's spots that are large enough for a thing before the view."""
    least_px = OCCLUDER_RATIO * blobs.size
    if cv2.countNonZero(blobs) <= least_px:
        return []
    _, labels, stats, _ = cv2.connectedComponentsWithStats(blobs)
    return [labels == label for label in range(1, len(stats)) if stats[label, cv2.CC_STAT_AREA] > least_px]


def _through_rim(blob: np.ndarray, place: np.ndarray) -> bool:
    """Whether a spot (bool) hangs together with the picture's rim, and not where the print itself reaches it."""
    sides = [(blob[side], place[side] > 0) for side in (np.s_[0], np.s_[-1], np.s_[:, 0], np.s_[:, -1])]
    return any(there.any() for there, _ in sides) and not any((there & prints).any() for there, prints in sides)


def _difference(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    blue, green, red = cv2.split(cv2.absdiff(a, b))
    return cv2.max(cv2.max(blue, green), red)


def _about(mask: np.ndarray) -> np.ndarray:
    """The mask and what is near it."""
    return cv2.dilate(mask, np.ones((5, 5), np.uint8))
