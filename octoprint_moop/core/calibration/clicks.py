"""The pose from points that a person clicked: the bed's four corners, or others whose millimetres are known.

Where the lens is known the pose is all that is asked. Where it is not, a focal length is found with it, from the points
as far as they tell it and from what webcams usually have; the accuracy that results is told, not hidden.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations
from typing import Any

import cv2
import numpy as np

from ..camera import Camera
from ..errors import CalibrationError, CameraError
from .calibrate import Lens
from .fit import Solution, covariance_of, least_squares
from .notes import roll_deg
from .pose import PoseResult, pose_error

CLICK_PX = 2.0  # how well a person hits a corner
_USUAL_VIEW_DEG = 62.0  # horizontal field of view of common webcams and Raspberry Pi cameras: 50 to 80
# What is not known of an uncalibrated lens: logarithm of the focal length over the usual, k1, and the optical centre's
# place in parts of the picture's width; what is usual, and the standard deviations about it.
_USUAL = np.array([0.0, -0.05, 0.0, 0.0])
_USUAL_SPREAD = np.array([0.25, 0.12, 0.02, 0.02])
_STEPS = np.array([1e-4] * 3 + [0.02] * 3 + [1e-4, 1e-3, 1e-4, 1e-4])
_POOREST_PX = 10.0


@dataclass(frozen=True, eq=False)
class Points:
    """points_mm : (N, 3) float64, print coordinates. points_px : (N, 2) float64, where they are in the picture."""

    points_mm: np.ndarray
    points_px: np.ndarray

    @classmethod
    def from_json(cls, data: Any) -> Points:
        """From [{"mm": [x, y] or [x, y, z], "px": [u, v]}, …], or {"points": that}. Raises CalibrationError."""
        if isinstance(data, dict):
            data = data.get("points")
        if not isinstance(data, Sequence) or isinstance(data, (str, bytes)):
            raise CalibrationError('The points must be a list of {"mm": [x, y, z], "px": [u, v]}.')
        room, pixels = [], []
        for number, point in enumerate(data, 1):
            try:
                mm, px = [float(v) for v in point["mm"]], [float(v) for v in point["px"]]
            except (TypeError, KeyError, ValueError):
                kind = '{"mm": [x, y, z], "px": [u, v]}'
                raise CalibrationError(f"Point {number} is not of the kind {kind}.") from None
            if len(mm) not in (2, 3) or len(px) != 2:
                raise CalibrationError(f"Point {number} needs two or three millimetres and two pixels.")
            room.append([*mm, 0.0][:3])
            pixels.append(px)
        return cls(np.array(room).reshape(-1, 3), np.array(pixels).reshape(-1, 2)).checked()

    def checked(self) -> Points:
        """Itself. Raises CalibrationError where no pose can come of it: too few, not finite, twice, on one line."""
        if self.points_mm.shape[0] != self.points_px.shape[0] or len(self.points_mm) < 4:
            raise CalibrationError(f"{len(self.points_mm)} points are known, and four are needed, better six.")
        if not (np.isfinite(self.points_mm).all() and np.isfinite(self.points_px).all()):
            raise CalibrationError("A point has a number that is not finite. Click it again.")
        for values, what in ((self.points_mm, "millimetres"), (self.points_px, "pixels")):
            apart = np.linalg.norm(values[:, None] - values[None], axis=2) + np.diag(np.full(len(values), np.inf))
            if apart.min() < 1e-3:
                first, second = np.unravel_index(apart.argmin(), apart.shape)
                same = f"Points {first + 1} and {second + 1} have the same {what}"
                raise CalibrationError(f"{same}. Correct one of them.")
            spread = np.linalg.svd(values - values.mean(axis=0), compute_uv=False)
            if spread[1] < 0.02 * spread[0]:
                raise CalibrationError(f"In {what}, the points lie on one line, which gives no pose. Spread them out.")
        return self

    @property
    def flat(self) -> bool:
        """Whether they all lie (nearly) in one plane."""
        spread = np.linalg.svd(self.points_mm - self.points_mm.mean(axis=0), compute_uv=False)
        return bool(spread[2] < 0.02 * spread[0])


def bed_corners_mm(width_mm: float, depth_mm: float, origin: str = "lowerleft") -> np.ndarray:
    """(4, 3) float64: the bed's corners front left, front right, back right, back left, in print coordinates."""
    corners = np.array([[0, 0, 0], [width_mm, 0, 0], [width_mm, depth_mm, 0], [0, depth_mm, 0]], dtype=np.float64)
    return corners - ([width_mm / 2, depth_mm / 2, 0] if origin == "center" else [0, 0, 0])


def pose_from_points(
    points: Points, image_size_px: tuple[int, int], lens: Lens | None = None, click_px: float = CLICK_PX
) -> PoseResult:
    """The camera that sees these points there. Without a lens, a focal length is found as well.

    click_px : how far off a click is, as a standard deviation; the accuracy told follows from it, or from the misfit
    where that is larger.
    Raises CalibrationError where the points are exchanged, mirrored, or fit to no camera.
    """
    points = points.checked()
    if lens is not None and tuple(lens.image_size_px) != tuple(image_size_px):
        lens = Lens.of(lens.at(np.zeros(3), np.zeros(3)).resized(image_size_px))
    free = lens is None
    base = _usual_lens(image_size_px) if lens is None else lens

    def place(values: np.ndarray) -> Camera:
        return (_lens_with(base, values[6:]) if free else base).at(values[:3], values[3:6])

    solution = _solve(points, place, base, free, click_px)
    miss_px = place(solution.values).project(points.points_mm) - points.points_px
    rms_px = float(np.sqrt((miss_px**2).sum(axis=1).mean()))
    if not rms_px < max(_POOREST_PX, 3 * click_px):
        raise CalibrationError(_what_is_wrong(points, place, base, free, click_px, rms_px, miss_px))
    camera = place(solution.values)
    if camera.centre_mm[2] <= points.points_mm[:, 2].mean():
        raise CalibrationError(
            "Seen like this, the camera would stand below the bed: the points go the wrong way round. Either left and "
            "right were exchanged while clicking, or the webcam mirrors its picture: switch off one of its flips."
        )
    # With four corners there is next to no redundancy, so the misfit says little: the click's own error is the floor.
    spare = max(len(solution.residuals) - len(solution.values), 1)
    variance = max(1.0, float((solution.residuals**2).sum()) / spare)
    covariance = covariance_of(solution.slopes, solution.weights, variance)
    low, high = points.points_mm[:, :2].min(axis=0), points.points_mm[:, :2].max(axis=0)
    steps = _STEPS[: len(solution.values)]
    error_px, error_mm = pose_error(place, solution.values, steps, covariance, low, high)
    seen = camera.project(points.points_mm)
    return PoseResult(
        camera=camera, rms_px=rms_px, markers_px=tuple((float(x), float(y)) for x, y in seen),
        error_px=error_px, error_mm=error_mm, covariance=covariance[:6, :6],
        notes=_notes(points, camera, free, covariance, error_px, error_mm),
    )  # fmt: skip


def _usual_lens(image_size_px: tuple[int, int]) -> Lens:
    width, height = image_size_px
    focal_px = max(width, height) / 2 / math.tan(math.radians(_USUAL_VIEW_DEG) / 2)
    K = np.array([[focal_px, 0, (width - 1) / 2], [0, focal_px, (height - 1) / 2], [0, 0, 1]])
    return Lens((width, height), K, np.zeros(5))


def _lens_with(usual: Lens, unknowns: np.ndarray) -> Lens:
    log_zoom, k1, right, down = unknowns
    K = usual.K.copy()
    K[[0, 1], [0, 1]] *= math.exp(log_zoom)
    K[:2, 2] += np.array([right, down]) * usual.image_size_px[0]
    return Lens(usual.image_size_px, K, np.array([k1, 0, 0, 0, 0]))


def _solve(points: Points, place: Any, base: Lens, free: bool, click_px: float) -> Solution:
    """The best of what several starts lead to. Residuals are in units of the click's error."""

    def misses(values: np.ndarray) -> np.ndarray:
        if free and abs(values[6]) > 3:
            return np.full(2 * len(points.points_mm) + len(_USUAL), np.nan)
        try:
            off = ((place(values).project(points.points_mm) - points.points_px) / click_px).ravel()
        except (CameraError, cv2.error):
            off = np.full(2 * len(points.points_mm), np.nan)
        return np.concatenate([off, (values[6:] - _USUAL) / _USUAL_SPREAD]) if free else off

    best: Solution | None = None
    lowest = math.inf
    for log_zoom in (-0.6, -0.3, 0.0, 0.3, 0.7) if free else (0.0,):
        unknowns = np.array([log_zoom, *_USUAL[1:]]) if free else np.empty(0)
        for rvec, tvec in _starts(points, _lens_with(base, unknowns) if free else base):
            start = np.concatenate([rvec.ravel(), tvec.ravel(), unknowns])
            solution = least_squares(misses, start, _STEPS[: len(start)], rounds=60)
            # The two poses of a plane fit almost alike; the camera is above the bed.
            below = place(solution.values).centre_mm[2] <= points.points_mm[:, 2].mean()
            cost = float((solution.residuals**2).sum()) + (4.0 if below else 0.0)
            if cost < lowest:
                best, lowest = solution, cost
    if best is None:
        raise CalibrationError("No camera sees these points there. Check the millimetres and click the points again.")
    return best


def _starts(points: Points, lens: Lens) -> list[tuple[np.ndarray, np.ndarray]]:
    rays = lens.rays(points.points_px)
    if not np.isfinite(rays).all():
        return []
    found: list[tuple[np.ndarray, np.ndarray]] = []
    try:
        if points.flat:
            # IPPE wants the points in the plane z = 0.
            middle = points.points_mm.mean(axis=0)
            axes = np.linalg.svd(points.points_mm - middle)[2]
            axes[2] = np.cross(axes[0], axes[1])
            flat = (points.points_mm - middle) @ axes.T
            flat[:, 2] = 0
            _, rvecs, tvecs, _ = cv2.solvePnPGeneric(flat, rays, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
            for rvec, tvec in zip(rvecs, tvecs):
                rotation = cv2.Rodrigues(rvec)[0] @ axes
                found.append((cv2.Rodrigues(rotation)[0], tvec.ravel() - rotation @ middle))
        else:
            _, rvecs, tvecs, _ = cv2.solvePnPGeneric(points.points_mm, rays, np.eye(3), None, flags=cv2.SOLVEPNP_SQPNP)
            found += list(zip(rvecs, tvecs))
    except cv2.error:
        return []
    return [(rvec, tvec) for rvec, tvec in found if np.isfinite(rvec).all() and np.isfinite(tvec).all()]


def _what_is_wrong(
    points: Points, place: Any, base: Lens, free: bool, click_px: float, rms_px: float, miss_px: np.ndarray
) -> str:
    """The likeliest reason why the points do not fit."""

    def rms_of(order: Sequence[int], kept: Sequence[int]) -> float:
        tried = Points(points.points_mm[list(order)][list(kept)], points.points_px[list(kept)])
        try:
            solution = _solve(tried.checked(), place, base, free, click_px)
        except CalibrationError:
            return math.inf
        off_px = place(solution.values).project(tried.points_mm) - tried.points_px
        if place(solution.values).centre_mm[2] <= tried.points_mm[:, 2].mean():
            return math.inf
        return float(np.nan_to_num(np.sqrt((off_px**2).sum(axis=1).mean()), nan=math.inf))

    count = len(points.points_mm)
    everything = range(count)
    good_px = max(1.5 * click_px, 0.2 * rms_px)
    if count == 4:
        swaps = [order for order in permutations(range(4)) if sum(a != b for a, b in zip(order, range(4))) == 2]
        fits_px = [rms_of(order, everything) for order in swaps]
        if min(fits_px) < good_px:
            order = swaps[int(np.argmin(fits_px))]
            swapped = [str(index + 1) for index in range(4) if order[index] != index]
            return f"Points {' and '.join(swapped)} seem to be exchanged. Click them again in the order asked for."
    else:
        without = [rms_of(everything, [index for index in everything if index != left]) for left in everything]
        left = int(np.argmin(without))
        if without[left] < good_px:
            return (
                f"The {count} points fit only to {rms_px:.0f} px; without point {left + 1} the others fit to "
                f"{without[left]:.1f} px. Click point {left + 1} again, or correct its millimetres."
            )
    worst = int(np.argmax((np.nan_to_num(miss_px, nan=1e6) ** 2).sum(axis=1)))
    misfit = f"fit only to {rms_px:.0f} px ({_POOREST_PX:.0f} px at most)" if rms_px < 1e4 else "fit to no camera"
    return (
        f"The points {misfit}. Check the order of the points, the bed's size and the lens; point {worst + 1} is the "
        "furthest off."
    )


def _notes(
    points: Points, camera: Camera, free: bool, covariance: np.ndarray, error_px: tuple[float, float],
    error_mm: tuple[float, float],
) -> tuple[str, ...]:  # fmt: skip
    notes = []
    if free:
        focal_px = camera.K[0, 0]
        share = math.sqrt(covariance[6, 6]) if np.isfinite(covariance[6, 6]) else math.inf
        notes.append(
            f"The lens is not calibrated: its focal length was found to be {focal_px:.0f} px, give or take "
            f"{share:.0%}, from the points and from what is usual. A checkerboard makes this several times better."
        )
    if not error_px[1] < 5.0:
        notes.append(
            f"Clicked like this, a point of the print may be {error_px[1]:.0f} px ({error_mm[1]:.1f} mm) off at worst. "
            "Good enough to see a print come loose; for less, click more points, or print the marker plate."
        )
    turned = roll_deg(camera)
    if abs(turned) > 150:
        notes.append("The camera hangs upside down; that is well, and known now.")
    return tuple(notes)
