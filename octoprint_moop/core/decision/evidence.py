"""What a frame says about the print: where matter is missing, where there is too much, and since when.

E alone mixes a camera that is a pixel off with a print that fails. So differences are weighed by what this print has
shown so far, pixel by pixel (`Memory`): matter that was seen in earlier checks and is gone is *lost*; matter that lies
where none was expected, and did not lie there while all was well, is *stray*; of the matter that the last layers should
have added, the *fresh*, the share that is seen is compared with what it was; and *barren* is what lies well inside the
fresh matter's outline and was never seen, which needs no past to be compared with.

Thresholding a picture errs in ways that a look at the picture itself does not. So lost, stray and barren pixels count
only where the picture bears them out: what is lost now looks more like the bare bed than like the matter that was seen
there, and what is stray doesn't look like what that pixel showed without it. A lamp that is dimmed passes neither test.

A calibration that is a pixel or two off shows from the first layer on and stays. `Memory` finds the whole-pixel offset
that explains most of it and looks for the print there; a band of `tolerance_px` about the expected edges is left out.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from ..expected.views import Expected, PrintMap
from .memory import MOST_MISFIT_PX, Memory

WINDOWS = (1, 2, 4, 8)  # layers back over which fresh matter is counted
SPECK_PX = 6
RIM_PX = 1.0
REACH_RATIO = 0.07  # of the looked-at window's width: how far off the print stray matter may begin
HIDING_PX, AROUND_PX, HIDING_CHANGE, HIDING_RATIO = 60, 25, 9.0, 0.3
WHOLE = -1

Window = tuple  # (slice, slice): rows and columns


@dataclass(frozen=True, eq=False)
class Sight:
    """One frame made comparable, and what must be seen in it. Pictures are (H, W) or (H, W, 3) uint8.

    frame_bgr : steadied and levelled; observed : 255 where filament is seen; ignored : 255 where nothing can be said
    layer     : the last layer of which something lies
    """

    frame_bgr: np.ndarray
    observed: np.ndarray
    ignored: np.ndarray
    expected: Expected
    print_map: PrintMap
    layer: int
    tolerance_px: float


@dataclass(frozen=True)
class Evidence:
    """Pixel counts of one scope: one labelled object, or the WHOLE print.

    expected_px, total_px : of the expected mask now and of the complete one
    standing_px : established matter that was seen in earlier checks; lost_px : of it, what is seen no more
    stray_px    : matter where none is expected, new since all was well
    rim_px      : the same within the tolerance band, but not right at the expected edge
    unseen_px   : matter of the last layers that is not seen and looks bare
    deep_px     : well inside what the last layers cover; barren_px : of it, what was never seen
    fresh       : for each of WINDOWS, pixels that its layers newly cover, and how many of them are seen
    """

    object_id: int
    expected_px: int
    total_px: int
    standing_px: int
    lost_px: int
    stray_px: int
    rim_px: int
    unseen_px: int
    deep_px: int
    barren_px: int
    xor_px: int
    fresh: tuple[tuple[int, int], ...]

    @property
    def error_ratio(self) -> float:
        return self.xor_px / max(self.total_px, 1)


@dataclass(frozen=True, eq=False)
class Findings:
    """The evidence of the whole (first) and of each object, and the pictures behind it.

    All pictures are bool, of the shape of `window`: rows and columns of the expected mask about the print.

    wanted : expected now; seen : observed, moved by the misfit; lost, stray : see the module; unseen : fresh matter of
    the last layers that is not seen; standing : matter seen in earlier checks; hidden_px : so much of what stood there
    looks neither like matter nor like the bare bed now
    """

    window: Window
    wanted: np.ndarray
    seen: np.ndarray
    standing: np.ndarray
    lost: np.ndarray
    stray: np.ndarray
    unseen: np.ndarray
    hidden_px: int
    scopes: tuple[Evidence, ...]

    @property
    def whole(self) -> Evidence:
        return self.scopes[0]


def find(sight: Sight, memory: Memory) -> Findings:
    """Weigh one frame against what must be seen and what was seen; `Memory.learn` is for good checks.

    While the memory is still settling, the calibration's misfit is looked for first: what moving the whole picture by a
    few pixels explains at the first layers is no failure of the print.
    """
    window = about_print(sight.expected.complete)
    memory.settle(window, sight.expected.mask[window] > 0, sight.observed, sight.ignored)
    there = memory.moved(window)
    wanted_u8, observed_u8 = sight.expected.mask[window], sight.observed[there]
    wanted, observed, known = wanted_u8 > 0, observed_u8 > 0, sight.ignored[there] == 0
    edge = disc(sight.tolerance_px)
    near_wanted = cv2.dilate(wanted_u8, edge) > 0
    near_observed = cv2.dilate(observed_u8, disc(1.5)) > 0
    # a lone line of a bead's width is seen or not as the light falls: only what is wider can be lost
    wide = cv2.morphologyEx(wanted_u8, cv2.MORPH_OPEN, edge) > 0
    standing = memory.standing(there) & wide & known
    lost = standing & ~near_observed
    outside = observed & known & ~memory.chronic(there)
    stray = outside & ~near_wanted
    rim = outside & near_wanted & (cv2.dilate(wanted_u8, disc(RIM_PX)) == 0)
    layer_of = sight.print_map.layer[window]
    recent = wanted & known & ~memory.given_up(there) & (layer_of > sight.layer - WINDOWS[-1])
    later = recent & (
        layer_of > 0
    )  # the first layer covers so much at once that shares with it say nothing of the next
    look = cv2.blur(sight.frame_bgr[there], (3, 3))
    # segmentation that expects matter may see it in a shadow: what has not changed at all has not come either
    unchanged = memory.looks_unchanged(there, look, recent & observed)
    deep = recent & (cv2.erode(wanted_u8, edge) > 0)
    barren = unchanged | memory.looks_bare(there, look, deep & ~near_observed & ~memory.ever_seen(there))
    barren &= deep
    unseen = (unchanged & later) | memory.looks_bare(there, look, later & ~observed)
    stray = near_to(wanted_u8, without_specks(memory.looks_new(there, look, stray)), REACH_RATIO * wanted.shape[1])
    hidden_px = _hidden_px(memory, there, look, lost, stray, known & ~observed & ~near_wanted)
    lost = without_specks(memory.looks_bare(there, look, lost))
    rim = memory.looks_new(there, look, rim)
    scopes = _count(sight, window, wanted, observed, known, standing, lost, stray, rim, later, unseen, deep, barren)
    return Findings(window, wanted, observed, standing, lost, stray, unseen, hidden_px, scopes)


def _hidden_px(
    memory: Memory, there: Window, look: np.ndarray, gone: np.ndarray, stray: np.ndarray, bed: np.ndarray
) -> int:
    """How much of the matter that is seen no more has probably only been hidden.

    What hides the print looks like neither print nor bed, and hides some of the bed about it; but where the print has
    come off, matter lies where it did not, whatever its shadow does to the bed.
    """
    gone_px = np.count_nonzero(gone)
    if gone_px < HIDING_PX or np.count_nonzero(stray) > 0.15 * gone_px:
        return 0
    about = bed & (cv2.dilate(gone.astype(np.uint8), disc(AROUND_PX)) > 0)
    changed = memory.looks_new(there, look, about, HIDING_CHANGE, unknown=False)
    if np.count_nonzero(changed) > min(HIDING_RATIO * np.count_nonzero(about), gone_px):
        return int(gone_px)
    return int(np.count_nonzero(memory.looks_strange(there, look, gone)))


def _count(
    sight: Sight, window: Window, wanted: np.ndarray, observed: np.ndarray, known: np.ndarray, standing: np.ndarray,
    lost: np.ndarray, stray: np.ndarray, rim: np.ndarray, later: np.ndarray, unseen: np.ndarray, deep: np.ndarray,
    barren: np.ndarray,
) -> tuple[Evidence, ...]:  # fmt: skip
    print_map = sight.print_map
    scopes = [WHOLE, *range(print_map.objects)] if print_map.objects > 1 else [WHOLE]
    own = _Counter(print_map.owner[window], len(scopes))
    near = _Counter(print_map.nearest[window], len(scopes))
    age = sight.layer - print_map.layer[window]
    figures = {
        "expected_px": own(wanted & known),
        "total_px": own((sight.expected.complete[window] > 0) & known),
        "standing_px": own(standing),
        "lost_px": own(lost),
        "stray_px": near(stray),
        "rim_px": near(rim),
        "unseen_px": own(unseen),
        "deep_px": own(deep),
        "barren_px": own(barren),
        "xor_px": own(wanted & ~observed & known) + near(observed & ~wanted & known),
    }
    fresh = []
    for layers in WINDOWS:
        new = later & (age < layers)
        fresh.append((own(new), own(new & ~unseen)))
    return tuple(
        Evidence(
            scope,
            **{name: int(counts[n]) for name, counts in figures.items()},
            fresh=tuple((int(new[n]), int(seen[n])) for new, seen in fresh),
        )
        for n, scope in enumerate(scopes)
    )


class _Counter:
    """Counts a mask's pixels for the whole print and, by whose pixels they are, for each object: (scopes,) int64."""

    def __init__(self, owner: np.ndarray, scopes: int) -> None:
        self._owner, self._scopes = owner, scopes

    def __call__(self, mask: np.ndarray) -> np.ndarray:
        counts = np.zeros(self._scopes, np.int64)
        counts[0] = np.count_nonzero(mask)
        if self._scopes > 1 and counts[0]:
            owners = self._owner[mask]
            counts[1:] = np.bincount(owners[owners >= 0], minlength=self._scopes - 1)[: self._scopes - 1]
        return counts


def about_print(complete: np.ndarray) -> Window:
    """Rows and columns about the complete print, half its size around, that the misfit cannot push out of the picture."""
    height, width = complete.shape
    x, y, w, h = cv2.boundingRect(complete)
    margin = max(w, h) // 2 + 24
    rim = MOST_MISFIT_PX
    return (
        slice(max(y - margin, rim), max(min(y + h + margin, height - rim), rim + 1)),
        slice(max(x - margin, rim), max(min(x + w + margin, width - rim), rim + 1)),
    )


def near_to(wanted: np.ndarray, mask: np.ndarray, reach_px: float) -> np.ndarray:
    """The mask's spots that come as near to the expected mask (uint8): what has to do with the print begins at it."""
    if not mask.any() or not wanted.any():
        return mask
    near = cv2.distanceTransform(cv2.bitwise_not(wanted), cv2.DIST_L2, 3) < reach_px
    _, labels = cv2.connectedComponents(mask.astype(np.uint8), connectivity=8)
    keep = np.zeros(labels.max() + 1, bool)
    keep[labels[near & mask]] = True
    return keep[labels] & mask


def disc(radius_px: float) -> np.ndarray:
    """A round structuring element, uint8."""
    side = 2 * int(np.ceil(radius_px)) + 1
    y, x = np.mgrid[:side, :side] - side // 2
    return (x * x + y * y <= radius_px * radius_px + 0.5).astype(np.uint8)


def without_specks(mask: np.ndarray, least_px: int = SPECK_PX) -> np.ndarray:
    """The mask without spots of fewer pixels: noise comes in specks, strands do not."""
    if np.count_nonzero(mask) < least_px:
        return np.zeros_like(mask)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=8)
    keep = stats[:, cv2.CC_STAT_AREA] >= least_px
    keep[0] = False
    return keep[labels]
