"""Whether what lies beside a print is a part of it that lies elsewhere: by its lines, and by its outline.

Of a part that was displaced only what sticks out beyond the rest can be told from it. Two things must be alike: of what
would stick out, the share that is seen, and of what is seen, the share that would lie there. Strands and blobs come in
shapes of their own, and fail the one or the other.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from .shapes import BESIDE_PX, LEAST_REACH_PX, REACH_RATIO, best_place, closed, displaced, filled
from .spots import disc

INFILL_GAP_PX, GAP_PX = 8.0, 3.0  # at 640 pixels across


@dataclass(frozen=True)
class Likeness:
    """How alike at best, 0 to 1 (the harmonic mean of both shares), and where: `offset_px`, (right, down).

    told_ratio : of what lies beside the print, so much is explained; out_ratio : of the part, so much sticks out
    apart_px   : so far the contour of what sticks out lies from the one that is seen, on the average
    """

    ratio: float
    offset_px: tuple[int, int]
    told_ratio: float
    out_ratio: float
    apart_px: float


class Beside:
    """What lies beside a print, ready to be compared with its parts. Masks are bool, of one shape.

    stray : matter where none is expected; wanted : the print; mute : where nothing can be told, beside the print's own pixels
    """

    def __init__(self, stray: np.ndarray, wanted: np.ndarray, mute: np.ndarray, finer: float) -> None:
        x, y, w, h = cv2.boundingRect(wanted.view(np.uint8))
        self._reach_px = max(LEAST_REACH_PX, int(REACH_RATIO * max(w, h)))
        self._mute = (cv2.dilate(wanted.view(np.uint8), disc(BESIDE_PX)) > 0) | mute
        self._stray = stray & ~self._mute
        x, y, w, h = cv2.boundingRect(self._stray.view(np.uint8))
        self._middle_px = x + w / 2, y + h / 2
        self._lines = cv2.dilate(stray.view(np.uint8), disc(1)) > 0
        self._body = closed(stray | wanted, GAP_PX * finer)
        self._layer = closed(stray | wanted, INFILL_GAP_PX * finer)
        self.px = int(np.count_nonzero(self._stray))

    def lines(self, part: np.ndarray) -> Likeness:
        """With the part as it is, gaps between its lines included."""
        return self._likeness(part, self._lines, self._reach_px)

    def layer(self, part: np.ndarray) -> Likeness:
        """With the part's outline: a layer that lies on nothing is seen with gaps, and stretched by perspective."""
        return self._likeness(filled(part), self._layer, self._reach_px)

    def body(self, part: np.ndarray, others: np.ndarray) -> Likeness:
        """With the part as it is, wherever it would cover some of what lies beside; it cannot lie where `others` stand."""
        x, y, w, h = cv2.boundingRect(part.view(np.uint8))
        away_px = max(abs(x + w / 2 - self._middle_px[0]), abs(y + h / 2 - self._middle_px[1]))
        return self._likeness(part, self._body & ~others, int(away_px + max(w, h) / 2), self._mute & ~others)

    def _likeness(self, part: np.ndarray, seen: np.ndarray, reach_px: int, mute: np.ndarray | None = None) -> Likeness:
        mute = self._mute if mute is None else mute
        pays = np.where(mute, np.float32(0), np.where(seen, np.float32(1), np.float32(-1)))
        offset_px = best_place(part, pays, reach_px)
        there = displaced(part, offset_px)
        out, near = there & ~mute, cv2.dilate(there.view(np.uint8), disc(1.5)) > 0
        told = self._stray & near
        out_px, seen_px, told_px = (int(np.count_nonzero(mask)) for mask in (out, out & seen, told))
        contour_px = out_px - int(np.count_nonzero(cv2.erode(out.view(np.uint8), disc(1))))
        part_px = int(np.count_nonzero(part))
        out_px += part_px - int(np.count_nonzero(there))  # what would lie outside of the picture is not seen
        seen_ratio, told_ratio = seen_px / max(out_px, 1), told_px / max(self.px, 1)
        ratio = 2 * seen_ratio * told_ratio / max(seen_ratio + told_ratio, 1e-6)
        apart_px = (out_px - seen_px + self.px - told_px) / max(contour_px, 1)
        return Likeness(ratio, offset_px, told_ratio, out_px / max(part_px, 1), apart_px)
