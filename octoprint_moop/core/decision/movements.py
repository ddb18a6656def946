"""How a print may have moved, each way tried as an explanation of what differs: as a whole, above a layer, at a corner.

What differs, cleaned, is matter that is lost, stray and unseen. A movement explains so much of it as vanishes once the
print is taken to have moved so; a movement that would show elsewhere as well, and doesn't, explains little.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from itertools import product
from typing import Callable

import cv2
import numpy as np

from .counts import WHOLE, WINDOWS, Evidence
from .findings import Findings, Sight
from .onbed import Place, mm_per_px, up_px_per_mm
from .outlines import Beside, Likeness
from .shapes import best_place, box_of, displaced, drawn, filled, middle_of, turned, turned_on_bed
from .spots import disc

EXPLAINED_RATIO = 0.5  # a movement that takes away less of the difference explains nothing
FIRST_SHIFTED_RATIO, AS_GOOD = 0.4, 0.15
LEAST_SHIFT_PX = 2.0
TURNS_DEG = (0, -8, 8, -16, 16, -25, 25)
LAYERS_BACK = (0, 1, 2, 3, 5, 8)
LIFTS_PX = (2.0, 3.0, 4.0, 5.5, 7.5, 10.0, 14.0, 20.0)
LIFT_BENDS = (1.0, 2.0)
STRAY_LEAST_PX, STRAY_SHIFTED_RATIO = (
    30,
    0.15,
)  # of the stray matter must lie where a shift would put it, were all else a clog's doing
OLD_MOVED_RATIO = 0.1  # share of the difference that is old matter's: then the old has moved
LEAST_PART_PX = 20
LIKE_RATIO = 0.84  # from which on what lies beside the print is the newest layers' own pattern
BOTH_RATIO, AGREE_PX = 0.87, 4.5  # the same of the mean of pattern and outline, where they agree
SLIGHT_RATIO, SLIGHT_REACH_PX, SLIGHT_LEAST_PX = (
    0.7,
    12,
    30,
)  # the same within the band about expected edges; there must be
SLIGHT_OUT_RATIO, SLIGHT_OUT_LEAST_PX = 0.12, 15  # so much of it beside the print, and most of what would lie there
AWAY_RATIO, AWAY_LEAST_PX = 0.88, 60  # the same for a part that came off
OUT_RATIO = 0.15  # of that part at least so much sticks out
STILL_RATIO, HALF_RATIO, GONE_RATIO = 0.9, 0.6, 0.02
AWAY_APART_PX, SKIRT_PX = 1.5, 3.0  # contours' mean distance; what is thinner lies flat, and other things upon it
AWAY_TURNS_DEG, AWAY_FINER_DEG, AWAY_NEAR_RATIO = range(-90, 90, 30), 10, 0.6  # then about the best
WAYS, WAY_RAD = 3, np.radians(22.5)  # to either side of where the difference lies
OTHERS_LEAST_PX, OTHERS_MOVED_PX = 20, 6


@dataclass(frozen=True)
class Move:
    """A movement that would explain some of the difference: from where to where its middle went, in the sight's pixels."""

    from_px: tuple[float, float]
    to_px: tuple[float, float]
    explained_ratio: float
    of_stray_ratio: float
    layer: int = 0

    @property
    def distance_px(self) -> float:
        return float(np.hypot(self.to_px[0] - self.from_px[0], self.to_px[1] - self.from_px[1]))


@dataclass(frozen=True)
class Lift:
    """A corner that has risen: where it is, in the sight's pixels, and how far up it has come."""

    at_px: tuple[float, float]
    height_mm: float
    distance_px: float
    explained_ratio: float


class Scope:
    """The findings of one object, or of the whole print, counted in the ways the kinds ask for."""

    def __init__(self, object_id: int, findings: Findings, sight: Sight) -> None:
        print_map, window = sight.print_map, findings.window
        everywhere = np.ones(findings.wanted.shape, bool)
        inside = everywhere if object_id == WHOLE else print_map.owner[window] == object_id
        around = everywhere if object_id == WHOLE else print_map.nearest[window] == object_id
        owned = print_map.owner[window] >= 0
        self._labelled = owned if owned.any() else everywhere
        self._origin_px = np.array([window[1].start, window[0].start], float)
        self._layer, self._layer_of = sight.layer, print_map.layer[window]
        self._owner, self._all_wanted, self._scopes = print_map.owner[window], findings.wanted, findings.scopes
        self._whole, self._known, self._finer = object_id == WHOLE, findings.known, sight.finer
        self._others = [one for one in findings.scopes if one.object_id not in (WHOLE, object_id)]
        self._wanted, self._standing = findings.wanted & inside, findings.standing & inside
        self._lost, self._unseen = (findings.lost | findings.bared) & inside, findings.unseen & inside
        self.stray = findings.stray & around
        self._beyond = self.stray | (findings.rim & around)
        self._observed = findings.seen & findings.known
        # what is seen, cleaned: the expected mask but for what is worth a word; nothing of the neighbours
        self._seen = (self._wanted & ~self._lost & ~self._unseen) | self.stray
        self._foreign = (findings.wanted | (findings.seen & ~around)) & ~self._wanted & ~self.stray
        self.lost_px, self.stray_px, self.unseen_px, self.standing_px = (
            int(np.count_nonzero(mask)) for mask in (self._lost, self.stray, self._unseen, self._standing)
        )
        edge = disc(sight.tolerance_px)
        wanted = self._wanted.astype(np.uint8)
        near_edge = cv2.dilate(wanted, edge) != cv2.erode(wanted, edge)
        # along the expected edges the evidence has no say, unless it spoke up
        self._counts = (~near_edge & ~self._foreign & findings.known) | self._lost | self._unseen | self.stray
        self.wrong_px = self._differing_px(self._wanted)

    @property
    def has_others(self) -> bool:
        """Whether this is one object of several."""
        return bool(self._others) and not self._whole

    def _differing_px(self, explained: np.ndarray) -> int:
        return int(np.count_nonzero((explained ^ self._seen) & self._counts))

    def middle(self) -> tuple[float, float]:
        """The middle of what stands, in the sight's pixels."""
        return tuple(middle_of(self._wanted) + self._origin_px)

    def bared(self) -> tuple[tuple[float, float], float]:
        """Where matter is lost, in the sight's pixels, and how high the largest gap is, in pixels."""
        gaps = self._lost.sum(axis=0)
        # what is lost keeps a pixel's distance from what is still seen
        gap_px = float(np.percentile(gaps[gaps > 0], 80)) + 1 if gaps.any() else 0.0
        return tuple(middle_of(self._lost) + self._origin_px), gap_px

    def unseen_ratio(self, since: int) -> float:
        """Share of what has come since that layer, and is in sight, that is not seen."""
        new = self._wanted & (self._layer_of >= since)
        return int(np.count_nonzero(new & self._unseen)) / max(int(np.count_nonzero(new)), 1)

    def first_unseen_layer(self) -> int:
        """Going back from the last layer, the first of those of which a good part is not seen."""
        first = self._layer
        for layer in range(self._layer, max(self._layer - WINDOWS[-1], -1), -1):
            new = self._wanted & (self._layer_of == layer)
            wanted_px = np.count_nonzero(new)
            if wanted_px >= 5:
                if np.count_nonzero(new & self._unseen) < 0.3 * wanted_px:
                    break
                first = layer
        return first

    def moved_whole(self, least_px: float) -> Move | None:
        """How what stood there has moved as a whole, by no less; None where that doesn't explain what differs."""
        best: Move | None = None
        loose = self._loose()
        rest = self._standing & ~loose
        for turn_deg in TURNS_DEG:
            move = self._best_move(turned(loose, turn_deg), rest)
            if move is None or move.distance_px < least_px:
                continue
            if best is None or move.explained_ratio > best.explained_ratio:
                best = move
        return best if best and best.explained_ratio >= EXPLAINED_RATIO else None

    def _loose(self) -> np.ndarray:
        """What stood in one piece with what is lost: a skirt stays where it is when the print comes off."""
        body = self._standing & self._labelled
        count, labels = cv2.connectedComponents(body.astype(np.uint8), connectivity=4)
        whole_px = np.bincount(labels.ravel(), minlength=count)
        lost_px = np.bincount(labels[self._lost], minlength=count)
        loose = lost_px > 0.02 * whole_px
        loose[0] = False
        return loose[labels]

    def shift_above(self, covered: Callable[[int], np.ndarray]) -> Move | None:
        """From which layer on everything is displaced; None where that doesn't explain what differs."""
        moves: list[Move] = []
        for back in LAYERS_BACK:
            layer = self._layer - back
            if layer < 1 or not self.stray_px or self.stray_px < 0.2 * self.wrong_px:
                break
            lower = self._wanted & (self._layer_of < layer)
            move = self._best_move(covered(layer), lower)
            there = self.stray_px < STRAY_LEAST_PX or (move and move.of_stray_ratio >= STRAY_SHIFTED_RATIO)
            if move and move.distance_px >= LEAST_SHIFT_PX and there:
                moves.append(replace(move, layer=layer))
        best = max(moves, key=lambda move: move.explained_ratio, default=None)
        # the first shifted layer lies on air where it sticks out, and comes in pieces
        newest = best is not None and best.layer == self._layer and best.distance_px >= 2 * LEAST_SHIFT_PX
        if best is None or best.explained_ratio < (FIRST_SHIFTED_RATIO if newest else 1.2 * EXPLAINED_RATIO):
            return self.newest_shifted(covered)
        near = [move for move in moves if move.explained_ratio >= best.explained_ratio - AS_GOOD]
        first = min(near, key=lambda move: move.layer)
        return first if self.others_moved(first.layer) else None

    def newest_shifted(self, covered: Callable[[int], np.ndarray]) -> Move | None:
        """How the newest layers are displaced, where what lies beside the print is their own pattern of lines, in which the
        picture shows gaps; None where it is not.

        The lines' own likeness tells, not how much they explain; or the mean of theirs and of their outline's, where both
        find them at the same place.
        """
        old_moved = self.lost_px >= OLD_MOVED_RATIO * self.wrong_px
        if self.has_others or self.stray_px < STRAY_LEAST_PX or old_moved:
            return None
        beside, best = self._beside(), None
        for layer in range(self._layer, max(self._layer - 4, 0), -1):
            part = covered(layer)
            if np.count_nonzero(part) < LEAST_PART_PX:
                continue
            lines, outline = beside.lines(part), beside.layer(part)
            apart_px = np.hypot(*np.subtract(lines.offset_px, outline.offset_px))
            both = (lines.ratio + outline.ratio) / 2 if apart_px <= AGREE_PX * self._finer else 0.0
            if lines.ratio < LIKE_RATIO and both < BOTH_RATIO:
                continue
            if best is None or max(lines.ratio, both) > best.explained_ratio:
                at, middle = (outline if both > lines.ratio else lines), middle_of(part) + self._origin_px
                to_px = tuple(middle + at.offset_px)
                best = Move(tuple(middle), to_px, max(lines.ratio, both), at.told_ratio, layer)
        return best

    def slightly_shifted(self, covered: Callable[[int], np.ndarray]) -> Move | None:
        """From which layer on everything is displaced by hardly more than the band about expected edges; None where nothing
        tells that.

        All that differs along the edges has a say: what sticks out on one side, and what is not seen of the newest layers on
        the other. A clog leaves nothing beside the print, strands and halos bare nothing.
        """
        newest = self._wanted & self._known & (self._layer_of > self._layer - WINDOWS[-1]) & (self._layer_of > 0)
        differs = self._beyond | (newest & ~self._observed)
        if np.count_nonzero(differs) < SLIGHT_LEAST_PX or self.lost_px >= OLD_MOVED_RATIO * np.count_nonzero(differs):
            return None
        free = self._known & ~self._foreign & (cv2.dilate(self._wanted.view(np.uint8), disc(1)) == 0)
        near, best = cv2.dilate(differs.view(np.uint8), disc(1)) > 0, None
        for layer in (self._layer - back for back in LAYERS_BACK):
            part, above = covered(layer) & ~self._foreign, newest & (self._layer_of >= layer)
            if layer < 1 or min(np.count_nonzero(part), np.count_nonzero(above)) < LEAST_PART_PX:
                continue
            pays = (self._beyond | (above & self._observed)).astype(np.float32)
            pays -= (free & ~self._beyond) | (above & ~self._observed)
            offset_px = best_place(part, pays, round(SLIGHT_REACH_PX * self._finer))
            there = displaced(part, offset_px)
            out, told = there & free, cv2.dilate(there.view(np.uint8), disc(1)) > 0
            would_differ = out | (above & ~there)
            hits = np.count_nonzero(would_differ & near)
            explained = np.count_nonzero(self._beyond & told) + np.count_nonzero(differs & ~self._beyond & ~there)
            seen_ratio = hits / max(int(np.count_nonzero(would_differ)), 1)
            told_ratio = explained / int(np.count_nonzero(differs))
            ratio = 2 * seen_ratio * told_ratio / max(seen_ratio + told_ratio, 1e-6)
            middle = middle_of(part) + self._origin_px
            out_px, seen_px = np.count_nonzero(out), np.count_nonzero(out & near)
            bared = above & ~there  # strands that happen to lie on one side leave the other in its place
            half_in_place = 2 * np.count_nonzero(bared & near) < np.count_nonzero(bared)
            if half_in_place or 2 * seen_px < out_px or seen_px < max(SLIGHT_OUT_LEAST_PX, SLIGHT_OUT_RATIO * hits):
                continue
            if ratio >= SLIGHT_RATIO and (best is None or ratio > best.explained_ratio):
                best = Move(tuple(middle), tuple(middle + offset_px), ratio, told_ratio, layer)
        return best

    def moved_away(self, place: Place) -> Move | None:
        """How a part that stands alone was moved and turned on the bed, so far that a good part of it lies beside the print
        with the outline that it had; None where no such thing lies there. Its old place has no say: a head may hide it.
        """
        beside, best = self._beside(), None
        if beside.px < AWAY_LEAST_PX:
            return None
        count, labels = cv2.connectedComponents((self._wanted & self._labelled).astype(np.uint8), connectivity=4)
        for number in range(1, count):
            part = filled(labels == number)
            # what sticks out at most, and at least, of what could be so alike
            if not 0.75 * beside.px <= np.count_nonzero(part) <= 1.3 * beside.px / OUT_RATIO:
                continue
            others = (self._wanted & self._labelled & ~part).view(np.uint8)
            others = cv2.morphologyEx(others, cv2.MORPH_OPEN, disc(SKIRT_PX * self._finer)) > 0
            from_px = middle_of(part) + self._origin_px
            for as_turned, found in _turned_beside(beside, part, others, mm_per_px(place, from_px)):
                fits = found.out_ratio >= OUT_RATIO and found.apart_px <= AWAY_APART_PX * self._finer
                better = fits and (best is None or found.ratio > best.explained_ratio)
                if better and not self._still_stands(part, displaced(as_turned, found.offset_px)):
                    best = Move(tuple(from_px), tuple(from_px + found.offset_px), found.ratio, found.told_ratio)
        return best if best and best.explained_ratio >= AWAY_RATIO else None

    def _still_stands(self, part: np.ndarray, there: np.ndarray) -> bool:
        """Whether a part that would lie half in its old place is seen to stand there: nearly all that it would have laid bare,
        and of the rest as much. Of an old place that lies apart that says nothing: all may be taken for what is expected.
        """
        bared, gone = part & self._wanted & ~there, part & self._standing & self._known & ~self._observed
        part_px, bared_px = int(np.count_nonzero(part)), int(np.count_nonzero(bared))
        if bared_px >= HALF_RATIO * part_px or np.count_nonzero(gone) > GONE_RATIO * part_px:
            return False
        return int(np.count_nonzero(bared & self._observed)) >= STILL_RATIO * max(bared_px, LEAST_PART_PX)

    def _beside(self) -> Beside:
        return Beside(self.stray, self._wanted, self._foreign | ~self._known, self._finer)

    def others_moved(self, layer: int, slightly: bool = False) -> bool:
        """Whether the other objects are out of place above that layer too, as axes that slip amid it make them.

        slightly : then what is not seen of them says so as well
        """
        out_px = [
            one.stray_px + one.rim_px + one.lost_px + slightly * one.unseen_px for one in self._others_grown(layer + 1)
        ]
        moved = sum(one_px >= OTHERS_MOVED_PX for one_px in out_px)
        if out_px:
            return 2 * moved >= len(out_px)
        # those that were laid before the axes slipped are in their place, and of so little others may show nothing
        newest = [] if self.stray_px < STRAY_LEAST_PX else self._others_grown(layer)
        return not newest or any(one.stray_px + slightly * one.rim_px >= OTHERS_MOVED_PX for one in newest)

    def _others_grown(self, since: int) -> list[Evidence]:
        """The other objects to which enough has come from that layer on."""
        later = np.bincount(self._owner[(self._layer_of >= since) & self._all_wanted] + 1, minlength=len(self._scopes))
        return [one for one in self._others if later[one.object_id + 1] >= OTHERS_LEAST_PX]

    def lifted_corner(self, place: Place, least_ratio: float = EXPLAINED_RATIO) -> Lift | None:
        """How a corner that rises would explain what differs best; None where that is less, or heights cannot be seen.

        What lay there is pulled up, the more the farther out it lies; seen from the front that lays its foot bare, seen
        from behind it only sticks out above. Pixels are moved by what their own place on the bed says.
        """
        body = self._bodies(self._lost | self.stray)
        rows, columns = np.nonzero(body)
        if len(rows) < 20:
            return None
        pixels = np.column_stack([columns, rows]).astype(float)
        middle = pixels.mean(axis=0) + self._origin_px
        up_px = up_px_per_mm(place, middle)
        if np.hypot(*up_px) < 1e-3:
            return None
        # affine about the middle, and linear in height: exact enough for a share of the print's width
        at_mm = place.on_bed_mm(middle + np.array([(0, 0), (1, 0), (0, 1)]), 0.0)
        above_mm = place.on_bed_mm(middle[None], 1.0)[0] - at_mm[0]
        heights = np.array([0.0, *(place.layer_z_mm(n) for n in range(self._layer + 1))])
        z_mm = heights[np.clip(self._layer_of[rows, columns] + 1, 0, self._layer + 1)]
        bed_mm = (pixels - pixels.mean(axis=0)) @ (at_mm[1:] - at_mm[0]) + z_mm[:, None] * above_mm
        few = box_of(body, round(LIFTS_PX[-1]) + 2)
        corner_px = np.array([few[1].start, few[0].start])
        still, seen, counts = (mask[few] for mask in (self._wanted & ~body, self._seen, self._counts))
        elsewhere_px = self.wrong_px - int(np.count_nonzero((self._wanted[few] ^ seen) & counts))
        towards = (middle_of(self._lost | self.stray) - pixels.mean(axis=0)) @ (at_mm[1:] - at_mm[0])
        best: Lift | None = None
        for turn in np.arange(-WAYS, WAYS + 1) * WAY_RAD + np.arctan2(towards[1], towards[0]):
            out = bed_mm @ [np.cos(turn), np.sin(turn)]
            inmost, outmost = (np.percentile(out, share) for share in (50, 99.5))
            share = np.clip((out - inmost) / max(outmost - inmost, 1e-6), 0, 1)
            for bend, lift_px in product(LIFT_BENDS, LIFTS_PX):
                risen = pixels - corner_px + (lift_px * share**bend)[:, None] * (up_px / np.hypot(*up_px))
                there = drawn(risen, still.shape) | still
                left_px = elsewhere_px + int(np.count_nonzero((there ^ seen) & counts))
                explained = 1 - left_px / max(self.wrong_px, 1)
                if best is None or explained > best.explained_ratio:
                    corner = pixels[np.argmax(out)] + self._origin_px
                    best = Lift(tuple(corner), lift_px / float(np.hypot(*up_px)), lift_px, float(explained))
        return best if best and best.explained_ratio >= least_ratio else None

    def _bodies(self, differing: np.ndarray) -> np.ndarray:
        """bool: what is expected in one piece with, or right beside, what differs."""
        body = self._wanted & self._labelled
        count, labels = cv2.connectedComponents(body.astype(np.uint8), connectivity=8)
        touched = cv2.dilate(differing.astype(np.uint8), disc(4)) > 0
        touching_px = np.bincount(labels[touched & body], minlength=count)
        touching = touching_px > 0.2 * touching_px.max(initial=1)
        touching[0] = False
        return touching[labels]

    def _best_move(self, part: np.ndarray, standing: np.ndarray) -> Move | None:
        """Where `part` lies now, if `standing` stays where it is: the place where it covers most of what is seen."""
        if np.count_nonzero(part) < LEAST_PART_PX:
            return None
        pays = np.where(self._seen, np.float32(1), np.float32(-1))
        pays[standing | ~self._counts] = 0.0
        offset_px = best_place(part, pays)
        there = displaced(part, offset_px)
        left_px = self._differing_px(there | standing)
        stray_px = np.count_nonzero(self.stray & (cv2.dilate(there.view(np.uint8), disc(1.5)) > 0))
        middle = middle_of(part) + self._origin_px
        return Move(
            tuple(middle),
            tuple(middle + offset_px),
            1 - left_px / max(self.wrong_px, 1),
            stray_px / max(self.stray_px, 1),
        )


def _turned_beside(
    beside: Beside, part: np.ndarray, others: np.ndarray, mm_per_px: np.ndarray
) -> Collection[tuple[np.ndarray, Likeness]]:
    """A part in each of its turns on the bed and how alike it is then, coarse ones first and finer ones about the best."""
    middle = middle_of(part)

    def alike(turn_deg: float) -> tuple[np.ndarray, Likeness]:
        as_turned = turned_on_bed(part, turn_deg, middle, mm_per_px)
        return as_turned, beside.body(as_turned, others)

    tried = {turn_deg: alike(turn_deg) for turn_deg in AWAY_TURNS_DEG}
    best_deg = max(tried, key=lambda turn_deg: tried[turn_deg][1].ratio)
    if tried[best_deg][1].ratio >= AWAY_NEAR_RATIO:
        tried.update((finer, alike(finer)) for finer in (best_deg - AWAY_FINER_DEG, best_deg + AWAY_FINER_DEG))
    return tried.values()
