"""What kind of failure is it, how large, and since when? Each kind is tried as an explanation of what differs.

What differs, cleaned of noise, is lost, stray and unseen matter. Old matter moves only where the print comes off or
warps; a shift of the axes moves all that came later and leaves the old alone; a clog only leaves out. So the kinds are
told apart by how much of the difference vanishes once the print is taken to have moved, or to have moved above a
layer, by the distance that explains most. The sentences are for people, so they count layers from 1.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Callable, Protocol

import cv2
import numpy as np

from .decide import Outcome
from .evidence import WHOLE, WINDOWS, Findings, Sight
from .spots import disc

WARPING, DETACHMENT, EXTRUSION_FAILURE = "warping", "detachment", "extrusion_failure"
LAYER_SHIFT, STRAY_MATERIAL, UNKNOWN = "layer_shift", "stray_material", "unknown"

GONE_RATIO = 0.25  # of the standing matter lost: more than a lifted corner lays bare
OLD_MOVED_RATIO = 0.1  # share of the difference that is old matter's: then the old has moved
FIRST_SHIFTED_RATIO, AS_GOOD = 0.4, 0.15
EXPLAINED_RATIO = 0.5  # a movement that takes away less of the difference explains nothing
COUNTERPART_RATIO = 0.35  # how much smaller the one of two areas may be to count as its counterpart
LEAST_MOVE_MM = 2.5
LEAST_SHIFT_PX, LEAST_MOVE_PX = 2.0, 5.0  # a corner that lifts looks like a print that moved by less
TURNS_DEG = (0, -8, 8, -16, 16, -25, 25)


class Place(Protocol):
    """What the diagnosis asks of the camera: core/view/view.py."""

    def covered(self, object_id: int, first_layer: int) -> np.ndarray:
        """(H, W) uint8, 255 where what lies of that object (-1: of everything) from `first_layer` on would be seen alone."""

    def on_bed_mm(self, pixels: np.ndarray, z_mm: float) -> np.ndarray:
        """(N, 2): where lines of sight through pixels (N, 2) meet the plane z = z_mm, print coordinates."""

    def layer_z_mm(self, layer: int) -> float: ...


@dataclass(frozen=True)
class Diagnosis:
    """mode: one of FORMATS.md, section 4; sentence: for the user, with a magnitude where it makes sense."""

    mode: str
    sentence: str


@dataclass(frozen=True)
class _Move:
    """A movement that would explain some of the difference: from where to where its middle went, in picture pixels."""

    from_px: tuple[float, float]
    to_px: tuple[float, float]
    explained_ratio: float
    layer: int = 0

    @property
    def distance_px(self) -> float:
        return float(np.hypot(self.to_px[0] - self.from_px[0], self.to_px[1] - self.from_px[1]))


def diagnose(outcome: Outcome, findings: Findings, sight: Sight, place: Place) -> Diagnosis:
    """Name what `outcome` found in its scope."""
    scope = _Scope(outcome.object_id, findings, sight)
    if scope.lost_px >= GONE_RATIO * max(scope.standing_px, 1):
        return _old_moved(scope, place)
    shift = scope.shift_above(lambda layer: place.covered(outcome.object_id, layer)[findings.window] > 0)
    if shift:
        how_far = _distance(place, shift, place.layer_z_mm(shift.layer))  # `shift.layer` is the first that is shifted
        return Diagnosis(LAYER_SHIFT, f"Everything above layer {shift.layer} is shifted by about {how_far}.")
    if scope.lost_px >= OLD_MOVED_RATIO * scope.wrong_px:
        return _old_moved(scope, place)
    if scope.stray_px < COUNTERPART_RATIO * scope.unseen_px:
        since = scope.first_unseen_layer()
        if scope.unseen_ratio(since) > 0.8:
            return Diagnosis(EXTRUSION_FAILURE, f"No new material since layer {since + 1}.")
        return Diagnosis(EXTRUSION_FAILURE, f"Too little new material since layer {since + 1}.")
    if scope.stray_px:
        area_mm2 = _area_mm2(place, scope.stray, place.layer_z_mm(sight.layer) / 2, findings)
        return Diagnosis(STRAY_MATERIAL, f"Material lies where none should be, about {_rounded(area_mm2)} mm² of it.")
    return Diagnosis(UNKNOWN, "The print no longer looks as it should.")


def _old_moved(scope: _Scope, place: Place) -> Diagnosis:
    """Matter that stood there is lost: the print has come off, or a part of it has lifted."""
    gone = scope.lost_px >= GONE_RATIO * max(scope.standing_px, 1)
    if gone and scope.stray_px < 0.15 * scope.lost_px:
        return Diagnosis(DETACHMENT, "The print is gone from its place.")
    move = scope.moved_whole()
    if move and not gone and _distance_mm(place, move, 0.0) < LEAST_MOVE_MM:
        move = None
    if gone or move:
        if not move:
            return Diagnosis(DETACHMENT, "The print has come off.")
        return Diagnosis(
            DETACHMENT, f"The print has come off: it lies about {_distance(place, move, 0.0)} from its place."
        )
    corner, lift_px = scope.lifted()
    at = np.array([corner, (corner[0] + 1.0, corner[1])])
    px_per_mm = 1 / max(float(np.linalg.norm(np.diff(place.on_bed_mm(at, 0.0), axis=0))), 1e-6)
    off_centre = np.diff(place.on_bed_mm(np.array([scope.middle(), corner]), 0.0), axis=0)[0]
    return Diagnosis(WARPING, f"The {_corner(off_centre)} has lifted by about {_rounded(lift_px / px_per_mm)} mm.")


class _Scope:
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
        self._wanted, self._standing = findings.wanted & inside, findings.standing & inside
        self._lost, self._unseen = findings.lost & inside, findings.unseen & inside
        self.stray = findings.stray & around
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
        self._counts = (~near_edge & ~self._foreign) | self._lost | self._unseen | self.stray
        self.wrong_px = self._differing_px(self._wanted)

    def _differing_px(self, explained: np.ndarray) -> int:
        return int(np.count_nonzero((explained ^ self._seen) & self._counts))

    def middle(self) -> tuple[float, float]:
        """The middle of what stands, in picture pixels."""
        return tuple(_middle(self._wanted) + self._origin_px)

    def lifted(self) -> tuple[tuple[float, float], float]:
        """Where matter is lost, in picture pixels, and how high the largest gap is, in pixels."""
        gaps = self._lost.sum(axis=0)
        # what is lost keeps a pixel's distance from what is still seen
        gap_px = float(np.percentile(gaps[gaps > 0], 80)) + 1 if gaps.any() else 0.0
        return tuple(_middle(self._lost) + self._origin_px), gap_px

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

    def moved_whole(self) -> _Move | None:
        """How what stood there has moved as a whole; None where that doesn't explain what differs."""
        best: _Move | None = None
        loose = self._loose()
        rest = self._standing & ~loose
        for turn_deg in TURNS_DEG:
            move = self._best_move(_turned(loose, turn_deg), rest)
            if move is None or move.distance_px < LEAST_MOVE_PX:
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

    def shift_above(self, covered: Callable[[int], np.ndarray]) -> _Move | None:
        """From which layer on everything is displaced; None where that doesn't explain what differs."""
        moves: list[_Move] = []
        for back in (0, 1, 2, 3, 5, 8):
            layer = self._layer - back
            if layer < 1 or self.stray_px < 0.2 * self.wrong_px:
                break
            lower = self._wanted & (self._layer_of < layer)
            move = self._best_move(covered(layer), lower)
            if move and move.distance_px >= LEAST_SHIFT_PX:
                moves.append(replace(move, layer=layer))
        best = max(moves, key=lambda move: move.explained_ratio, default=None)
        if best is None:
            return None
        # the first shifted layer lies on air where it sticks out, and comes in pieces
        newest = best.layer == self._layer and best.distance_px >= 2 * LEAST_SHIFT_PX
        if best.explained_ratio < (FIRST_SHIFTED_RATIO if newest else 1.2 * EXPLAINED_RATIO):
            return None
        near = [move for move in moves if move.explained_ratio >= best.explained_ratio - AS_GOOD]
        return min(near, key=lambda move: move.layer)

    def _best_move(self, part: np.ndarray, standing: np.ndarray) -> _Move | None:
        """Where `part` lies now, if `standing` stays where it is: the place where it covers most of what is seen."""
        rows, columns = np.nonzero(part)
        if len(rows) < 20:
            return None
        reach = max(24, int(0.6 * max(np.ptp(rows), np.ptp(columns))))
        pays = np.where(self._seen, 1.0, -1.0)
        pays[standing | ~self._counts] = 0.0
        pays = cv2.copyMakeBorder(pays.astype(np.float32), reach, reach, reach, reach, cv2.BORDER_CONSTANT, value=-1.0)
        top, left, bottom, right = rows.min(), columns.min(), rows.max() + 1, columns.max() + 1
        field = pays[top : bottom + 2 * reach, left : right + 2 * reach]
        template = part[top:bottom, left:right].astype(np.float32)
        score = cv2.matchTemplate(field, template, cv2.TM_CCORR)
        _, _, _, (column, row) = cv2.minMaxLoc(score)
        right_px, down_px = column - reach, row - reach
        there = cv2.warpAffine(
            part.astype(np.uint8), np.array([[1.0, 0, right_px], [0, 1.0, down_px]]), part.shape[::-1]
        )
        left_px = self._differing_px((there > 0) | standing)
        middle = _middle(part) + self._origin_px
        return _Move(tuple(middle), tuple(middle + [right_px, down_px]), 1 - left_px / max(self.wrong_px, 1))


def _turned(mask: np.ndarray, turn_deg: float) -> np.ndarray:
    if not turn_deg or not mask.any():
        return mask
    x, y = _middle(mask)
    matrix = cv2.getRotationMatrix2D((float(x), float(y)), turn_deg, 1.0)
    return cv2.warpAffine(mask.astype(np.uint8), matrix, mask.shape[::-1]) > 0


def _middle(mask: np.ndarray) -> np.ndarray:
    rows, columns = np.nonzero(mask)
    return np.array([columns.mean(), rows.mean()]) if len(rows) else np.zeros(2)


def _on_bed_mm(place: Place, move: _Move, z_mm: float) -> tuple[float, float]:
    """How far to the right and to the back."""
    right_mm, back_mm = np.diff(place.on_bed_mm(np.array([move.from_px, move.to_px]), z_mm), axis=0)[0]
    return float(right_mm), float(back_mm)


def _distance_mm(place: Place, move: _Move, z_mm: float) -> float:
    return float(np.hypot(*_on_bed_mm(place, move, z_mm)))


def _distance(place: Place, move: _Move, z_mm: float) -> str:
    """How far and where to, on the bed: "6 mm to the left"."""
    right_mm, back_mm = _on_bed_mm(place, move, z_mm)
    ways = []
    for size_mm, other_mm, names in ((right_mm, back_mm, ("right", "left")), (back_mm, right_mm, ("back", "front"))):
        if abs(size_mm) > 0.4 * abs(other_mm):
            ways.append(names[0] if size_mm > 0 else names[1])
    return f"{_rounded(float(np.hypot(right_mm, back_mm)))} mm to the {' and the '.join(ways)}"


def _area_mm2(place: Place, mask: np.ndarray, z_mm: float, findings: Findings) -> float:
    x, y = _middle(mask) + [findings.window[1].start, findings.window[0].start]
    corner, right, down = place.on_bed_mm(np.array([(x, y), (x + 1, y), (x, y + 1)]), z_mm)
    across, away = right - corner, down - corner
    # a strand that stands up or lies flat: the pixel's width is sure, its height on the bed is not
    return float(np.count_nonzero(mask) * min(abs(across[0] * away[1] - across[1] * away[0]), across @ across))


def _corner(off_centre_mm: np.ndarray) -> str:
    right_mm, back_mm = off_centre_mm
    side = "right" if right_mm > 0 else "left"
    end = "back" if back_mm > 0 else "front"
    if abs(right_mm) > 3 * abs(back_mm):
        return f"{side} side"
    if abs(back_mm) > 3 * abs(right_mm):
        return f"{end} side"
    return f"{end}-{side} corner"


def _rounded(value: float) -> str:
    return f"{value:.0f}" if value >= 3 else f"{value:.1f}"
