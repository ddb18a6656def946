"""What kind of failure is it, how large, and since when? From where matter is missing and where it is too much."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from .decide import Outcome
from .evidence import WHOLE, Findings
from .expected import Expected, PrintMap

WARPING, DETACHMENT, EXTRUSION_FAILURE = "warping", "detachment", "extrusion_failure"
LAYER_SHIFT, STRAY_MATERIAL, UNKNOWN = "layer_shift", "stray_material", "unknown"

BASE_GONE_RATIO = 0.12  # of the lower part's established matter lost: the object no longer stands where it stood
STANDS_RATIO = 0.05
SHARE = 0.35  # how much smaller the one of two areas may be to count as its counterpart


@dataclass(frozen=True)
class Diagnosis:
    """mode: one of FORMATS.md, section 4; sentence: for the user, with a magnitude where it makes sense."""

    mode: str
    sentence: str


def diagnose(
    outcome: Outcome,
    findings: Findings,
    print_map: PrintMap,
    expected: Expected,
    observed: np.ndarray,
    layer: int,
    px_per_mm: float,
) -> Diagnosis:
    """Name what `outcome` found in its scope. observed: (H, W) uint8; px_per_mm: at the print, for magnitudes."""
    scope = _Scope(outcome.object_id, findings, print_map, expected, observed, layer)
    if outcome.leading.kind == "fresh" and scope.lost_ratio < STANDS_RATIO:
        if scope.stray_px < SHARE * scope.unseen_px:
            since = scope.first_unseen_layer()
            return Diagnosis(EXTRUSION_FAILURE, f"No new material is seen since layer {since}.")
    if scope.lost_px + scope.unseen_px < SHARE * scope.stray_px and scope.base_lost_ratio < BASE_GONE_RATIO:
        area_mm2 = scope.stray_px / px_per_mm**2
        return Diagnosis(STRAY_MATERIAL, f"Material lies where none should be, about {_rounded(area_mm2)} mm² of it.")
    if scope.base_lost_ratio >= BASE_GONE_RATIO:
        if scope.stray_px < 0.1 * scope.lost_px:
            return Diagnosis(DETACHMENT, "The print is gone from its place.")
        distance_mm = scope.displacement_px() / px_per_mm
        return Diagnosis(DETACHMENT, f"The print has come off: it lies about {_rounded(distance_mm)} mm from its place.")
    if scope.lost_low and scope.stray_px < scope.lost_px:
        return Diagnosis(WARPING, "A corner has lifted off the bed.")
    shifted = scope.shift_px()
    if shifted:
        above, distance_px = shifted
        return Diagnosis(
            LAYER_SHIFT, f"Everything above layer {above} is shifted by about {_rounded(distance_px / px_per_mm)} mm."
        )
    if scope.stray_px > scope.lost_px:
        return Diagnosis(STRAY_MATERIAL, "Material lies beside where it should be.")
    if outcome.leading.kind == "fresh":
        return Diagnosis(EXTRUSION_FAILURE, f"Too little new material is seen since layer {scope.first_unseen_layer()}.")
    return Diagnosis(UNKNOWN, "The print no longer looks as it should.")


class _Scope:
    """The findings of one object, or of the whole print, counted in the ways the modes ask for."""

    def __init__(
        self, object_id: int, findings: Findings, print_map: PrintMap, expected: Expected, observed: np.ndarray, layer: int
    ) -> None:
        inside = np.ones(print_map.layer.shape, bool) if object_id == WHOLE else print_map.owner == object_id
        around = np.ones(print_map.layer.shape, bool) if object_id == WHOLE else print_map.nearest == object_id
        self.layer = layer
        self._layer_of = print_map.layer
        self._wanted = (expected.mask > 0) & inside
        self._seen = observed > 0
        self._around = around
        self._lost = findings.lost & inside
        self._stray = findings.stray & around
        layers = max(layer + 1, 1)
        self._lost_by_layer = self._by_layer(self._lost, layers)
        self._wanted_by_layer = self._by_layer(self._wanted, layers)
        self._seen_by_layer = self._by_layer(self._wanted & self._seen, layers)
        self.lost_px = int(self._lost_by_layer.sum())
        self.stray_px = int(np.count_nonzero(self._stray))
        self.lost_ratio = self.lost_px / max(int(self._wanted_by_layer.sum()), 1)
        recent = slice(max(0, layers - 4), layers)
        self.unseen_px = int((self._wanted_by_layer - self._seen_by_layer)[recent].sum())

    def _by_layer(self, mask: np.ndarray, layers: int) -> np.ndarray:
        found = self._layer_of[mask]
        return np.bincount(found[found >= 0], minlength=layers)[:layers]

    @property
    def base_lost_ratio(self) -> float:
        """How much of what the first layers cover is lost: the part of an object that nothing but leaving can move."""
        return self._lost_share(0, self._base_layers)

    @property
    def _base_layers(self) -> int:
        """The layers that make the first third of the silhouette."""
        covered = np.cumsum(self._wanted_by_layer)
        return int(np.searchsorted(covered, covered[-1] / 3)) + 1 if covered[-1] else 1

    @property
    def lost_low(self) -> bool:
        """Whether what is lost lies low: at the corners' feet, and not further up."""
        low = self._lost_share(0, self._base_layers)
        return low > 0.005 and low > 2 * self._lost_share(self._base_layers, self.layer + 1)

    def _lost_share(self, first: int, last: int) -> float:
        return self._lost_by_layer[first:last].sum() / max(self._wanted_by_layer[first:last].sum(), 1)

    def first_unseen_layer(self) -> int:
        """Going back from the last layer, the first of those of which mostly nothing is seen."""
        first = self.layer
        for layer in range(self.layer, -1, -1):
            if self._wanted_by_layer[layer] < 5:
                continue
            if self._seen_by_layer[layer] > 0.5 * self._wanted_by_layer[layer]:
                break
            first = layer
        return first

    def displacement_px(self) -> float:
        """How far the observed matter's middle lies from the expected one's."""
        there = _middle(self._seen & self._around)
        here = _middle(self._wanted)
        return float(np.hypot(*(there - here)))

    def shift_px(self) -> tuple[int, float] | None:
        """(layer, pixels): above which layer everything is displaced and by how much; None where it is not so.

        The mask of what lies above is moved about until it covers most of what is seen there.
        """
        wrong = self._lost_by_layer + (self._wanted_by_layer - self._seen_by_layer)
        above = int(np.searchsorted(np.cumsum(wrong), 0.05 * max(wrong.sum(), 1)))
        upper = self._wanted & (self._layer_of >= above)
        if np.count_nonzero(upper) < 30:
            return None
        reach = 40
        rows, columns = np.nonzero(upper)
        top, left = max(rows.min() - reach, 0), max(columns.min() - reach, 0)
        window = np.s_[top : rows.max() + reach + 1, left : columns.max() + reach + 1]
        lower = (self._wanted & ~upper)[window]
        seen = np.where(self._seen[window] & ~lower, 1.0, np.where(lower, 0.0, -0.5)).astype(np.float32)
        template = upper[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1].astype(np.float32)
        score = cv2.matchTemplate(seen, template, cv2.TM_CCORR)
        _, best, _, (column, row) = cv2.minMaxLoc(score)
        unmoved = score[rows.min() - top, columns.min() - left]
        distance_px = float(np.hypot(row - (rows.min() - top), column - (columns.min() - left)))
        if distance_px < 1.5 or best < 0.5 * template.sum() or best - unmoved < 0.1 * template.sum():
            return None
        return above, distance_px


def _middle(mask: np.ndarray) -> np.ndarray:
    rows, columns = np.nonzero(mask)
    return np.array([np.median(columns), np.median(rows)]) if len(rows) else np.zeros(2)


def _rounded(value: float) -> str:
    return f"{value:.0f}" if value >= 3 else f"{value:.1f}"
