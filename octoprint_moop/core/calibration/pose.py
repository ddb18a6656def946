"""Where the camera stands: the pose from ring markers, estimated with the circles themselves.

The paper solves for the pose with the centres of the fitted ellipses. An ellipse's centre is not where the circle's
centre is seen, and a printed disc shows its side as well, so that leaves several pixels. Here the discs' outlines (the
hull of both rims, drawn through the lens) are fitted to the edges measured in the picture.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Callable

import cv2
import numpy as np

from ..camera import Camera
from ..errors import CalibrationError, CameraError
from ..expected.lens import outermost_ray
from ..segmentation.segment import HsvThresholds, hsv
from .assign import Assignment, assignments
from .calibrate import Lens, mean_max_json
from .fit import Solution, least_squares, numeric_slopes
from .markers import Disc, MarkerPlate, find_discs
from .notes import doubt_of, not_found, notes_on
from .outline import Feet, drop_feet, hole_outline, inner_colour, marker_outline, measure_edge_px

# Radians, mm; px of the edges' common offset, and by which part of its height a marker's side looks lower than it is.
_STEPS = np.array([1e-4] * 3 + [0.02] * 3 + [0.01, 0.01])
_OFFSET_SPREAD_PX, _RAISED_SPREAD = 0.5, 0.3  # how far these usually are from none
_ALONG_EDGE = 8.0  # neighbouring edge points share their error
_LEAST_EDGES = 0.4  # of an outline that must be seen
_STRAY_RATIO = 0.12  # of edge points that may lie off the outlines: something stands in front, or touches a marker
_STRAY_OF_PICTURE, _STRAY_OF_MARKER = 1 / 800, 0.015  # how far is off, of the picture's and a marker's width
_WORST_OFFSET_PX = 1.5
_GOOD_ROUGH_PX, _WORST_ROUGH_PX = 2.0, 4.0
_HEIGHT_MM = 100.0  # above the bed, up to which the pose's accuracy is told


@dataclass(frozen=True, eq=False)
class PoseResult:
    """A camera in its place, and how well it is known.

    rms_px     : of the edges (or clicked points) from where the camera puts them
    markers_px : for each marker (or clicked point) its position in the picture, None where it was not found
    error_px   : (mean, max) standard error of a point's pixel, over the measured area and up to 100 mm above it
    error_mm   : (mean, max) the same, as a length on the bed
    covariance : (6, 6) of rvec and tvec_mm
    notes      : sentences for the user
    """

    camera: Camera
    rms_px: float
    markers_px: tuple[tuple[float, float] | None, ...]
    error_px: tuple[float, float]
    error_mm: tuple[float, float]
    covariance: np.ndarray
    notes: tuple[str, ...] = ()

    def to_json(self) -> dict[str, Any]:
        return {
            **self.camera.to_json(),
            "rms_px": round(self.rms_px, 4),
            "markers_px": [None if px is None else [round(px[0], 3), round(px[1], 3)] for px in self.markers_px],
            "error_px": mean_max_json(self.error_px),
            "error_mm": mean_max_json(self.error_mm),
            "notes": list(self.notes),
        }


@dataclass(frozen=True, eq=False)
class _Fitted:
    camera: Camera
    solution: Solution
    markers: tuple[int, ...]  # those whose edges were used

    @property
    def rms_px(self) -> float:
        return float(np.sqrt((self.solution.residuals[:-2] ** 2).mean()))


def calibrate_pose(image: np.ndarray, lens: Lens, plate: MarkerPlate, colour: HsvThresholds) -> PoseResult:
    """The camera's pose from one picture of the plate's markers.

    image : (H, W, 3) uint8 BGR, of the lens's size or another of the same shape
    Raises CalibrationError, with the reason, where fewer than three markers are found, where they can be taken for
    each other, where the picture is mirrored, and where the outlines do not fit; CameraError where the picture's shape
    is not the lens's.
    """
    lens = lens_for(image, lens)
    discs = find_discs(image, colour)
    picture = image.astype(np.float32)
    rough = _rough_fits(assignments(discs, plate, lens), discs, plate, lens)
    limit_px = _rough_limit_px(rough)
    fitted = _fit_all(picture, rough, limit_px, plate, lens)
    if not fitted or len(fitted[0].markers) < len(plate.centres_mm):
        # Three discs can lie as some three of a mirrored plate do by chance; all of them cannot.
        mirrored = plate.mirrored()
        rough = _rough_fits(assignments(discs, mirrored, lens), discs, mirrored, lens)
        reflected = _fit_all(picture, rough, min(limit_px, _rough_limit_px(rough)), mirrored, lens)
        if reflected and (not fitted or len(reflected[0].markers) > len(fitted[0].markers)):
            raise CalibrationError(
                "The picture is mirrored: the markers lie as if seen in a mirror. Switch off one of the flips in the "
                "camera's or the streamer's own settings (both together turn it by half, which is well; OctoPrint's only "
                "turn its pages), or correct the markers' numbers, and try again."
            )
    if not fitted:
        raise CalibrationError(not_found(discs, plate))
    best = fitted[0]
    for other in fitted[1:]:
        apart_px = np.linalg.norm(best.camera.project(plate.tops_mm()) - other.camera.project(plate.tops_mm()), axis=1)
        alike = len(other.markers) == len(best.markers) and other.rms_px < 1.5 * best.rms_px + 0.1
        if alike and not np.nanmax(apart_px) < 3.0:
            raise CalibrationError(
                "The markers can be taken for each other: two poses fit equally well. Use a plate whose markers do not "
                "lie in a regular pattern (`moop markers` makes one), and show all of them."
            )
    camera = best.camera
    tops_px = camera.project(plate.tops_mm())
    covariance = best.solution.covariance[:6, :6]
    low, high = plate.centres_mm.min(axis=0), plate.centres_mm.max(axis=0)
    error_px, error_mm = pose_error(
        lambda values: lens.at(values[:3], values[3:]), best.solution.values[:6], _STEPS[:6], covariance, low, high
    )
    return PoseResult(
        camera=camera, rms_px=best.rms_px,
        markers_px=tuple(
            (float(x), float(y)) if marker in best.markers else None for marker, (x, y) in enumerate(tops_px)
        ),
        error_px=error_px, error_mm=error_mm, covariance=covariance,
        notes=notes_on(camera, best.markers, plate, len(discs)) + doubt_of(error_px[1], lens.image_size_px[0]),
    )  # fmt: skip


def calibrate_pose_any_colour(image: np.ndarray, lens: Lens, plate: MarkerPlate) -> PoseResult:
    """As calibrate_pose, with the markers' colour found by trying the picture's own strong hues. Raises the same."""
    hue, saturation, value = cv2.split(hsv(cv2.GaussianBlur(image, (0, 0), 1.0)))
    strong = (saturation > 0.35) & (value > 0.15)
    counts, _ = np.histogram(hue[strong], bins=36, range=(0, 360))
    smooth = np.convolve(np.concatenate([counts[-1:], counts, counts[:1]]), [1, 2, 1], mode="valid")
    peaks = [k for k in range(36) if smooth[k] >= max(smooth[k - 1], smooth[(k + 1) % 36]) and smooth[k] > 0]
    results: list[PoseResult] = []
    refusal = CalibrationError(not_found([], plate))
    for peak in sorted(peaks, key=lambda k: -smooth[k])[:8]:
        middle = 10.0 * peak + 5
        for saturation_min in (0.6, 0.35):
            colour = HsvThresholds((middle - 20) % 360, (middle + 20) % 360, saturation_min, 0.15)
            try:
                result = calibrate_pose(image, lens, plate, colour)
                if None not in result.markers_px:
                    return result
                results.append(result)
            except CalibrationError as error:
                if "found by their colour" not in str(error):
                    refusal = error
    if not results:
        raise refusal
    return max(results, key=lambda result: (sum(px is not None for px in result.markers_px), -result.rms_px))


def lens_for(image: np.ndarray, lens: Lens) -> Lens:
    """The lens at the picture's size. Raises CameraError where the picture has another shape."""
    size_px = image.shape[1::-1]
    if tuple(size_px) == tuple(lens.image_size_px):
        return lens
    return Lens.of(lens.at(np.zeros(3), np.zeros(3)).resized(size_px))


@dataclass(frozen=True, eq=False)
class _Rough:
    """A guess after the fit to the blobs' contours alone. rms_px : of these, which right guesses have far below wrong ones."""

    contours_px: dict[int, np.ndarray]
    values: np.ndarray
    rms_px: float


def _rough_fits(guesses: Sequence[Assignment], discs: Sequence[Disc], plate: MarkerPlate, lens: Lens) -> list[_Rough]:
    """The best first, those with more markers before those with fewer."""
    rough = []
    for guess in guesses:
        values = np.concatenate([guess.camera.rvec, guess.camera.tvec_mm, [0.0, 0.0]])
        contours = {marker: _thinned(discs[disc].contour_px) for marker, disc in guess.pairs}
        try:
            fit = _fit_edges(contours, {}, values, plate, lens, outlier_px=1.5)
        except CameraError:
            continue
        rough.append(_Rough(contours, fit.values, fit.rms))
    return sorted(rough, key=lambda fit: (-len(fit.contours_px), fit.rms_px))


def _fit_all(
    picture: np.ndarray, rough: Sequence[_Rough], limit_px: float, plate: MarkerPlate, lens: Lens
) -> list[_Fitted]:
    """Those that the picture bears out, the best first; rough fits beyond `limit_px` are not tried."""
    fitted: list[_Fitted] = []
    for guess in rough:  # the most markers first: a guess at fewer cannot win any more
        if fitted and len(guess.contours_px) < max(len(fit.markers) for fit in fitted):
            break
        fit = _fit_guess(picture, guess, plate, lens) if guess.rms_px <= limit_px else None
        fitted += [] if fit is None else [fit]
    return sorted(fitted, key=lambda fit: (-len(fit.markers), fit.rms_px))


def _fit_guess(picture: np.ndarray, guess: _Rough, plate: MarkerPlate, lens: Lens) -> _Fitted | None:
    """To the edges of the picture itself; None where they do not bear it out."""
    values, contours = guess.values, guess.contours_px
    try:
        for reach in (0.35, 0.22, 0.22):
            camera = lens.at(values[:3], values[3:6])
            edges, holes = _measure(picture, camera, plate, _raised(values), reach, tuple(contours))
            if len(edges) < 3:
                return None
            # At 0 nothing pulls the sides up, so a start from higher is tried beside.
            solution = min(
                (
                    _fit_edges(edges, holes, np.append(values[:7], raised), plate, lens, outlier_px=0.6)
                    for raised in (0.0, 0.4)
                ),
                key=lambda tried: tried.rms,
            )
            values = solution.values
        camera = lens.at(values[:3], values[3:6])
    except CameraError:
        return None
    distance_mm = np.linalg.norm(plate.tops_mm() - camera.centre_mm, axis=1).mean()
    width_px = plate.outer_diameter_mm * camera.K[0, 0] / distance_mm
    limit_px = max(1.0, _STRAY_OF_PICTURE * lens.image_size_px[0], _STRAY_OF_MARKER * width_px)
    strays = np.abs(solution.residuals[:-2]) > limit_px
    if strays.mean() > _STRAY_RATIO or abs(values[6]) > _WORST_OFFSET_PX or camera.centre_mm[2] <= plate.height_mm:
        return None
    return _Fitted(camera, solution, tuple(sorted(edges)))


def _rough_limit_px(rough: Sequence[_Rough]) -> float:
    """Beyond which a guess need not be looked at: far worse than the best one, or hopeless."""
    best_px = min((fit.rms_px for fit in rough), default=_WORST_ROUGH_PX)
    return min(_WORST_ROUGH_PX, max(_GOOD_ROUGH_PX, 3 * best_px + 0.5))


def _raised(values: np.ndarray) -> float:
    """A side never looks higher than it is."""
    return float(np.clip(values[7], 0.0, 0.9))


def _thinned(points_px: np.ndarray) -> np.ndarray:
    return points_px[:: max(1, len(points_px) // 72)]


def _measure(
    picture: np.ndarray, camera: Camera, plate: MarkerPlate, raised: float, reach: float, colours_from: Sequence[int]
) -> tuple[dict[int, np.ndarray], dict[int, np.ndarray]]:
    """Edges of outlines and of holes by marker, (N, 2) px each; only markers of which enough is seen.

    A marker that was not among the blobs (`colours_from`) is taken in where its outline stands out all the same.
    """
    edges: dict[int, np.ndarray] = {}
    holes: dict[int, np.ndarray] = {}
    known = []
    outlines = {}
    for marker in range(len(plate.centres_mm)):
        outline = marker_outline(camera, plate, marker, raised)
        if outline is not None:
            outlines[marker] = outline_px = outline.px
            colour = inner_colour(picture, outline_px) if marker in colours_from else None
            if colour is not None:
                known.append(colour)
    common = np.median(known, axis=0) if known else None
    for marker, outline_px in outlines.items():
        colour = inner_colour(picture, outline_px)
        if colour is None or (marker not in colours_from and (common is None or _unlike(colour, common))):
            continue
        width_px = float(min(cv2.minAreaRect(outline_px.astype(np.float32))[1]))
        reach_px = float(np.clip(reach * width_px, 3.0, 12.0))
        edge_px = measure_edge_px(picture, outline_px, reach_px, colour)
        if len(edge_px) >= _LEAST_EDGES * 72:
            edges[marker] = edge_px
            hole = hole_outline(camera, plate, marker, raised)
            if hole is not None and hole_outline(camera, plate, marker, 0.0) is not None:
                holes[marker] = measure_edge_px(picture, hole.px, min(reach_px, 4.0), colour, inwards=True)
    return edges, {marker: hole_px for marker, hole_px in holes.items() if len(hole_px) >= 24}


def _unlike(colour: np.ndarray, common: np.ndarray) -> bool:
    """Whether two colours differ by more than light and shadow: the angle between them, and their brightness."""
    norms = float(np.linalg.norm(colour) * np.linalg.norm(common))
    if norms < 1 or float(colour @ common) / norms < 0.95:
        return True
    return not 0.3 < float(np.linalg.norm(colour) / np.linalg.norm(common)) < 3


def _fit_edges(
    edges: dict[int, np.ndarray],
    holes: dict[int, np.ndarray],
    start: np.ndarray,
    plate: MarkerPlate,
    lens: Lens,
    outlier_px: float,
) -> Solution:
    """rvec, tvec_mm, the edges' common outward offset in px, which blur and the camera's tone curve cause, and how far
    the markers' sides look raised, which shadow causes.

    The last two residuals are those two's own: edges spread, but never far.
    """
    count = sum(map(len, [*edges.values(), *holes.values()]))

    def feet(values: np.ndarray) -> list[tuple[Feet, float]] | None:
        """Each marker's feet, and the sign with which the offset counts; None where one is out of sight."""
        try:
            camera = lens.at(values[:3], values[3:6])
        except CameraError:
            return None
        found: list[tuple[Feet, float]] = []
        for measured, outline_of, sign in ((edges, marker_outline, 1.0), (holes, hole_outline, -1.0)):
            for marker, edge_px in measured.items():
                outline = outline_of(camera, plate, marker, _raised(values))
                if outline is None:
                    return None
                found.append((drop_feet(edge_px, outline), sign))
        return found

    def misses(values: np.ndarray) -> np.ndarray:
        found = feet(values)
        if found is None:
            return np.full(count + 2, np.nan)
        usual = [values[6] / _OFFSET_SPREAD_PX, values[7] / _RAISED_SPREAD]
        return np.concatenate([*(foot.distance_px - sign * values[6] for foot, sign in found), usual])

    def slopes(values: np.ndarray) -> np.ndarray:
        # A foot slides along the outline without changing the distance, so its place in the room may be held.
        found = feet(values)
        if found is None:
            raise CameraError("A marker is out of sight from where the camera was thought to be.")
        feet_mm, normal = np.vstack([foot.feet_mm for foot, _ in found]), np.vstack([foot.normal for foot, _ in found])
        moved = numeric_slopes(lambda v: lens.at(v[:3], v[3:]).project(feet_mm), values[:6], _STEPS[:6])
        of_pose = -(normal[:, :, None] * moved).sum(axis=1)
        of_offset = np.concatenate([np.full(len(foot.distance_px), -sign) for foot, sign in found])
        # The lower rim rises as a whole, points between both rims in part.
        rise_mm = (plate.height_mm - feet_mm[:, 2:]) / (1 - _raised(values)) * [[0, 0, float(values[7] > 0)]]
        camera = lens.at(values[:3], values[3:6])
        lifted = (camera.project(feet_mm + 0.05 * rise_mm) - camera.project(feet_mm - 0.05 * rise_mm)) / 0.1
        of_raised = -(normal * lifted).sum(axis=1)
        usual = np.zeros((2, 8))
        usual[0, 6], usual[1, 7] = 1 / _OFFSET_SPREAD_PX, 1 / _RAISED_SPREAD
        return np.vstack([np.column_stack([of_pose, of_offset, of_raised]), usual])

    return least_squares(misses, start, _STEPS, outlier_px, _ALONG_EDGE, rounds=25, slopes_of=slopes)


def pose_error(
    place: Callable[[np.ndarray], Camera],
    values: np.ndarray,
    steps: np.ndarray,
    covariance: np.ndarray,
    low_mm: np.ndarray,
    high_mm: np.ndarray,
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Standard error of where points are seen: (mean, max) in px, and the same as millimetres at the points' depth.

    place : makes the camera of some values; steps and covariance belong to them
    Over the box from low_mm to high_mm (X, Y) and up to 100 mm above the bed, as far as the picture shows it; points
    nearer to the camera than a third of the farthest are left out. Infinite where the covariance is.
    """
    if not np.isfinite(covariance).all():
        return (math.inf, math.inf), (math.inf, math.inf)
    camera = place(values)
    axes = [np.linspace(low, high, 5) for low, high in zip(low_mm, high_mm)] + [np.linspace(0, _HEIGHT_MM, 4)]
    points = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 3)
    distance_mm = np.linalg.norm(points - camera.centre_mm, axis=1)
    seen_px = camera.project(points)
    in_camera = points @ camera.camera_from_room[:3, :3].T + camera.tvec_mm
    # Near the outermost ray the lens's polynomial turns back, and says nothing any more.
    sharp = np.hypot(in_camera[:, 0], in_camera[:, 1]) < 0.9 * outermost_ray(camera) * in_camera[:, 2]
    inside = ((seen_px >= 0) & (seen_px < camera.image_size_px)).all(axis=1) & sharp
    inside &= distance_mm > distance_mm.max() / 3
    if not inside.any():
        return (math.inf, math.inf), (math.inf, math.inf)
    points, distance_mm = points[inside], distance_mm[inside]
    slopes_px = numeric_slopes(lambda moved: place(moved).project(points), values, steps)  # points, xy, values
    variance = np.einsum("pij,jk,pik->p", slopes_px, covariance, slopes_px)
    error_px = np.sqrt(np.maximum(variance, 0))
    error_mm = error_px * distance_mm / camera.K[0, 0]
    return (float(error_px.mean()), float(error_px.max())), (float(error_mm.mean()), float(error_mm.max()))
