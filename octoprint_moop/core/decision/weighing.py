"""One frame weighed against what must be seen and what was seen: which pixels are fresh, stray, lost. See `evidence`."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from .align import Alignment
from .contours import LEAST_SUNK
from .counts import WHOLE, WINDOWS, Counter, Evidence
from .coverage import coverage
from .findings import Findings, Sight
from .grain import lacks_grain
from .memory import Memory, planes
from .shade import is_shaded_matter
from .spots import Window, about, disc, near_to, placed, spots_of, within, without_hollows, without_specks

FIRST_LAYERS = 2
ALIKE_RATIO, SEEN_RATIO, SHADE_PX = 0.15, 0.3, 8.0
RIM_PX = 1.0
BARED_PX = 2.0  # about contour that has come inwards
REACH_RATIO = 0.07  # of the print's width, and of its width or height: how far off stray matter may begin
LOOSE_PX = 20.0  # at up to 640 pixels across: what comes so near to loose matter is more of it
HIDING_PX, AROUND_PX, HIDING_CHANGE, HIDING_RATIO = 60, 25, 9, 0.3
BARED_RATIO, HIDING_BARED_RATIO = 0.8, 0.5
UNMOVED_RATIO = 0.75  # of what stands, that looks as it did; at its edges what was new has grown since
TORN_RATIO = 0.5  # of what has gone, from torn bodies,
TORN_LEAST = 0.15  # of which at least so much has gone, and as much stands
TOUCHING_PX = 4.0  # at any size: distances are measured in fours
SMALL_PX = 80  # at up to 640 pixels across
PLAIN_RATIO = 0.05  # of the complete print; where more is lost and stray, nobody asks how contours have moved
UNTOLD_RATIO, STRAY_RATIO = 0.3, 0.15  # of what stood, and against what has gone
ALIGNED_PX = 0.25  # a displacement of less is not worth moving pictures for
# strands stand up and a print that lies shows another side: by so much more may be seen
LAID_TIMES, LOST_TIMES = 1.5, 6.0


def weigh(sight: Sight, memory: Memory, window: Window, alignment: Alignment) -> Findings:
    """What a frame shows in a window once it is laid upon the expected mask by `alignment`.

    The order is part of the rule: what is stray tells whether what is lost is hidden; what has gone, how much may be stray;
    and loose matter, and matter that looks like the bed, excuse what is left.
    """
    scene = _Scene.of(sight, memory, window, alignment)
    fresh = _fresh(scene)
    stray, rim = _stray(scene)
    lost, hidden_px = _lost(scene, stray)
    if stray.any():
        stray = _could_have_come(stray, sight.laid_px(), int(np.count_nonzero(lost)))
    loose = memory.loose(window)
    if loose.any():
        loose_u8 = np.where(loose, np.uint8(255), np.uint8(0))
        loose = near_to(loose_u8, stray | rim, LOOSE_PX * sight.finer)
        stray, rim = stray & ~loose, rim & ~loose
        lost &= ~within(loose_u8, LOOSE_PX * sight.finer)  # strands hide and show what they hang before
    alike = _could_be_matter(
        lost | fresh.unseen | fresh.barren, scene.wanted, fresh.lying, scene.look, memory.bare(window)
    )
    fresh = replace(fresh, unseen=fresh.unseen & ~alike, barren=fresh.barren & ~alike)
    lost, untold_px = _untold(scene, lost & ~alike, stray)
    plain = np.count_nonzero(lost) + np.count_nonzero(stray) > PLAIN_RATIO * np.count_nonzero(sight.expected.complete)
    sunk, bared = (np.zeros_like(lost), np.zeros_like(lost)) if plain else _sunk(scene)
    scopes = _count(scene, fresh, lost, stray, rim, sunk)
    return Findings(
        window, scene.wanted, scene.look, scene.observed, scene.known, scene.standing, lost, stray, rim, fresh.unseen,
        hidden_px, untold_px, scopes, loose, bared,
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Scene:
    """A frame laid upon what must be seen, in a window, and what stood there. Masks are bool, or uint8 where named so.

    edge            : a disc, as wide as the band about expected edges that tells nothing
    near_wanted     : the expected mask with that band; near_observed : a little more than what is seen
    standing, gone  : matter that was seen in earlier checks; what is seen of it no more
    bed             : where the bed is seen
    """

    sight: Sight
    memory: Memory
    window: Window
    look: np.ndarray
    observed_u8: np.ndarray
    observed: np.ndarray
    known: np.ndarray
    wanted_u8: np.ndarray
    wanted: np.ndarray
    edge: np.ndarray
    near_wanted: np.ndarray
    near_observed: np.ndarray
    standing: np.ndarray
    gone: np.ndarray
    bed: np.ndarray

    @classmethod
    def of(cls, sight: Sight, memory: Memory, window: Window, alignment: Alignment) -> _Scene:
        look, observed_u8, ignored = _aligned(sight, alignment, window)
        wanted_u8 = sight.expected.mask[window]
        observed, known = observed_u8 > 0, ignored == 0
        # no narrower than what the print's contours have shown of camera and segmentation
        edge = disc(min(max(sight.tolerance_px, memory.misfit.spread_px + 1.0), 2 * sight.tolerance_px))
        near_wanted = cv2.dilate(wanted_u8, edge) > 0
        near_observed = cv2.dilate(observed_u8, disc(1.5)) > 0
        # a lone line of a bead's width is seen or not as the light falls: only what is wider can be lost
        wide = cv2.morphologyEx(wanted_u8, cv2.MORPH_OPEN, disc(sight.tolerance_px)) > 0
        standing = memory.standing(window) & wide & known
        return cls(
            sight, memory, window, look, observed_u8, observed, known, wanted_u8, wanted_u8 > 0, edge, near_wanted,
            near_observed, standing, standing & ~near_observed, known & ~observed & ~near_wanted,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Fresh:
    """What of the last layers is seen. All bool.

    later  : what they cover, without the first layer; unseen, missed : of it, what is not seen, and what of that counts
    deep   : what lies well inside what they cover; barren : of it, what was never seen
    inside : well inside all that is expected; lying : matter that is seen where it must be, and has really come
    telling : of later, pixels that tell how far they are covered; covered : (n,) float32, how far each of them is
    """

    later: np.ndarray
    unseen: np.ndarray
    deep: np.ndarray
    barren: np.ndarray
    inside: np.ndarray
    lying: np.ndarray
    telling: np.ndarray
    covered: np.ndarray
    off_px: int

    @property
    def missed(self) -> np.ndarray:
        """Lines of single pixels that contours leave which are known to be off are named, where that is asked, and not
        counted."""
        if not self.off_px:
            return self.unseen
        return cv2.morphologyEx(self.unseen.view(np.uint8), cv2.MORPH_OPEN, np.ones((2, 2), np.uint8)) > 0


def _fresh(scene: _Scene) -> _Fresh:
    sight, memory, window, look = scene.sight, scene.memory, scene.window, scene.look
    layer_of, misfit = sight.print_map.layer[window], memory.misfit
    recent = scene.wanted & scene.known & ~memory.given_up(window) & (layer_of > sight.layer - WINDOWS[-1])
    # the first layer covers so much at once that shares with it say nothing of the next
    later = recent & (layer_of > 0)
    # segmentation that expects matter may see it in a shadow: what has not changed at all has not come either
    unchanged = memory.looks_unchanged(window, look, recent & scene.observed)
    # where nothing is seen nothing can be fitted: then the camera is believed
    inside = cv2.erode(scene.wanted_u8, scene.edge if misfit.fitted else disc(sight.tolerance_px)) > 0
    # what the first layer covers has told by its second successor whether it came
    deep = (recent if sight.layer <= FIRST_LAYERS else later) & inside
    never_seen = ~memory.ever_seen(window)
    barren = unchanged | memory.looks_bare(window, look, deep & ~scene.near_observed & never_seen)
    barren &= deep
    # contours that are known to be off by more than a pixel hide a layer's height
    off_px = max(round(misfit.spread_px - 0.5), 0) if misfit.fitted else 0
    covered = scene.observed if not off_px else cv2.dilate(scene.observed_u8, disc(off_px)) > 0
    # what was seen in a good check has come; whether it has gone again is another question
    unseen = (unchanged & later) | memory.looks_bare(window, look, later & ~covered & never_seen)
    lying = scene.observed & scene.wanted & ~unchanged
    if (unseen | barren).any():
        has_bare = memory.has_bare(window)
        if is_shaded_matter(look, memory.bare(window), (unseen | barren) & has_bare, lying, scene.bed & has_bare):
            unseen, barren = np.zeros_like(unseen), np.zeros_like(barren)
    telling, covered_ratio = coverage(
        look, memory.bare(window), scene.standing & lying, later & memory.has_bare(window)
    )
    return _Fresh(later, unseen, deep, barren, inside, lying, telling, covered_ratio, off_px)


def _stray(scene: _Scene) -> tuple[np.ndarray, np.ndarray]:
    """Matter where none is expected, that is new there: beyond the band about expected edges, and within it."""
    sight, memory, window, look = scene.sight, scene.memory, scene.window, scene.look
    outside = scene.observed & scene.known & ~memory.chronic(window)
    stray = outside & ~scene.near_wanted
    rim = outside & scene.near_wanted & (cv2.dilate(scene.wanted_u8, disc(RIM_PX)) == 0)
    stray, rim = memory.looks_new(window, look, stray), memory.looks_new(window, look, rim)
    # dark filament and its own shadow look alike
    rim &= ~memory.looks_shaded(window, look, rim)
    if stray.any():
        stray &= ~(memory.looks_shaded(window, look, stray) & within(scene.wanted_u8, SHADE_PX * sight.finer))
        stray = near_to(scene.wanted_u8, without_specks(stray), _reach_px(sight)) & ~_reaching_in(sight, window)
        if sight.expected.volume is not None:
            stray &= ~_of_the_head(scene, stray, sight.expected.volume[window])
    return stray, rim


def _lost(scene: _Scene, stray: np.ndarray) -> tuple[np.ndarray, int]:
    """Of what is seen no more, what the picture bears out to have gone; and how many pixels have probably only been hidden."""
    lost, memory, window, look = scene.gone, scene.memory, scene.window, scene.look
    if not lost.any():
        return lost, 0
    hidden_px = _hidden_px(scene, stray)
    lying = scene.observed & scene.wanted
    lost = without_hollows(without_specks(memory.looks_bare(window, look, lost)), scene.wanted_u8, lying)
    if lost.any():
        lost &= ~memory.looks_unlike_bed(window, look, lost, scene.bed)
    lost_px = int(np.count_nonzero(lost))
    most = lost_px > UNTOLD_RATIO * np.count_nonzero(scene.standing)
    if most and memory.is_young and np.count_nonzero(stray) <= STRAY_RATIO * lost_px:
        return np.zeros_like(lost), hidden_px  # a first solid layer may shine as the bed does
    if lost_px >= HIDING_PX and memory.shines(window, look, lost, scene.bed):
        lost = np.zeros_like(lost)
    elif lost_px >= HIDING_PX and lacks_grain(look, lost, scene.bed):
        return np.zeros_like(lost), max(hidden_px, lost_px)
    return lost, hidden_px


def _sunk(scene: _Scene) -> tuple[np.ndarray, np.ndarray]:
    """Contour of what stands that has come inwards, as the picture bears out, and what that has laid bare."""
    bared = without_specks(scene.standing > scene.observed, LEAST_SUNK)
    if not bared.any():
        return bared, bared
    memory, window = scene.memory, scene.window
    sunk = memory.contours.sunk(
        window, scene.wanted, scene.look, scene.observed, scene.known, lambda: memory.unlike_bare(window, scene.look)
    )
    bared &= cv2.dilate(sunk.view(np.uint8), disc(BARED_PX)) > 0
    # walls in shade may look just like the bed
    lying = scene.observed & scene.wanted
    told = memory.looks_otherwise(window, scene.look, bared)
    told &= ~_could_be_matter(bared, scene.wanted, lying, scene.look, memory.bare(window))
    if 2 * np.count_nonzero(told) < np.count_nonzero(bared):
        return np.zeros_like(sunk), np.zeros_like(sunk)
    return sunk, bared


def _untold(scene: _Scene, lost: np.ndarray, stray: np.ndarray) -> tuple[np.ndarray, int]:
    """Where much is seen no more and nothing bears out that it has gone: what is lost after all, and how many pixels of it
    nothing tells anything of, since what is fresh may be hidden too."""
    memory, window, look, gone, bed = scene.memory, scene.window, scene.look, scene.gone, scene.bed
    untold_px = int(np.count_nonzero(gone) - np.count_nonzero(lost))
    if untold_px <= UNTOLD_RATIO * np.count_nonzero(scene.standing):
        return lost, 0
    lies_beside = np.count_nonzero(stray) > STRAY_RATIO * untold_px
    bare = memory.all_bare(window, look, gone, bed) and not memory.shines(window, look, gone, bed)
    if lies_beside or (bare and not lacks_grain(look, gone, bed)):
        return lost | without_specks(gone), 0
    return lost, untold_px


def _aligned(sight: Sight, alignment: Alignment, window: Window) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
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


def _of_the_head(scene: _Scene, stray: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """bool: small spots of stray matter within the head's reach (uint8) that touch where nothing can be told for the head: they
    hang together with it as well as with the print."""
    hiding = np.where(scene.known, np.uint8(0), reach)
    touching = near_to(hiding, stray & (reach > 0), TOUCHING_PX)
    return touching & ~without_specks(touching, round(SMALL_PX * scene.sight.finer**2))


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


def _hidden_px(scene: _Scene, stray: np.ndarray) -> int:
    """How much of the matter that is seen no more has probably only been hidden.

    What hides the print looks like neither print nor bed, and hides some of the bed about it; but where the print has
    come off, matter lies where it did not, whatever its shadow does to the bed. And a part comes off as a whole: of what is
    seen to end in its midst, with the rest in its place and as it was, the other half is behind something.
    """
    memory, window, look, gone, standing = scene.memory, scene.window, scene.look, scene.gone, scene.standing
    gone_px = np.count_nonzero(gone)
    if gone_px < HIDING_PX or np.count_nonzero(stray) > STRAY_RATIO * gone_px:
        return 0
    if gone_px > UNTOLD_RATIO * np.count_nonzero(standing):
        rest = standing & ~gone
        as_it_was = np.count_nonzero(rest & ~memory.looks_otherwise(window, look, rest))
        if as_it_was > UNMOVED_RATIO * np.count_nonzero(rest) and _torn_px(gone, standing) > TORN_RATIO * gone_px:
            return int(gone_px)
    beside = scene.bed & (cv2.dilate(gone.astype(np.uint8), disc(AROUND_PX)) > 0)
    changed = memory.bed_changed(window, look, beside, HIDING_CHANGE)
    beside_px = np.count_nonzero(beside)
    # where the very bed is seen instead, it takes most of what is around to say that something else is
    bared = np.count_nonzero(memory.looks_bare(window, look, gone)) >= BARED_RATIO * gone_px
    most_px = HIDING_BARED_RATIO * beside_px if bared else min(HIDING_RATIO * beside_px, float(gone_px))
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


def _count(scene: _Scene, fresh: _Fresh, lost: np.ndarray, stray: np.ndarray, rim: np.ndarray, sunk: np.ndarray
) -> tuple[Evidence, ...]:  # fmt: skip
    sight, window, wanted, observed, known = scene.sight, scene.window, scene.wanted, scene.observed, scene.known
    print_map = sight.print_map
    scopes = [WHOLE, *range(print_map.objects)] if print_map.objects > 1 else [WHOLE]
    missed, complete = fresh.missed, sight.expected.complete[window] > 0
    unsaid, extra = wanted & ~observed & known, observed & ~wanted & known
    edge = wanted & (cv2.erode(wanted.view(np.uint8), np.ones((3, 3), np.uint8)) == 0)
    own = Counter(print_map.owner[window], len(scopes), complete)
    near = Counter(print_map.nearest[window], len(scopes), extra | stray | rim)
    figures = {
        **own(
            expected_px=wanted & known, total_px=complete & known, dim_px=fresh.inside & unsaid, standing_px=scene.standing,
            lost_px=lost, edge_px=edge, unseen_px=missed, deep_px=fresh.deep, barren_px=fresh.barren, xor_px=unsaid,
            sunk_px=sunk,
        ),
        **near(stray_px=stray, rim_px=rim, extra_px=extra),
    }  # fmt: skip
    figures["xor_px"] += figures.pop("extra_px")
    layer_of = print_map.layer[window]
    seen = own.younger(fresh.later, ~missed[fresh.later], layer_of, sight.layer)
    come = own.younger(fresh.telling, fresh.covered, layer_of, sight.layer)
    return tuple(
        Evidence(scope, **{name: int(counts[n]) for name, counts in figures.items()}, fresh=seen[n], come=come[n])
        for n, scope in enumerate(scopes)
    )


def _reach_px(sight: Sight) -> float:
    """How far off the print stray matter may begin."""
    _, _, width, height = cv2.boundingRect(sight.expected.complete)
    return REACH_RATIO * (width + max(width, height)) + 3 * sight.finer
