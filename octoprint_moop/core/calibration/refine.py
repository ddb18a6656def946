"""How far a calibration is off, by the silhouette of a print that goes well, and a better camera where that is safe.

The edge of each expected mask is compared with the edge of the mask observed. What a small move of the camera explains
is the calibration's fault; what it does not explain is the print's, the segmentation's, or the bed's, and left alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from ..camera import Camera
from ..errors import CameraError
from ..expected.views import Expected
from ..toolpath import Toolpath
from .calibrate import Lens
from .fit import least_squares

_REACH_PX = 10.0
_STEPS = np.array([1e-4] * 3 + [0.02] * 3)
_TURN_SPREAD, _SHIFT_SPREAD_MM = 0.01, 3.0  # radians and mm by which a camera is usually off
_MOST_POINTS = 300  # of one view
_LEAST_POINTS = 40
_LEAST_MATCHED = 0.7  # of the expected edge that must be seen nearby
_WORST_LEFT_PX = 1.2
_WORTHWHILE_PX = 0.3
_FARTHEST_PX = 8.0


@dataclass(frozen=True, eq=False)
class SilhouetteView:
    """One check of a print that was judged well. `observed`: (H, W) uint8 mask in the camera's own pixels;
    `ignored`: the same, non-zero where nothing may be concluded, or None; room_from_print_mm as in BedMotion."""

    expected: Expected
    observed: np.ndarray
    room_from_print_mm: np.ndarray
    ignored: np.ndarray | None = None


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

    def to_json(self) -> dict[str, Any]:
        return {
            "off_px": round(self.off_px, 3), "left_px": round(self.left_px, 3),
            "matched_ratio": round(self.matched_ratio, 3), "why": self.why,
            "camera": None if self.camera is None else self.camera.to_json(),
        }  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Edges:
    points_mm: np.ndarray  # (N, 3) in the room, on the bead that makes the edge
    at_px: np.ndarray  # (N, 2) expected edge
    normal: np.ndarray  # (N, 2) outwards
    off_px: np.ndarray  # (N,) observed edge along the normal


def refine_camera(camera: Camera, toolpath: Toolpath, views: Sequence[SilhouetteView]) -> Refinement:
    """How far `camera` is off by these views (of one camera, at several layers), and a better one where that is safe.

    Safe means: at least three views, most of each expected edge seen nearby, the rest after the move small, and each
    view bettered by a move that was found without it. A print that bends, lies elsewhere or lacks matter fails that.
    """
    measured = [_measure(camera, toolpath, view) for view in views]
    matched_ratio = float(np.mean([ratio for _, ratio in measured])) if measured else 0.0
    edges = [edge for edge, ratio in measured if edge is not None and ratio >= _LEAST_MATCHED]
    if not edges:
        return Refinement(float("nan"), float("nan"), matched_ratio, None,
                          "Too little of the print's edge was seen to judge the calibration by.")  # fmt: skip
    off_px = _rms([_unexplained(camera, camera, edge) for edge in edges])
    if len(edges) < 3:
        return Refinement(off_px, off_px, matched_ratio, None,
                          f"{len(edges)} layers can be judged by; three are needed to better the camera.")  # fmt: skip
    better = _fit(camera, edges)
    if better is None:
        return Refinement(off_px, off_px, matched_ratio, None, "No nearby camera fits the print's edges better.")
    left_px = _rms([_unexplained(camera, better, edge) for edge in edges])
    why = _unsafe(camera, better, edges, off_px, left_px)
    if why:
        return Refinement(off_px, left_px, matched_ratio, None, why)
    why = f"The camera was {off_px:.1f} px off by {len(edges)} layers; corrected, {left_px:.1f} px are left."
    return Refinement(off_px, left_px, matched_ratio, better, why)


def _unsafe(camera: Camera, better: Camera, edges: list[_Edges], off_px: float, left_px: float) -> str:
    """Why the better camera must not be taken, or ""."""
    if off_px - left_px < _WORTHWHILE_PX:
        return f"The calibration fits the print to {off_px:.1f} px; a correction would gain {off_px - left_px:.1f} px."
    if left_px > _WORST_LEFT_PX:
        return (
            f"The print's edges are {off_px:.1f} px off, and {left_px:.1f} px even with the best camera: that is not "
            "the calibration alone. Look at the print, the filament's colour and the bed's motion."
        )
    moved_px = np.linalg.norm(better.project(edges[0].points_mm) - camera.project(edges[0].points_mm), axis=1).max()
    if not moved_px < _FARTHEST_PX:
        return f"The camera seems to be {moved_px:.0f} px off, too far to correct unasked. Calibrate the pose again."
    for left_out in range(len(edges)):
        without = _fit(camera, edges[:left_out] + edges[left_out + 1 :])
        before_px = _rms([_unexplained(camera, camera, edges[left_out])])
        if without is None or _rms([_unexplained(camera, without, edges[left_out])]) > before_px:
            return "The layers do not agree on how the camera is off, so it is left as it is."
    return ""


def _measure(camera: Camera, toolpath: Toolpath, view: SilhouetteView) -> tuple[_Edges | None, float]:
    """The expected edge with what was observed along its normals, and which part of it was matched."""
    mask = view.expected.mask
    contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    pixels = np.vstack([contour.reshape(-1, 2) for contour in contours]) if contours else np.empty((0, 2), int)
    height, width = mask.shape
    inside = ((pixels > 2) & (pixels < [width - 3, height - 3])).all(axis=1)
    if view.ignored is not None:
        wide = cv2.dilate(view.ignored, np.ones((7, 7), np.uint8))
        inside &= wide[pixels[:, 1], pixels[:, 0]] == 0
    pixels = pixels[inside]
    if len(pixels) < _LEAST_POINTS:
        return None, 0.0
    pixels = pixels[:: max(1, len(pixels) // _MOST_POINTS)]
    smooth = cv2.GaussianBlur(mask.astype(np.float32) / 255, (0, 0), 2.0)
    slope = np.dstack([cv2.Sobel(smooth, cv2.CV_32F, 1, 0), cv2.Sobel(smooth, cv2.CV_32F, 0, 1)])
    outward = -slope[pixels[:, 1], pixels[:, 0]]
    normal = outward / np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-6)
    seen = cv2.GaussianBlur(view.observed.astype(np.float32) / 255, (0, 0), 1.0)
    own = cv2.GaussianBlur(mask.astype(np.float32) / 255, (0, 0), 1.0)
    off_px = _crossing(seen, pixels, normal) - _crossing(own, pixels, normal)
    found = np.isfinite(off_px)
    beads = view.expected.birth[pixels[:, 1], pixels[:, 0]].astype(np.int64) - 1
    points_mm = _on_beads(camera, toolpath, beads, pixels.astype(np.float64), view.room_from_print_mm)
    return (
        _Edges(points_mm[found], pixels[found].astype(np.float64), normal[found], off_px[found]),
        float(found.mean()),
    )


def _crossing(soft: np.ndarray, pixels: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """(N,) float64: where along each normal the mask ends, nearest to the pixel; NaN where it does not."""
    offsets = np.arange(-_REACH_PX, _REACH_PX + 0.1, 0.5)
    where = pixels[:, None] + offsets[None, :, None] * normal[:, None]
    line = cv2.remap(soft, where[..., 0].astype(np.float32), where[..., 1].astype(np.float32), cv2.INTER_LINEAR)
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


def _unexplained(camera: Camera, other: Camera, edge: _Edges) -> np.ndarray:
    """(N,) px: the observed edge from where `other` expects it, less the middle: masks are wide all round."""
    moved = ((other.project(edge.points_mm) - camera.project(edge.points_mm)) * edge.normal).sum(axis=1)
    left = edge.off_px - moved
    return left - np.median(left)


def _rms(parts: list[np.ndarray]) -> float:
    """Of the better nine tenths: a strand or a hand at the edge is not the camera."""
    sizes = np.sort(np.abs(np.concatenate(parts)))
    return float(np.sqrt((sizes[: max(1, int(0.9 * len(sizes)))] ** 2).mean()))


def _fit(camera: Camera, edges: list[_Edges]) -> Camera | None:
    start = np.concatenate([camera.rvec, camera.tvec_mm])
    lens = Lens.of(camera)

    def misses(values: np.ndarray) -> np.ndarray:
        try:
            other = lens.at(values[:3], values[3:])
        except CameraError:
            return np.full(sum(len(edge.off_px) for edge in edges) + 6, np.nan)
        usual = (values - start) / ([_TURN_SPREAD] * 3 + [_SHIFT_SPREAD_MM] * 3)
        return np.concatenate([*(_unexplained(camera, other, edge) for edge in edges), usual])

    values = least_squares(misses, start, _STEPS, outlier=1.0, rounds=20).values
    try:
        return replace(camera, rvec=values[:3], tvec_mm=values[3:])
    except CameraError:
        return None
