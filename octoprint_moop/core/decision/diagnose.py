"""What kind of failure is it, how large, and since when? Each kind is tried as an explanation of what differs.

What differs, cleaned of noise, is lost, stray and unseen matter. Old matter moves only where the print comes off or
warps; a shift of the axes moves all that came later and leaves the old alone; a clog only leaves out. So the kinds are
told apart by how much of the difference vanishes once the print is taken to have moved, or to have moved above a
layer, or to have risen at a corner, by the distance that explains most. The sentences are for people, so they count
layers from 1.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .counts import WHOLE, WINDOWS, Evidence
from .decide import Outcome
from .findings import Findings, Sight
from .movements import EXPLAINED_RATIO, OLD_MOVED_RATIO, Lift, Move, Scope
from .onbed import Place
from .shapes import middle_of

WARPING, DETACHMENT, EXTRUSION_FAILURE = "warping", "detachment", "extrusion_failure"
LAYER_SHIFT, STRAY_MATERIAL, UNKNOWN = "layer_shift", "stray_material", "unknown"

GONE_RATIO = 0.25  # of the standing matter lost: more than a lifted corner lays bare
HARDLY_RISEN_RATIO = 0.3  # of the difference; where no lift explains more, nothing has risen
COUNTERPART_RATIO = 0.35  # how much smaller the one of two areas may be to count as its counterpart
HARDLY_COVERED = 0.3  # of what some layers should have covered
LEAST_MOVE_PX = 2.0
PLAUSIBLE, MUCH_SHORTER = 0.2, 0.6  # of two movements that explain as much but for this, a much shorter one is taken


@dataclass(frozen=True)
class Diagnosis:
    """mode: one of FORMATS.md, section 4; sentence: for the user, with a magnitude where it makes sense."""

    mode: str
    sentence: str


class Naming:
    """Names what one look found, scope by scope. What is asked of the whole print is worked out once for all of them."""

    def __init__(self, findings: Findings, sight: Sight, place: Place) -> None:
        self._findings, self._sight, self._place = findings, sight, place

    def name(self, outcome: Outcome) -> Diagnosis:
        """What `outcome` found in its scope. Raises RenderError where drawing fails."""
        place = self._place
        scope = Scope(outcome.object_id, self._findings, self._sight)
        if scope.lost_px >= GONE_RATIO * max(scope.standing_px, 1):
            return _old_moved(scope, place)
        shift = scope.shift_above(self._laid_above(outcome.object_id))
        if shift is None and scope.has_others:
            shift = self._newest_shifted
        if shift is None and self._moved_away is None:
            slight = self._slightly_shifted
            shift = slight if slight and scope.others_moved(slight.layer, slightly=True) else None
        lift = scope.lifted_corner(place)
        if lift and (shift is None or _plainer(lift, shift)):
            return _lifted(lift, scope, place)
        if shift:
            how_far = _distance(
                place, shift, place.layer_z_mm(shift.layer)
            )  # `shift.layer` is the first that is shifted
            return Diagnosis(LAYER_SHIFT, f"Everything above layer {shift.layer} is shifted by about {how_far}.")
        if scope.lost_px and scope.lost_px >= OLD_MOVED_RATIO * scope.wrong_px:
            return _old_moved(scope, place)
        if scope.stray_px < COUNTERPART_RATIO * scope.unseen_px:
            since = scope.first_unseen_layer()
            if scope.unseen_ratio(since) > 0.8:
                return Diagnosis(EXTRUSION_FAILURE, f"No new material since layer {since + 1}.")
            return Diagnosis(EXTRUSION_FAILURE, f"Too little new material since layer {since + 1}.")
        if scope.stray_px:
            if self._moved_away:  # what came off one object may lie between it and others
                return _come_off(self._moved_away, place)
            area_mm2 = _area_mm2(place, scope.stray, place.layer_z_mm(self._sight.layer) / 2, self._findings)
            return Diagnosis(
                STRAY_MATERIAL, f"Material lies where none should be, about {_rounded(area_mm2)} mm² of it."
            )
        if outcome.leading.kind == "fresh":  # a layer that no pixel shows to be missing, and all of them together
            since = _uncovered_since(self._findings.scopes[outcome.object_id - WHOLE], self._sight.layer)
            return Diagnosis(EXTRUSION_FAILURE, f"Too little new material since layer {since + 1}.")
        return Diagnosis(UNKNOWN, "The print no longer looks as it should.")

    def _laid_above(self, object_id: int) -> Callable[[int], np.ndarray]:
        return lambda layer: self._place.covered(object_id, layer)[self._findings.window] > 0

    @cached_property
    def _everything(self) -> Scope:
        return Scope(WHOLE, self._findings, self._sight)

    @cached_property
    def _newest_shifted(self) -> Move | None:
        """Axes that slip displace what is laid of all objects, and all of them together show it best."""
        return self._everything.newest_shifted(self._laid_above(WHOLE))

    @cached_property
    def _slightly_shifted(self) -> Move | None:
        return self._everything.slightly_shifted(self._laid_above(WHOLE))

    @cached_property
    def _moved_away(self) -> Move | None:
        return self._everything.moved_away(self._place)


def _uncovered_since(evidence: Evidence, layer: int) -> int:
    """The first of the last layers of which hardly anything is covered; the last where none is so bare."""
    bare = [
        layers for layers, (told_px, covered_px) in zip(WINDOWS, evidence.come) if covered_px < HARDLY_COVERED * told_px
    ]
    return max(layer - max(bare, default=1) + 1, 0)


def _plainer(lift: Lift, shift: Move) -> bool:
    worse = shift.explained_ratio - lift.explained_ratio
    return worse < (PLAUSIBLE if lift.distance_px < MUCH_SHORTER * shift.distance_px else 0.0)


def _lifted(lift: Lift, scope: Scope, place: Place) -> Diagnosis:
    off_centre = np.diff(place.on_bed_mm(np.array([scope.middle(), lift.at_px]), 0.0), axis=0)[0]
    return Diagnosis(WARPING, f"The {_corner(off_centre)} has lifted by about {_rounded(lift.height_mm)} mm.")


def _old_moved(scope: Scope, place: Place) -> Diagnosis:
    """Matter that stood there is lost: the print has come off, or a part of it has lifted."""
    gone = scope.lost_px >= GONE_RATIO * max(scope.standing_px, 1)
    if gone and scope.stray_px < 0.15 * scope.lost_px:
        return Diagnosis(DETACHMENT, "The print is gone from its place.")
    best_lift = scope.lifted_corner(place, -np.inf)
    lift = best_lift if best_lift and best_lift.explained_ratio >= EXPLAINED_RATIO else None
    move = scope.moved_whole(LEAST_MOVE_PX)
    if move and lift and not gone and lift.explained_ratio > move.explained_ratio - PLAUSIBLE:
        return _lifted(lift, scope, place)
    move = move or (None if gone or lift else scope.moved_away(place))
    if move:
        return _come_off(move, place)
    # a corner that has lifted under strands is still told by a part of what differs
    if gone or (best_lift and best_lift.explained_ratio < HARDLY_RISEN_RATIO):
        return Diagnosis(DETACHMENT, "The print has come off.")
    corner, lift_px = scope.bared()
    at = np.array([corner, (corner[0] + 1.0, corner[1])])
    px_per_mm = 1 / max(float(np.linalg.norm(np.diff(place.on_bed_mm(at, 0.0), axis=0))), 1e-6)
    off_centre = np.diff(place.on_bed_mm(np.array([scope.middle(), corner]), 0.0), axis=0)[0]
    return Diagnosis(WARPING, f"The {_corner(off_centre)} has lifted by about {_rounded(lift_px / px_per_mm)} mm.")


def _come_off(move: Move, place: Place) -> Diagnosis:
    return Diagnosis(DETACHMENT, f"The print has come off: it lies about {_distance(place, move, 0.0)} from its place.")


def _on_bed_mm(place: Place, move: Move, z_mm: float) -> tuple[float, float]:
    """How far to the right and to the back."""
    right_mm, back_mm = np.diff(place.on_bed_mm(np.array([move.from_px, move.to_px]), z_mm), axis=0)[0]
    return float(right_mm), float(back_mm)


def _distance(place: Place, move: Move, z_mm: float) -> str:
    """How far and where to, on the bed: "6 mm to the left"."""
    right_mm, back_mm = _on_bed_mm(place, move, z_mm)
    ways = []
    for size_mm, other_mm, names in ((right_mm, back_mm, ("right", "left")), (back_mm, right_mm, ("back", "front"))):
        if abs(size_mm) > 0.4 * abs(other_mm):
            ways.append(names[0] if size_mm > 0 else names[1])
    return f"{_rounded(float(np.hypot(right_mm, back_mm)))} mm to the {' and the '.join(ways)}"


def _area_mm2(place: Place, mask: np.ndarray, z_mm: float, findings: Findings) -> float:
    x, y = middle_of(mask) + [findings.window[1].start, findings.window[0].start]
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
