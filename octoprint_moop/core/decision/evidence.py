"""What a frame says about the print: where matter is missing, where there is too much, and since when.

E alone mixes a camera that is a pixel off with a print that fails. So differences are weighed by what this print has
shown so far, pixel by pixel (`Memory`): matter that was seen in earlier checks and is gone is *lost*; matter that lies
where none was expected, and did not lie there while all was well, is *stray*; of the matter that the last layers should
have added, the *fresh*, the share that is seen is compared with what it was; and *barren* is what lies well inside the
fresh matter's outline and was never seen, which needs no past to be compared with.

Thresholding a picture errs in ways that a look at the picture itself does not. So lost, stray and barren pixels count
only where the picture bears them out: what is lost now looks more like the bare bed than like the matter that was seen
there, and what is stray doesn't look like what that pixel showed without it. A lamp that is dimmed passes neither test.

A calibration that is a pixel or two off shows from the first layer on and stays. `Memory` finds the displacement that
explains it (`align`) and the frame is laid upon the expected mask by it; a band about the expected edges is left out.
Where all that differs later vanishes once the whole picture is displaced, and the bed does not say that it stood still,
the camera was moved and not the print.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from ..expected.views import box_about
from .findings import Findings, Sight
from .memory import Memory
from .misfit import register
from .spots import Window, disc
from .weighing import AROUND_PX, weigh

# what calibration and segmentation may be off without a word; JPEG alone blurs colours by as much, however small the picture
TOLERANCE_PX = 2.0  # at up to 640 pixels across
MOVED_LEAST_PX = 25  # less matter out of place than this needs no explanation
MOVED_REACH_PX, BED_BEGINS_PX = 32.0, 12.0  # at up to 640 pixels across
MOVED_LEFT, PIECE_PX = 0.25, 60


def find(sight: Sight, memory: Memory) -> Findings:
    """Weigh one frame against what must be seen and what was seen; `Memory.learn` is for good checks.

    While the memory is still settling, the calibration's misfit is looked for first: what moving the whole picture by a
    few pixels explains at the first layers is no failure of the print.
    """
    window, around = close_to(sight), sight.expected.surroundings
    # contours that a head hides find no edge; all that lies in its reach must not be left out for that
    ignored = sight.ignored if sight.expected.volume is None else sight.ignored & cv2.bitwise_not(sight.expected.volume)
    memory.settle(window, sight.expected.mask[window] > 0, sight.observed, ignored)
    alignment = memory.misfit.alignment
    findings = weigh(sight, memory, around if memory.wants_surroundings else window, alignment)
    if _out_of_place_px(findings) < MOVED_LEAST_PX:
        return findings
    if findings.window != around:
        findings = weigh(sight, memory, around, alignment)
    return _moved_camera(sight, memory, findings) or findings


def _moved_camera(sight: Sight, memory: Memory, findings: Findings) -> Findings | None:
    """What differs once the whole picture is taken to have moved; None where that is not what has happened.

    A print that slid on the bed leaves the bed where it was. Where the bed is too plain to tell, several pieces do not
    slide alike; and one that moved in a view of which nothing tells where the camera stands is given the benefit of the
    doubt: what is laid next shows whether it was the print.
    """
    window, before = findings.window, memory.misfit.alignment
    finer = sight.finer
    reach_px = int(MOVED_REACH_PX * finer)
    # what shines like filament where the head may be says little of the print, but enough of where all of it is
    ignored = sight.ignored & cv2.bitwise_not(sight.expected.head & sight.observed)
    found = register(window, findings.wanted, sight.observed, ignored, reach_px)
    if found is None:
        return None
    points = np.argwhere(findings.wanted)[::17, ::-1] + [window[1].start, window[0].start]
    moved_px = float(np.sqrt(np.mean(np.sum((found.alignment.at(points) - before.at(points)) ** 2, axis=1))))
    if moved_px < 0.5:
        return None
    explained = weigh(sight, memory, window, found.alignment)
    if _out_of_place_px(explained) < MOVED_LEFT * _out_of_place_px(findings):
        off_print = cv2.dilate(sight.expected.complete[window], disc(BED_BEGINS_PX * finer)) == 0
        off_print = off_print & findings.known & explained.known
        bed_moved = memory.bed_moved(window, findings.look, explained.look, off_print)
        unsure = _pieces(findings.wanted) > 1 or not sight.sure
        if bed_moved or (bed_moved is None and unsure):
            memory.misfit.stand_in(found.alignment)
            return replace(explained, moved_px=moved_px)
    return None


def _out_of_place_px(findings: Findings) -> int:
    return findings.whole.lost_px + findings.whole.stray_px + findings.whole.rim_px


def _pieces(wanted: np.ndarray) -> int:
    """How many separate things are seen."""
    joined = cv2.dilate(wanted.astype(np.uint8), disc(2))
    _, _, stats, _ = cv2.connectedComponentsWithStats(joined)
    return int(np.count_nonzero(stats[1:, cv2.CC_STAT_AREA] >= PIECE_PX))


def close_to(sight: Sight) -> Window:
    """Rows and columns of all that is expected and all that is seen: where anything can be found, if all is well."""
    margin = round(AROUND_PX * sight.finer)
    seen, around = box_about(sight.expected.complete | sight.observed, margin), sight.expected.surroundings
    rows, columns = (slice(max(one.start, other.start), min(one.stop, other.stop)) for one, other in zip(seen, around))
    return rows, columns
