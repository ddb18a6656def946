"""How far a calibration is off, by the silhouette of a print that goes well, and a better camera where that is safe.

The edge of each expected mask is compared with the edge of the mask observed. What a small move of the camera explains
is the calibration's fault; what it does not explain is the print's, the segmentation's, or the bed's, and left alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from ..camera import Camera
from ..errors import CameraError
from ..expected.views import Expected
from ..toolpath import Toolpath
from .fit import numeric_slopes

_REACH_PX = 10.0
_WIDE_PX = 5
_STEPS = np.array([1e-4] * 3 + [0.02] * 3)
_TURN_SPREAD, _SHIFT_SPREAD_MM = 0.01, 2.0  # radians and mm by which a camera is usually off
_EDGE_SPREAD_PX, _ALONG_EDGE = 0.4, 20.0  # of an edge point; how many neighbouring ones share their error
_OUTLIER_PX = 1.0
_FEWEST_LAYERS = 3
_MOST_POINTS = 300  # of one view
_LEAST_POINTS = 40
_LEAST_MATCHED = 0.7  # of the expected edge that must be seen nearby
_WORST_LEFT_PX = 1.2
_WORTHWHILE_PX, _UNEVEN = 0.15, 0.1
_FARTHEST_PX = 8.0


@dataclass(frozen=True, eq=False)
class SilhouetteView:
    """One check of a print that was judged well. `observed`: (H, W) uint8 mask in the camera's own pixels;
    `ignored`: the same, non-zero where nothing may be concluded, or None; room_from_print_mm as in BedMotion.
    corner_px : (x, y) in the camera's picture of the masks' first pixel"""

    expected: Expected
    observed: np.ndarray
    room_from_print_mm: np.ndarray
    ignored: np.ndarray | None = None
    corner_px: tuple[int, int] = (0, 0)


@dataclass(frozen=True, eq=False)
class Refinement:
    """off_px  : root mean square distance of expected from observed edges, a common widening taken out
    left_px    : the same with the better camera
    matched_ratio : part of the expected edges that was found in the observed masks
    camera     : the better camera, None where it would not be safe or not worth it
    why        : a sentence: what was done, or why nothing was
    """

    off_px: float
    left_px: float
    matched_ratio: float
    camera: Camera | None
    why: str
    moved_px: float = 0.0


@dataclass(frozen=True, eq=False)
class SilhouetteEdges:
    """points_mm (N, 3) in the room, on the beads that make the edge; normal (N, 2), outwards in the picture; off_px (N,)
    observed edge from the expected one along it. matched_ratio : part of the expected edge for which one was found."""

    points_mm: np.ndarray
    normal: np.ndarray
    off_px: np.ndarray
    matched_ratio: float


def refine_camera(camera: Camera, layers: Sequence[SilhouetteEdges]) -> Refinement:
    """How far `camera` is off by these edges (of one camera, at several layers), and a better one where that is safe.

    Safe means: at least three layers, most of each expected edge seen nearby, the rest after the move small, and each
    layer bettered by a move that was found without it. A print that bends, lies elsewhere or lacks matter fails that.
    """
    matched_ratio = float(np.mean([edges.matched_ratio for edges in layers])) if layers else 0.0
    good = [edges for edges in layers if edges.matched_ratio >= _LEAST_MATCHED and len(edges.off_px) >= _LEAST_POINTS]
    if not good:
        return Refinement(float("nan"), float("nan"), matched_ratio, None,
                          "Too little of the print's edge was seen to judge the calibration by.")  # fmt: skip
    off_px = _rms([_unexplained(camera, camera, edges) for edges in good])
    if len(good) < _FEWEST_LAYERS:
        return Refinement(off_px, off_px, matched_ratio, None,
                          f"{len(good)} layers can be judged by; three are needed to better the camera.")  # fmt: skip
    fits = _Fits(camera, good)
    better = fits.best()
    if better is None:
        return Refinement(off_px, off_px, matched_ratio, None, "No nearby camera fits the print's edges better.")
    left_px = _rms([_unexplained(camera, better, edges) for edges in good])
    why = _unsafe(camera, better, fits, good, off_px, left_px)
    if why:
        return Refinement(off_px, min(left_px, off_px), matched_ratio, None, why)
    moved_px = float(np.sqrt(np.mean(_apart_px(camera, better, good) ** 2)))
    why = f"The camera was {moved_px:.1f} px off by {len(good)} layers; corrected, {left_px:.1f} px are left."
    return Refinement(off_px, left_px, matched_ratio, better, why, moved_px)


def _unsafe(
    camera: Camera, better: Camera, fits: _Fits, layers: list[SilhouetteEdges], off_px: float, left_px: float
) -> str:
    """Why the better camera must not be taken, or ""."""
    # A mask that is wide all round is not equally wide everywhere.
    wide_px = abs(float(np.median([np.median(edges.off_px) for edges in layers])))
    if off_px - left_px < _WORTHWHILE_PX + _UNEVEN * wide_px:
        return f"The calibration fits the print to {off_px:.1f} px; a correction would gain {off_px - left_px:.1f} px."
    if left_px > _WORST_LEFT_PX:
        return (
            f"The print's edges are {off_px:.1f} px off, and {left_px:.1f} px even with the best camera: that is not "
            "the calibration alone. Look at the print, the filament's colour and the bed's motion."
        )
    moved_px = _apart_px(camera, better, layers).max()
    if not moved_px < _FARTHEST_PX:
        return f"The camera seems to be {moved_px:.0f} px off, too far to correct unasked. Calibrate the pose again."
    for left_out in range(len(layers)):
        without = fits.without(left_out, better)
        before_px = _rms([_unexplained(camera, camera, layers[left_out])])
        if without is None or _rms([_unexplained(camera, without, layers[left_out])]) > before_px:
            return "The layers do not agree on how the camera is off, so it is left as it is."
    return ""


def silhouette_edges(camera: Camera, toolpath: Toolpath, view: SilhouetteView) -> SilhouetteEdges:
    """The expected edge of one view, with what was observed along its normals. `camera`: the one of the view."""
    # Skirts and lone lines of a bead's width are seen or not as the light falls, and frame all the rest.
    wide = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (_WIDE_PX, _WIDE_PX))
    mask, observed = (cv2.morphologyEx(m, cv2.MORPH_OPEN, wide) for m in (view.expected.mask, view.observed))
    contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    pixels = np.vstack([contour.reshape(-1, 2) for contour in contours]) if contours else np.empty((0, 2), int)
    height, width = mask.shape
    inside = ((pixels > 2) & (pixels < [width - 3, height - 3])).all(axis=1)
    if view.ignored is not None:
        near = cv2.dilate(view.ignored, np.ones((3, 3), np.uint8))
        inside &= near[pixels[:, 1], pixels[:, 0]] == 0
    pixels = pixels[inside]
    if len(pixels) < _LEAST_POINTS:
        return SilhouetteEdges(np.empty((0, 3)), np.empty((0, 2)), np.empty(0), 0.0)
    pixels = pixels[:: -(-len(pixels) // _MOST_POINTS)]
    hard, seen = (np.multiply(m, np.float32(1 / 255), dtype=np.float32) for m in (mask, observed))
    outward = -_slope(cv2.GaussianBlur(hard, (0, 0), 2.0), pixels)
    normal = outward / np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-6)
    seen, own = (cv2.GaussianBlur(m, (0, 0), 1.0) for m in (seen, hard))
    off_px = _crossing(seen, pixels, normal) - _crossing(own, pixels, normal)
    found = np.isfinite(off_px)
    beads = view.expected.birth[pixels[:, 1], pixels[:, 0]].astype(np.int64) - 1
    points_mm = _on_beads(
        camera, toolpath, beads, pixels + np.array(view.corner_px, np.float64), view.room_from_print_mm
    )
    return SilhouetteEdges(points_mm[found], normal[found], off_px[found], float(found.mean()))


def _slope(smooth: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """(N, 2) float32: Sobel's derivatives, to the right and down, at a few pixels that lie inside."""
    x, y = pixels.T
    around = {(dx, dy): smooth[y + dy, x + dx] for dx in (-1, 0, 1) for dy in (-1, 0, 1) if dx or dy}
    right, left, below, above = (
        around[side] * 2 + around[one] + around[other]
        for side, one, other in (
            ((1, 0), (1, -1), (1, 1)), ((-1, 0), (-1, -1), (-1, 1)), ((0, 1), (-1, 1), (1, 1)), ((0, -1), (-1, -1), (1, -1)),
        )
    )  # fmt: skip
    return np.column_stack([right - left, below - above])


def _crossing(soft: np.ndarray, pixels: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """(N,) float64: where along each normal the mask ends, nearest to the pixel; NaN where it does not."""
    offsets = np.arange(-_REACH_PX, _REACH_PX + 0.1, 0.5)
    x, y = ((pixels[:, axis, None] + offsets * normal[:, axis, None]).astype(np.float32) for axis in (0, 1))
    line = cv2.remap(soft, x, y, cv2.INTER_LINEAR)
    falls = (line[:, :-1] >= 0.5) & (line[:, 1:] < 0.5)
    at = np.where(falls, np.abs(offsets[None, :-1]), np.inf)
    nearest, rows = at.argmin(axis=1), np.arange(len(line))
    high, low = line[rows, nearest], line[rows, nearest + 1]
    crossing = offsets[nearest] + 0.5 * (high - 0.5) / np.maximum(high - low, 1e-6)
    return np.where(np.isfinite(at.min(axis=1)), crossing, np.nan)


def _on_beads(
    camera: Camera, toolpath: Toolpath, beads: np.ndarray, pixels: np.ndarray, shift_mm: np.ndarray
) -> np.ndarray:
    """(N, 3) float64: on each bead the point that is seen nearest to its pixel."""
    lines = np.asarray(toolpath.beads_mm[beads], dtype=np.float64)
    start, end = lines[:, :3] + shift_mm, lines[:, 3:6] + shift_mm
    seen = [camera.project(point) for point in (start, end)]
    run = seen[1] - seen[0]
    share = np.clip(((pixels - seen[0]) * run).sum(axis=1) / np.maximum((run**2).sum(axis=1), 1e-9), 0, 1)[:, None]
    return start + share * (end - start)


def _moved_px(camera: Camera, other: Camera, edges: SilhouetteEdges) -> np.ndarray:
    """(N,) float64: by how much `other` expects each edge further out than `camera`."""
    if other is camera:
        return np.zeros(len(edges.points_mm))
    apart = other.project(edges.points_mm) - camera.project(edges.points_mm)
    return np.asarray((apart * edges.normal).sum(axis=1))


def _apart_px(camera: Camera, other: Camera, layers: Sequence[SilhouetteEdges]) -> np.ndarray:
    points_mm = np.vstack([edges.points_mm for edges in layers])
    return np.asarray(np.linalg.norm(other.project(points_mm) - camera.project(points_mm), axis=1))


def _unexplained(camera: Camera, other: Camera, edges: SilhouetteEdges) -> np.ndarray:
    """(N,) px: the observed edge from where `other` expects it, less the middle: masks are wide all round."""
    left = edges.off_px - _moved_px(camera, other, edges)
    return left - np.median(left)


def _rms(parts: list[np.ndarray]) -> float:
    """Of the better nine tenths: a strand or a hand at the edge is not the camera."""
    sizes = np.sort(np.abs(np.concatenate(parts)))
    return float(np.sqrt((sizes[: max(1, int(0.9 * len(sizes)))] ** 2).mean()))


class _Fits:
    """The camera that edges speak for, weighed against how far cameras usually are off.

    Moves are small, so the edges move in proportion to them: a linear problem, solved with Huber's weights, in which
    each layer has an unknown of its own for how wide the mask is. The proportion is measured once for all fits: over a
    few pixels it changes by hundredths.
    """

    def __init__(self, camera: Camera, layers: Sequence[SilhouetteEdges]) -> None:
        self._camera = camera
        self._every = SilhouetteEdges(
            np.vstack([edges.points_mm for edges in layers]), np.vstack([edges.normal for edges in layers]),
            np.concatenate([edges.off_px for edges in layers]), 1.0,
        )  # fmt: skip
        self._layer = np.repeat(np.arange(len(layers)), [len(edges.off_px) for edges in layers])
        self._start = np.concatenate([camera.rvec, camera.tvec_mm])
        self._slopes: np.ndarray | None = None  # (N, 6) px along the normals for each of rvec and tvec_mm

    def best(self) -> Camera | None:
        """By all layers; None where no camera is."""
        try:
            if self._slopes is None:
                moved = numeric_slopes(
                    lambda values: self._at(values).project(self._every.points_mm), self._start, _STEPS
                )
                self._slopes = np.asarray((moved * self._every.normal[:, :, None]).sum(axis=1))
            values = self._start
            for _ in range(2):
                values = self._bettered(values, np.ones(len(self._layer), bool))
            return self._at(values)
        except (CameraError, np.linalg.LinAlgError):
            return None

    def without(self, layer: int, near: Camera) -> Camera | None:
        """By all layers but one, from the best camera on, which is `near`."""
        try:
            return self._at(self._bettered(np.concatenate([near.rvec, near.tvec_mm]), self._layer != layer))
        except (CameraError, np.linalg.LinAlgError):
            return None

    def _at(self, values: np.ndarray) -> Camera:
        return replace(self._camera, rvec=values[:3], tvec_mm=values[3:])

    def _bettered(self, values: np.ndarray, chosen: np.ndarray) -> np.ndarray:
        assert self._slopes is not None
        here = self._camera if values is self._start else self._at(values)
        left = (self._every.off_px - _moved_px(self._camera, here, self._every))[chosen]
        spread = np.array([_TURN_SPREAD] * 3 + [_SHIFT_SPREAD_MM] * 3)
        wide = self._layer[chosen, None] == np.unique(self._layer[chosen])
        whole = np.hstack([self._slopes[chosen], wide])
        prior = np.zeros((6, whole.shape[1]))
        prior[:, :6] = np.diag(_EDGE_SPREAD_PX / spread)
        pull = (self._start - values) / spread * _EDGE_SPREAD_PX
        change = np.zeros(whole.shape[1])
        for _ in range(8):
            miss = left - whole @ change
            weight = np.minimum(1.0, _OUTLIER_PX / np.maximum(np.abs(miss), 1e-9))
            normal = whole.T @ (weight[:, None] * whole) / _ALONG_EDGE + prior.T @ prior
            change = np.linalg.solve(normal, whole.T @ (weight * left) / _ALONG_EDGE + prior.T @ pull)
        return values + change[:6]
