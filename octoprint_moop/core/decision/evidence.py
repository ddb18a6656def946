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

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np

from ..expected.views import Expected, PrintMap, box_about
from . import align
from .counts import WHOLE, WINDOWS, Counter, Evidence
from .memory import Memory, planes
from .misfit import register
from .shade import is_shaded_matter
from .spots import Window, about, disc, near_to, placed, spots_of, within, without_hollows, without_specks

# what calibration and segmentation may be off without a word; JPEG alone blurs colours by as much, however small the picture
TOLERANCE_PX = 2.0  # at up to 640 pixels across
FIRST_LAYERS = 2
ALIKE_RATIO, SEEN_RATIO, SHADE_PX = 0.15, 0.3, 8.0
RIM_PX = 1.0
REACH_RATIO = 0.07  # of the print's width, and of its width or height: how far off stray matter may begin
LOOSE_PX = 20.0  # at up to 640 pixels across: what comes so near to loose matter is more of it
HIDING_PX, AROUND_PX, HIDING_CHANGE, HIDING_RATIO = 60, 25, 9, 0.3
BARED_RATIO, HIDING_BARED_RATIO = 0.8, 0.5
UNMOVED_RATIO = 0.75  # of what stands, that looks as it did; at its edges what was new has grown since
TORN_RATIO = 0.5  # of what has gone, from torn bodies,
TORN_LEAST = 0.15  # of which at least so much has gone, and as much stands
UNTOLD_RATIO, STRAY_RATIO = 0.3, 0.15  # of what stood, and against what has gone
ALIGNED_PX = 0.25  # a displacement of less is not worth moving pictures for
MOVED_LEAST_PX = 25  # less matter out of place than this needs no explanation
MOVED_REACH_PX, UNSURE_PX, BED_BEGINS_PX = 32.0, 2.5, 12.0  # at up to 640 pixels across
MOVED_LEFT, PIECE_PX = 0.25, 60
LAID_TIMES, LOST_TIMES = (
    1.5,
    6.0,
)  # strands stand up and a print that lies shows another side: by so much more may be seen


@dataclass(frozen=True, eq=False)
class Sight:
    """One frame made comparable, and what must be seen in it. Pictures are (H, W) or (H, W, 3) uint8.

    frame_bgr : steadied and levelled; observed : 255 where filament is seen; ignored : 255 where nothing can be said
    layer     : the last layer of which something lies
    finer     : a length in a picture 640 pixels across is so many times longer in this one
    laid_px   : tells how many pixels would be covered by what was laid since all was last well, line beside line
    sure      : the view as a whole has told where the camera stands
    """

    frame_bgr: np.ndarray
    observed: np.ndarray
    ignored: np.ndarray
    expected: Expected
    print_map: PrintMap
    layer: int
    tolerance_px: float
    finer: float = 1.0
    laid_px: Callable[[], float] = lambda: math.inf
    sure: bool = True


@dataclass(frozen=True, eq=False)
class Findings:
    """The evidence of the whole (first) and of each object, and the pictures behind it.

    All pictures are bool, of the shape of `window`: rows and columns of the expected mask about the print.

    wanted : expected now; look : (3, h, w) uint8, the frame aligned, as the memory keeps it; seen, known : observed, and
    what can be said anything of, aligned; standing : matter seen in earlier checks; lost, stray : see the module; rim : as
    stray, within the band about expected edges; unseen : fresh matter of the last layers that is not seen; hidden_px : so
    much of what stood there looks neither like matter nor like the bare bed now; untold_px : a good part of what stood is
    not seen, so much of it, and nothing bears out that it has gone, 0 where less; loose : matter that has grown from what
    the user went on with; moved_px : by how much the whole picture has just moved
    """

    window: Window
    wanted: np.ndarray
    look: np.ndarray
    seen: np.ndarray
    known: np.ndarray
    standing: np.ndarray
    lost: np.ndarray
    stray: np.ndarray
    rim: np.ndarray
    unseen: np.ndarray
    hidden_px: int
    untold_px: int
    scopes: tuple[Evidence, ...]
    loose: np.ndarray
    moved_px: float = 0.0

    @property
    def whole(self) -> Evidence:
        return self.scopes[0]


def find(sight: Sight, memory: Memory) -> Findings:
    """Weigh one frame against what must be seen and what was seen; `Memory.learn` is for good checks.

    While the memory is still settling, the calibration's misfit is looked for first: what moving the whole picture by a
    few pixels explains at the first layers is no failure of the print.
    """
    window, around = close_to(sight), sight.expected.surroundings
    # contours that a head hides find no edge; all that lies in its reach must not be left out for that
    ignored = sight.ignored if sight.expected.volume is None else sight.ignored & cv2.bitwise_not(sight.expected.volume)
    memory.settle(window, sight.expected.mask[window] > 0, sight.observed, ignored)
    findings = _weigh(sight, memory, around if memory.wants_surroundings else window)
    if _out_of_place_px(findings) < MOVED_LEAST_PX:
        return findings
    if findings.window != around:
        findings = _weigh(sight, memory, around)
    return _moved_camera(sight, memory, findings) or findings


def _moved_camera(sight: Sight, memory: Memory, findings: Findings) -> Findings | None:
    """What differs once the whole picture is taken to have moved; None where that is not what has happened.

    A print that slid on the bed leaves the bed where it was. Where the bed is too plain to tell, several pieces do not
    slide alike; and one that moved by hardly more than the tolerance, or in a view of which nothing tells where the camera
    stands, is given the benefit of the doubt: what is laid next shows whether it was the print.
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
    memory.misfit.alignment = found.alignment
    explained = _weigh(sight, memory, window)
    if _out_of_place_px(explained) < MOVED_LEFT * _out_of_place_px(findings):
        off_print = cv2.dilate(sight.expected.complete[window], disc(BED_BEGINS_PX * finer)) == 0
        off_print = off_print & findings.known & explained.known
        bed_moved = memory.bed_moved(window, findings.look, explained.look, off_print)
        unsure = moved_px < UNSURE_PX * finer or _pieces(findings.wanted) > 1 or not sight.sure
        if bed_moved or (bed_moved is None and unsure):
            return replace(explained, moved_px=moved_px)
    memory.misfit.alignment = before
    return None


def _out_of_place_px(findings: Findings) -> int:
    return findings.whole.lost_px + findings.whole.stray_px + findings.whole.rim_px


def _pieces(wanted: np.ndarray) -> int:
    """How many separate things are seen."""
    joined = cv2.dilate(wanted.astype(np.uint8), disc(2))
    _, _, stats, _ = cv2.connectedComponentsWithStats(joined)
    return int(np.count_nonzero(stats[1:, cv2.CC_STAT_AREA] >= PIECE_PX))


def _aligned(sight: Sight, alignment: align.Alignment, window: Window) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The look, observed and ignored where the expected mask has `window`."""
    if alignment.most_px < ALIGNED_PX:
        return planes(sight.frame_bgr[window]), sight.observed[window], sight.ignored[window]
    rows, columns = window
    # all that is looked at, and a rim for what is displaced into it; OpenCV is quickest with four channels at once
    rim = int(alignment.most_px) + 2
    top, left = max(rows.start - rim, 0), max(columns.start - rim, 0)
    near = slice(top, rows.stop + rim), slice(left, columns.stop + rim)
    mixed = np.empty((*sight.observed[near].shape, 4), np.uint8)
    cv2.mixChannels([sight.frame_bgr[near], sight.observed[near]], [mixed], [0, 0, 1, 1, 2, 2, 3, 3])
    matrix, size = (
        alignment.inverse_map(columns.start, rows.start),
        (columns.stop - columns.start, rows.stop - rows.start),
    )
    smooth, plain = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP, cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP
    from_near = matrix - [[0, 0, left], [0, 0, top]]
    mixed = cv2.warpAffine(mixed, from_near, size, flags=smooth, borderMode=cv2.BORDER_REPLICATE)
    ignored = cv2.warpAffine(sight.ignored, matrix, size, flags=plain, borderMode=cv2.BORDER_CONSTANT, borderValue=255)
    observed = cv2.threshold(cv2.extractChannel(mixed, 3), 127, 255, cv2.THRESH_BINARY)[1]
    return planes(mixed), observed, ignored


def _weigh(sight: Sight, memory: Memory, window: Window) -> Findings:
    look, observed_u8, ignored = _aligned(sight, memory.misfit.alignment, window)
    wanted_u8 = sight.expected.mask[window]
    wanted, observed, known = wanted_u8 > 0, observed_u8 > 0, ignored == 0
    # no narrower than what the print's contours have shown of camera and segmentation
    edge = disc(min(max(sight.tolerance_px, memory.misfit.spread_px + 1.0), 2 * sight.tolerance_px))
    near_wanted = cv2.dilate(wanted_u8, edge) > 0
    near_observed = cv2.dilate(observed_u8, disc(1.5)) > 0
    # a lone line of a bead's width is seen or not as the light falls: only what is wider can be lost
    wide = cv2.morphologyEx(wanted_u8, cv2.MORPH_OPEN, disc(sight.tolerance_px)) > 0
    standing = memory.standing(window) & wide & known
    lost = standing & ~near_observed
    outside = observed & known & ~memory.chronic(window)
    stray = outside & ~near_wanted
    rim = outside & near_wanted & (cv2.dilate(wanted_u8, disc(RIM_PX)) == 0)
    layer_of = sight.print_map.layer[window]
    recent = wanted & known & ~memory.given_up(window) & (layer_of > sight.layer - WINDOWS[-1])
    # the first layer covers so much at once that shares with it say nothing of the next
    later = recent & (layer_of > 0)
    # segmentation that expects matter may see it in a shadow: what has not changed at all has not come either
    unchanged = memory.looks_unchanged(window, look, recent & observed)
    # what the first layer covers has told by its second successor whether it came
    # where nothing is seen nothing can be fitted: then the camera is believed
    inside = cv2.erode(wanted_u8, edge if memory.misfit.fitted else disc(sight.tolerance_px)) > 0
    deep = (recent if sight.layer <= FIRST_LAYERS else later) & inside
    barren = unchanged | memory.looks_bare(window, look, deep & ~near_observed & ~memory.ever_seen(window))
    barren &= deep
    # contours that are known to be off by more than a pixel hide a layer's height
    off_px = round(memory.misfit.spread_px - 0.5) if memory.misfit.fitted else 0
    covered = observed if off_px < 1 else cv2.dilate(observed_u8, disc(off_px)) > 0
    # what was seen in a good check has come; whether it has gone again is asked above
    unseen = (unchanged & later) | memory.looks_bare(window, look, later & ~covered & ~memory.ever_seen(window))
    bed, has_bare = known & ~observed & ~near_wanted, memory.has_bare(window)
    if (unseen | barren).any():
        lies = observed & wanted & ~unchanged
        if is_shaded_matter(look, memory.bare(window), (unseen | barren) & has_bare, lies, bed & has_bare):
            unseen, barren = np.zeros_like(unseen), np.zeros_like(barren)
    stray, rim = memory.looks_new(window, look, stray), memory.looks_new(window, look, rim)
    # dark filament and its own shadow look alike
    rim &= ~memory.looks_shaded(window, look, rim)
    if stray.any():
        stray &= ~(memory.looks_shaded(window, look, stray) & within(wanted_u8, SHADE_PX * sight.finer))
        stray = near_to(wanted_u8, without_specks(stray), _reach_px(sight)) & ~_reaching_in(sight, window)
    gone, gone_px, hidden_px = lost, np.count_nonzero(lost), 0
    if gone_px:
        hidden_px = _hidden_px(memory, window, look, lost, stray, bed, standing)
        lost = without_hollows(without_specks(memory.looks_bare(window, look, lost)), wanted_u8)
        if lost.any():
            lost &= ~memory.looks_unlike_bed(window, look, lost, bed)
        if np.count_nonzero(lost) >= HIDING_PX and memory.shines(window, look, lost, bed):
            lost = np.zeros_like(lost)
    if stray.any():
        stray = _could_have_come(stray, sight.laid_px(), int(np.count_nonzero(lost)))
    loose = memory.loose(window)
    if loose.any():
        loose_u8 = np.where(loose, np.uint8(255), np.uint8(0))
        loose = near_to(loose_u8, stray | rim, LOOSE_PX * sight.finer)
        stray, rim = stray & ~loose, rim & ~loose
        lost &= ~within(loose_u8, LOOSE_PX * sight.finer)  # strands hide and show what they hang before
    alike = _could_be_matter(lost | unseen | barren, wanted, observed & wanted & ~unchanged, look, memory.bare(window))
    lost, unseen, barren = lost & ~alike, unseen & ~alike, barren & ~alike
    untold_px = int(gone_px - np.count_nonzero(lost))
    # nothing bears out that so much has gone: what is fresh may be hidden too
    much = untold_px > UNTOLD_RATIO * np.count_nonzero(standing)
    if not much:
        untold_px = 0
    elif np.count_nonzero(stray) > STRAY_RATIO * untold_px or (
        memory.all_bare(window, look, gone, bed) and not memory.shines(window, look, gone, bed)
    ):  # it lies beside its place, or all pixels of that together show the bed
        untold_px, lost = 0, lost | without_specks(gone)
    # lines of single pixels that such contours leave are named, where that is asked, and not counted
    missed = unseen
    if off_px:
        missed = cv2.morphologyEx(unseen.view(np.uint8), cv2.MORPH_OPEN, np.ones((2, 2), np.uint8)) > 0
    scopes = _count(
        sight, window, wanted, observed, known, standing, lost, stray, rim, later, missed, deep, barren, inside
    )
    return Findings(
        window, wanted, look, observed, known, standing, lost, stray, rim, unseen, hidden_px, untold_px, scopes, loose
    )


def _reaching_in(sight: Sight, window: Window) -> np.ndarray:
    """bool: matter in the view that hangs together with its rim, and not with the print: it has come from outside."""
    labels, areas_px = spots_of(sight.observed > 0)
    at_rim, with_print = np.zeros((2, len(areas_px)), bool)
    for side in (labels[0], labels[-1], labels[:, 0], labels[:, -1]):
        at_rim[side] = True
    with_print[labels[sight.expected.mask > 0]] = True
    outside = at_rim & ~with_print
    outside[0] = False
    return outside[labels[window]]


def _could_have_come(stray: np.ndarray, laid_px: float, lost_px: int) -> np.ndarray:
    """The stray spots without those that are larger than all that can have come there: what was laid since all was well,
    and what has gone from its place. A sleeve or a spool of the filament's colour is no matter of the print's."""
    most_px = LAID_TIMES * laid_px + LOST_TIMES * lost_px
    if np.count_nonzero(stray) <= most_px:
        return stray
    few = about(stray)
    labels, areas_px = spots_of(stray[few])
    return placed(stray, few, (areas_px <= most_px)[labels])


def _could_be_matter(
    where: np.ndarray, wanted: np.ndarray, matter: np.ndarray, look: np.ndarray, bare: np.ndarray
) -> np.ndarray:
    """bool: of the pixels `where`, those under which the bed looks as a good part of the matter that is seen does.

    Whether filament of the bed's own shade has come or is gone cannot be seen: a side wall that comes into view as a
    print grows may look just like it. Looks are counted in steps of 16 grey levels, with the neighbouring steps.
    """
    matter_px = np.count_nonzero(matter)
    if not where.any() or matter_px < SEEN_RATIO * np.count_nonzero(wanted):
        return np.zeros_like(where)  # next to nothing is seen, and what there is may be the bed
    near = cv2.calcHist([*look], [0, 1, 2], matter.view(np.uint8), [16, 16, 16], [0, 256, 0, 256, 0, 256])
    for _ in range(3):  # along one axis after the other
        near = cv2.boxFilter(near.reshape(16, 256), -1, (1, 3), normalize=False, borderType=cv2.BORDER_CONSTANT)
        near = near.reshape(16, 16, 16).transpose(1, 2, 0).copy()
    blue, green, red = (plane[where] >> 4 for plane in bare)
    alike = np.zeros_like(where)
    alike[where] = near[blue, green, red] > ALIKE_RATIO * matter_px
    return alike


def _hidden_px(
    memory: Memory, window: Window, look: np.ndarray, gone: np.ndarray, stray: np.ndarray, bed: np.ndarray,
    standing: np.ndarray,
) -> int:  # fmt: skip
    """How much of the matter that is seen no more has probably only been hidden.

    What hides the print looks like neither print nor bed, and hides some of the bed about it; but where the print has
    come off, matter lies where it did not, whatever its shadow does to the bed. And a part comes off as a whole: of what is
    seen to end in its midst, with the rest in its place and as it was, the other half is behind something.
    """
    gone_px = np.count_nonzero(gone)
    if gone_px < HIDING_PX or np.count_nonzero(stray) > STRAY_RATIO * gone_px:
        return 0
    if gone_px > UNTOLD_RATIO * np.count_nonzero(standing):
        rest = standing & ~gone
        as_it_was = np.count_nonzero(rest & ~memory.looks_otherwise(window, look, rest))
        if as_it_was > UNMOVED_RATIO * np.count_nonzero(rest) and _torn_px(gone, standing) > TORN_RATIO * gone_px:
            return int(gone_px)
    about = bed & (cv2.dilate(gone.astype(np.uint8), disc(AROUND_PX)) > 0)
    changed = memory.bed_changed(window, look, about, HIDING_CHANGE)
    about_px = np.count_nonzero(about)
    # where the very bed is seen instead, it takes most of what is around to say that something else is
    bared = np.count_nonzero(memory.looks_bare(window, look, gone)) >= BARED_RATIO * gone_px
    most_px = HIDING_BARED_RATIO * about_px if bared else min(HIDING_RATIO * about_px, float(gone_px))
    if np.count_nonzero(changed) > most_px:
        # what segmentation misses and the picture still shows is not hidden
        return int(gone_px - np.count_nonzero(memory.looks_covered(window, look, gone)))
    return int(np.count_nonzero(memory.looks_strange(window, look, gone)))


def _torn_px(gone: np.ndarray, standing: np.ndarray) -> int:
    """How many pixels have gone from bodies, connected ones, of which a good part is seen where it stood."""
    labels, areas_px = spots_of(standing)
    gone_px = np.bincount(labels[gone], minlength=len(areas_px))
    torn = (gone_px > TORN_LEAST * areas_px) & (gone_px < (1 - TORN_LEAST) * areas_px)
    return int(gone_px[1:][torn[1:]].sum())


def _count(
    sight: Sight, window: Window, wanted: np.ndarray, observed: np.ndarray, known: np.ndarray, standing: np.ndarray,
    lost: np.ndarray, stray: np.ndarray, rim: np.ndarray, later: np.ndarray, unseen: np.ndarray, deep: np.ndarray,
    barren: np.ndarray, inside: np.ndarray,
) -> tuple[Evidence, ...]:  # fmt: skip
    print_map = sight.print_map
    scopes = [WHOLE, *range(print_map.objects)] if print_map.objects > 1 else [WHOLE]
    complete = sight.expected.complete[window] > 0
    unsaid, extra = wanted & ~observed & known, observed & ~wanted & known
    edge = wanted & (cv2.erode(wanted.view(np.uint8), np.ones((3, 3), np.uint8)) == 0)
    own = Counter(print_map.owner[window], len(scopes), complete)
    near = Counter(print_map.nearest[window], len(scopes), extra | stray | rim)
    figures = {
        **own(
            expected_px=wanted & known, total_px=complete & known, dim_px=inside & unsaid, standing_px=standing,
            lost_px=lost, edge_px=edge, unseen_px=unseen, deep_px=deep, barren_px=barren, xor_px=unsaid,
        ),
        **near(stray_px=stray, rim_px=rim, extra_px=extra),
    }  # fmt: skip
    figures["xor_px"] += figures.pop("extra_px")
    fresh = own.younger(later, ~unseen, print_map.layer[window], sight.layer)
    return tuple(
        Evidence(scope, **{name: int(counts[n]) for name, counts in figures.items()}, fresh=fresh[n])
        for n, scope in enumerate(scopes)
    )


def close_to(sight: Sight) -> Window:
    """Rows and columns of all that is expected and all that is seen: where anything can be found, if all is well."""
    margin = round(AROUND_PX * sight.finer)
    seen, around = box_about(sight.expected.complete | sight.observed, margin), sight.expected.surroundings
    rows, columns = (slice(max(one.start, other.start), min(one.stop, other.stop)) for one, other in zip(seen, around))
    return rows, columns


def _reach_px(sight: Sight) -> float:
    """How far off the print stray matter may begin."""
    _, _, width, height = cv2.boundingRect(sight.expected.complete)
    return REACH_RATIO * (width + max(width, height)) + 3 * sight.finer
