"""By how much a view shows the print elsewhere than it is expected: found at the first layers, followed slowly from there on.

A calibration that is a pixel or two off shows from the first layer on and stays; what moves later has moved for another
reason.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from . import align
from .align import Alignment
from .spots import Window, about

SETTLING_CHECKS = 4  # good checks before the misfit is taken for known; from then on it only creeps,
CREEPING_CHECKS, CREEP_PX = 4, 0.3  # by so little in so many, as a print grows out of the height at which it was found
SETTLING_REACH_PX, RESETTLING_CHECKS = 6, 2
UNTOLD_PX = 3.0  # what contours may be off while too few of them found an edge: as much as a band is ever widened by
CONTOUR_PX = 9  # contours, and what is beside them


class Misfit:
    """Of one view of one print.

    alignment : where the picture shows what is expected
    fitted    : whether contours of the print have told so; else it is where most of it is explained
    spread_px : how far most contours still lay from their edges, halo included, when last they told
    """

    def __init__(self) -> None:
        self.alignment = Alignment()
        self.fitted = False
        self.spread_px = UNTOLD_PX
        self._settled_at, self._crept_at = SETTLING_CHECKS, 0
        self._before: Alignment | None = None

    def stand_in(self, alignment: Alignment) -> None:
        """The camera seems to have moved, as the print alone tells: that is where the print is seen until its turn is found."""
        self._before, self.alignment = self._before or self.alignment, alignment

    def turn_is_found(self) -> None:
        """From now on the picture is turned back, so nothing must stand in for that: it would be taken out twice."""
        if self._before is not None:
            self.alignment, self._before = self._before, None

    def settle(
        self, good_checks: int, window: Window, wanted: np.ndarray, observed: np.ndarray, ignored: np.ndarray
    ) -> None:
        """Before the first good checks: find the misfit anew, as far off as may be; later, now and then, a little of it.

        good_checks : so far; window, wanted : of the expected mask, bool; observed, ignored : the whole picture's, uint8
        """
        if good_checks < self._settled_at:
            found = register(window, wanted, observed, ignored, SETTLING_REACH_PX)
            # what contours have told before is better than what one look without them suggests
            if found is not None and (found.share > 0 or not self.fitted):
                self.alignment = found.alignment.within(align.MOST_PX)
                self.fitted, self.spread_px = found.share > 0, _spread_px(found)
        elif good_checks % CREEPING_CHECKS == 0 and self._crept_at != good_checks:
            self._crept_at = good_checks
            top, left = window[0].start, window[1].start
            fitted = align.fit(wanted, left, top, observed > 0, ignored == 0, self.alignment)
            if fitted is not None:
                self.alignment = self.alignment.towards(fitted.alignment, CREEP_PX)

    def settled(self, good_checks: int) -> bool:
        """Whether it is known after so many, and only creeps."""
        return good_checks > self._settled_at

    def carried(self, matrix: np.ndarray) -> None:
        """The print is seen elsewhere now. matrix : (3, 3), new pixels from old ones"""
        self.alignment = self.alignment.carried(matrix)
        self._before = None if self._before is None else self._before.carried(matrix)

    def begin_anew(self, good_checks: int) -> None:
        """The print is expected where it was seen to be: what a better camera leaves is looked for anew."""
        self._settled_at, self._before = good_checks + RESETTLING_CHECKS, None
        self.alignment = replace(self.alignment, offset_px=(0.0, 0.0), shear_px=(0.0, 0.0, 0.0, 0.0))


def register(
    window: Window, wanted: np.ndarray, observed: np.ndarray, ignored: np.ndarray, reach_px: int
) -> align.Fit | None:
    """Where in the picture the print is, looked for as far as `reach_px` away; None where too little of it is seen.

    window, wanted : of the expected mask, bool; observed, ignored : the whole picture's, uint8
    """
    if not wanted.any():
        return None
    few = about(cv2.dilate(wanted.view(np.uint8), np.ones((CONTOUR_PX, CONTOUR_PX), np.uint8)).view(bool))
    wanted, observed, known = wanted[few], observed > 0, ignored == 0
    rows, columns = (slice(whole.start + part.start, whole.start + part.stop) for whole, part in zip(window, few))
    rim = ((max(reach_px - rows.start, 0), max(rows.stop + reach_px - observed.shape[0], 0)),
           (max(reach_px - columns.start, 0), max(columns.stop + reach_px - observed.shape[1], 0)))  # fmt: skip
    around = (
        slice(max(rows.start - reach_px, 0), rows.stop + reach_px),
        slice(max(columns.start - reach_px, 0), columns.stop + reach_px),
    )
    seen, sure = (np.pad(mask[around], rim, constant_values=False) for mask in (observed, known))
    start = align.about(wanted, columns.start, rows.start)
    offset = align.coarse(wanted, seen, sure, reach_px)
    start = replace(start, offset_px=(float(offset[0]), float(offset[1])))
    found = align.fit(wanted, columns.start, rows.start, observed, known, start)
    return found or align.Fit(start, 0.0, np.zeros(0), 0.0)


def _spread_px(found: align.Fit) -> float:
    """Within how many pixels most contours lie."""
    if not len(found.residual_px):
        return UNTOLD_PX
    return float(np.percentile(np.abs(found.residual_px), 90)) + max(found.halo_px, 0.0)
