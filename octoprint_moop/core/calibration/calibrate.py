"""The lens from pictures of a checkerboard: Zhang's method, with the distortion order chosen by held-out error.

Z. Zhang, "A flexible new technique for camera calibration", PAMI 22 (2000). Which pictures were used, which were not
and why, how much of the image they covered, and how far the lens may be off, are part of the result.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np

from ..camera import Camera
from ..errors import CalibrationError, CameraError
from .chessboard import Board, BoardView, find_views, to_grey
from .corners import fit_corners

_PINHOLE_ORDERS: tuple[tuple[str, int, int], ...] = (
    # name, cv2 flags, distortion numbers that are free
    ("none", cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST, 0),
    ("k1", cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST, 1),
    ("k1 k2", cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST, 2),
    ("k1 k2 p1 p2", cv2.CALIB_FIX_K3, 4),
    ("k1 k2 p1 p2 k3", 0, 5),
)
_FISHEYE_ORDER = "fisheye k1 k2 k3 k4"
_FLAGS_HOME = cv2.fisheye if hasattr(cv2.fisheye, "CALIB_FIX_SKEW") else cv2  # OpenCV 4, OpenCV 5: other values too
_FISHEYE_FLAGS = _FLAGS_HOME.CALIB_RECOMPUTE_EXTRINSIC | _FLAGS_HOME.CALIB_FIX_SKEW
_FEWEST_VIEWS = 3
_CORNER_ROUNDS = 2
_DECENT_VIEWS = 8
_DECENT_COVERAGE = 0.6


@dataclass(frozen=True, eq=False)
class Lens:
    """What a camera's picture says about directions: Camera without its place in the room. Fields as in Camera."""

    image_size_px: tuple[int, int]
    K: np.ndarray
    distortion: np.ndarray
    model: str = "pinhole"

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Lens:
        """From a lens result, a pose result or a recording's camera. Raises CameraError naming what is wrong."""
        if not isinstance(data, Mapping):
            raise CameraError("The lens must be an object with image_size_px, K and distortion.")
        if "K" not in data and isinstance(data.get("camera"), Mapping):  # a recording's header serves as well
            data = data["camera"]
        camera = Camera.from_json({**data, "rvec": [0, 0, 0], "tvec_mm": [0, 0, 0]})
        return cls.of(camera)

    @classmethod
    def of(cls, camera: Camera) -> Lens:
        return cls(camera.image_size_px, camera.K, camera.distortion, camera.model)

    def at(self, rvec: np.ndarray, tvec_mm: np.ndarray) -> Camera:
        """The camera with this lens in that place. Raises CameraError where the numbers make no sense."""
        return Camera(self.image_size_px, self.K, self.distortion, np.ravel(rvec), np.ravel(tvec_mm), self.model)

    def to_json(self) -> dict[str, Any]:
        data = self.at(np.zeros(3), np.zeros(3)).to_json()
        return {key: value for key, value in data.items() if key not in ("rvec", "tvec_mm")}

    def project(self, points_camera_mm: np.ndarray) -> np.ndarray:
        """(N, 2) float64 px of points in the camera's own frame; NaN behind it."""
        return self.at(np.zeros(3), np.zeros(3)).project(points_camera_mm)

    def rays(self, points_px: np.ndarray) -> np.ndarray:
        """(N, 2) float64: x/z and y/z of the rays through pixels (N, 2), distortion taken out.

        OpenCV's inverse is a few fixed-point steps; more are taken here until the forward model agrees to 1e-6 px,
        or NaN stands where it never does (beyond the field in which the distortion is invertible).
        """
        points = np.ascontiguousarray(points_px, dtype=np.float64).reshape(-1, 2)
        if not len(points):
            return np.empty((0, 2))
        inverse = cv2.fisheye.undistortPoints if self.model == "fisheye" else cv2.undistortPoints
        rays = inverse(points.reshape(-1, 1, 2), self.K, self.distortion).reshape(-1, 2)
        pixel_from_ray = np.linalg.inv(self.K[:2, :2]).T
        for _ in range(30):
            miss = points - self.project(np.column_stack([rays, np.ones(len(rays))]))
            if np.abs(miss).max(initial=0.0) < 1e-6:
                break
            rays = rays + miss @ pixel_from_ray
        rays[~(np.abs(miss).max(axis=1) < 0.01)] = np.nan
        return rays


def mean_max_json(error: tuple[float, float]) -> dict[str, float | None]:
    """{"mean", "max"}; None where nothing is known, as JSON has neither infinity nor NaN."""
    return {name: round(value, 3) if math.isfinite(value) else None for name, value in zip(("mean", "max"), error)}


@dataclass(frozen=True, eq=False)
class LensResult:
    """A lens and how well it is known.

    order         : which distortion numbers are free, e.g. "k1 k2 p1 p2"
    rms_px        : reprojection error over the corners used
    held_out_px   : the same over views that the fit had not seen; by it `order` was chosen
    used          : (name, rms px) of each view that was used
    rejected      : (name, reason) of each that was not
    coverage_ratio: share of the picture's area over which a board was seen
    standard_error: of fx, fy, cx, cy and each distortion number, as OpenCV propagates it
    error_px      : (mean, max) over the whole image: jackknife standard error of a pixel's direction, a common
                    rotation taken out because the pose takes it up
    notes         : sentences about what to better
    """

    lens: Lens
    order: str
    rms_px: float
    held_out_px: float
    used: tuple[tuple[str, float], ...]
    rejected: tuple[tuple[str, str], ...]
    coverage_ratio: float
    standard_error: Mapping[str, float]
    error_px: tuple[float, float]
    held_out_by_order_px: Mapping[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def to_json(self) -> dict[str, Any]:
        return {
            **self.lens.to_json(),
            "rms_px": round(self.rms_px, 4),
            "images_used": len(self.used),
            "rejected": [{"image": name, "why": why} for name, why in self.rejected],
            "used": [{"image": name, "rms_px": round(rms_px, 4)} for name, rms_px in self.used],
            "order": self.order,
            "held_out_px": round(self.held_out_px, 4),
            "held_out_by_order_px": {name: round(value, 4) for name, value in self.held_out_by_order_px.items()},
            "coverage_ratio": round(self.coverage_ratio, 3),
            "standard_error": {name: round(value, 6) for name, value in self.standard_error.items()},
            "error_px": mean_max_json(self.error_px),
            "notes": list(self.notes),
        }


@dataclass(frozen=True, eq=False)
class _Fit:
    lens: Lens
    rms_px: float
    view_rms_px: np.ndarray
    deviations: np.ndarray  # fx fy cx cy and the distortion numbers


def calibrate_lens(images: Sequence[tuple[str, np.ndarray]], board: Board, model: str = "auto") -> LensResult:
    """The lens that took these pictures of one checkerboard.

    images : (name, picture) pairs; pictures (H, W) or (H, W, 3) uint8, all of one size
    model  : "pinhole", "fisheye", or "auto" for the one with the smaller held-out error
    Raises CalibrationError where fewer than three differing views show the board or no lens explains them.
    """
    if model not in ("auto", "pinhole", "fisheye"):
        raise CalibrationError(f"Unknown lens model {model!r}; known are auto, pinhole and fisheye.")
    size_px, views, rejected = find_views(images, board)
    if len(views) < _FEWEST_VIEWS:
        reasons = "; ".join(dict.fromkeys(f"{name}: {why}" for name, why in rejected[:3]))
        raise CalibrationError(
            f"Only {len(views)} of {len(images)} pictures can be used and {_FEWEST_VIEWS} are needed, better 12"
            f"{' (' + reasons + ')' if reasons else ''}. Take more, with the board tilted in different ways and "
            "filling every part of the picture."
        )
    orders = [name for name, _, _ in _PINHOLE_ORDERS] if model != "fisheye" else []
    orders += [_FISHEYE_ORDER] if model != "pinhole" else []
    views, misfits = _without_misfits(views, board, size_px, orders)
    views = _better_corners(views, dict(images), board, size_px, orders)
    order, held_out = _choose_order(views, board, size_px, orders)
    fit = _fit(views, board, size_px, order)
    coverage_ratio = _coverage_ratio(views, board, size_px)
    return LensResult(
        lens=fit.lens, order=order, rms_px=fit.rms_px, held_out_px=held_out[order],
        used=tuple((view.name, float(rms_px)) for view, rms_px in zip(views, fit.view_rms_px)),
        rejected=tuple(rejected + misfits), coverage_ratio=coverage_ratio,
        standard_error=_named_deviations(fit), error_px=_jackknife_px(views, board, size_px, order, fit.lens),
        held_out_by_order_px=held_out, notes=_notes(len(views), coverage_ratio, fit),
    )  # fmt: skip


def _fit(views: Sequence[BoardView], board: Board, size_px: tuple[int, int], order: str) -> _Fit:
    """Raises CalibrationError where OpenCV finds no lens or one that makes no sense."""
    try:
        fisheye = order == _FISHEYE_ORDER
        fit = _fit_fisheye(views, board, size_px) if fisheye else _fit_pinhole(views, board, size_px, order)
        sane = 0.1 * max(size_px) < fit.lens.K[0, 0] < 50 * max(size_px) and np.isfinite(fit.rms_px)
    except (cv2.error, CameraError, np.linalg.LinAlgError):
        sane = False
    if not sane:
        raise CalibrationError(
            "No lens explains these pictures. Are all of them from one camera at one zoom and focus, and is the board "
            f"flat, with {board.columns} x {board.rows} inner corners? Take the pictures again, with more tilt."
        )
    return fit


def _fit_pinhole(views: Sequence[BoardView], board: Board, size_px: tuple[int, int], order: str) -> _Fit:
    flags = next(flags for name, flags, _ in _PINHOLE_ORDERS if name == order)
    points = [board.points_mm().astype(np.float32)] * len(views)
    pixels = [view.corners_px.astype(np.float32) for view in views]
    rms_px, K, distortion, _, _, deviations, _, view_rms_px = cv2.calibrateCameraExtended(
        points, pixels, size_px, np.eye(3), np.zeros(5), flags=flags,
        criteria=(cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 100, 1e-10),
    )  # fmt: skip
    lens = Lens.of(Lens(size_px, K, distortion.ravel()[:5]).at(np.zeros(3), np.zeros(3)))
    return _Fit(lens, float(rms_px), view_rms_px.ravel(), deviations.ravel()[:9])


def _fit_fisheye(views: Sequence[BoardView], board: Board, size_px: tuple[int, int]) -> _Fit:
    points = [board.points_mm().reshape(1, -1, 3)] * len(views)
    pixels = [view.corners_px.reshape(1, -1, 2).astype(np.float64) for view in views]
    rms_px, K, distortion, rvecs, tvecs = cv2.fisheye.calibrate(
        points, pixels, size_px, np.eye(3), np.zeros(4),
        flags=_FISHEYE_FLAGS,
        criteria=(cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 100, 1e-9),
    )  # fmt: skip
    lens = Lens.of(Lens(size_px, K, distortion.ravel(), "fisheye").at(np.zeros(3), np.zeros(3)))
    view_rms_px = [
        _rms(lens.at(rvec, tvec).project(board.points_mm()) - view.corners_px)
        for view, rvec, tvec in zip(views, rvecs, tvecs)
    ]
    return _Fit(lens, _rms(np.array(view_rms_px)[:, None]), np.array(view_rms_px), np.full(8, np.nan))


def _rms(miss_px: np.ndarray) -> float:
    return float(np.sqrt((miss_px**2).sum(axis=1).mean()))


def _view_error_px(lens: Lens, view: BoardView, board: Board) -> float:
    """Root mean square distance of a view's corners from the board at the pose that suits this lens best."""
    camera = _at_board(lens, view, board)
    return float("inf") if camera is None else _rms(camera.project(board.points_mm()) - view.corners_px)


def _at_board(lens: Lens, view: BoardView, board: Board) -> Camera | None:
    """Where this lens must have stood to see the board so; None where it cannot have seen it."""
    rays = lens.rays(view.corners_px)
    if not np.isfinite(rays).all():
        return None
    found, rvec, tvec = cv2.solvePnP(board.points_mm(), rays, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
    if not found:
        return None
    rvec, tvec = cv2.solvePnPRefineLM(board.points_mm(), rays, np.eye(3), None, rvec, tvec)
    return lens.at(rvec, tvec)


def _without_misfits(
    views: list[BoardView], board: Board, size_px: tuple[int, int], orders: Sequence[str]
) -> tuple[list[BoardView], list[tuple[str, str]]]:
    """Drops views that fit far worse than the others: a bent board, a moved one, a corner mistaken."""
    order = "k1 k2" if "k1 k2" in orders else _FISHEYE_ORDER
    rejected: list[tuple[str, str]] = []
    while len(views) > _FEWEST_VIEWS:
        try:
            view_rms_px = _fit(views, board, size_px, order).view_rms_px
        except CalibrationError:
            break
        worst = int(np.argmax(view_rms_px))
        others_px = float(np.median(np.delete(view_rms_px, worst)))
        if view_rms_px[worst] <= max(4 * others_px, 0.5):
            break
        rejected.append(
            (views[worst].name, f"fits only to {view_rms_px[worst]:.1f} px where the others fit to {others_px:.2f} px")
        )
        views = views[:worst] + views[worst + 1 :]
    return views, rejected


def _better_corners(
    views: list[BoardView], pictures: Mapping[str, np.ndarray], board: Board, size_px: tuple[int, int],
    orders: Sequence[str],
) -> list[BoardView]:  # fmt: skip
    """The views with each corner fitted in the board's own coordinates, which the lens found so far gives.

    That lens has all of what bends a square: else its error comes back in the corners.
    """
    better = views
    for _ in range(_CORNER_ROUNDS):
        fits = []
        for order in ("k1 k2 p1 p2", _FISHEYE_ORDER):
            try:
                fits += [_fit(better, board, size_px, order)] if order in orders else []
            except CalibrationError:
                continue
        if not fits:
            break
        lens = min(fits, key=lambda fit: fit.rms_px).lens
        better = []
        for view in views:
            camera = _at_board(lens, view, board)
            grey = to_grey(pictures[view.name])
            corners_px = view.corners_px if camera is None else fit_corners(grey, camera, view.corners_px, board)
            better.append(BoardView(view.name, corners_px))
    return better


def _choose_order(
    views: list[BoardView], board: Board, size_px: tuple[int, int], orders: Sequence[str]
) -> tuple[str, dict[str, float]]:
    """The lowest order that a higher one does not beat on views left out, and the held-out error of each in px."""
    folds = [views[start :: min(len(views), 6)] for start in range(min(len(views), 6))]
    squares: dict[str, np.ndarray] = {}
    for order in orders:
        errors: list[float] = []
        try:
            for fold in folds:
                lens = _fit([view for view in views if view not in fold], board, size_px, order).lens
                errors += [_view_error_px(lens, view, board) for view in fold]
        except CalibrationError:
            continue
        if np.isfinite(errors).all():
            squares[order] = np.array(errors) ** 2
    if not squares:  # too few views to leave any out
        order = "k1" if "k1" in orders else _FISHEYE_ORDER
        return order, {order: _fit(views, board, size_px, order).rms_px}
    chosen = next(iter(squares))
    for order, square in squares.items():
        # A more flexible lens must be better by more than chance: paired over the views.
        gain = squares[chosen] - square
        if gain.mean() > max(gain.std(ddof=1) / np.sqrt(len(gain)), 0.005 * squares[chosen].mean()):
            chosen = order
    return chosen, {order: float(np.sqrt(square.mean())) for order, square in squares.items()}


def _image_grid_px(size_px: tuple[int, int]) -> np.ndarray:
    """(252, 2) float64 pixels spread evenly over the whole image, its corners included."""
    x, y = np.meshgrid(np.linspace(0, size_px[0] - 1, 18), np.linspace(0, size_px[1] - 1, 14))
    return np.column_stack([x.ravel(), y.ravel()])


def lens_difference_px(lens: Lens, other: Lens, rotation_free: bool = True) -> np.ndarray:
    """(252,) float64: how far apart two lenses put the same directions, over the whole image, in px of `other`.

    With `rotation_free`, the small rotation that brings them closest is taken out first: the pose, estimated with the
    same lens, takes it up. NaN where a direction cannot be told.
    """
    grid_px = _image_grid_px(other.image_size_px)
    rays = other.rays(grid_px)
    directions = np.column_stack([rays, np.ones(len(rays))])
    rotation = np.zeros(3)

    def miss(turn: np.ndarray) -> np.ndarray:
        return lens.at(turn, np.zeros(3)).project(directions) - grid_px

    for _ in range(6 if rotation_free else 0):
        start = miss(rotation)
        known = np.isfinite(start).all(axis=1)
        slopes = np.stack([(miss(rotation + step) - start)[known].ravel() for step in 1e-6 * np.eye(3)], axis=1) / 1e-6
        rotation = rotation - np.linalg.lstsq(slopes, start[known].ravel(), rcond=None)[0]
    return np.linalg.norm(miss(rotation), axis=1)


def _jackknife_px(
    views: list[BoardView], board: Board, size_px: tuple[int, int], order: str, lens: Lens
) -> tuple[float, float]:
    """(mean, max) over the image of the delete-a-group jackknife's standard error (Efron); NaN with too few views."""
    groups = min(len(views), 12)
    squares = []
    for start in range(groups):
        left = [view for index, view in enumerate(views) if index % groups != start]
        try:
            squares.append(lens_difference_px(_fit(left, board, size_px, order).lens, lens) ** 2)
        except CalibrationError:
            return float("nan"), float("nan")
    error_px = np.sqrt((groups - 1) / groups * np.nansum(squares, axis=0))
    return float(error_px.mean()), float(error_px.max())


def _coverage_ratio(views: Sequence[BoardView], board: Board, size_px: tuple[int, int]) -> float:
    """Share of the image's area that lay within the corners of at least one board."""
    scale = 160 / size_px[0]
    seen = np.zeros((max(1, round(size_px[1] * scale)), 160), np.uint8)
    for view in views:
        cv2.fillConvexPoly(seen, cv2.convexHull(np.round(view.corners_px * scale).astype(np.int32)), 255)
    return float((seen > 0).mean())


def _named_deviations(fit: _Fit) -> dict[str, float]:
    numbers = ("k1", "k2", "k3", "k4") if fit.lens.model == "fisheye" else ("k1", "k2", "p1", "p2", "k3")
    named = zip(("fx", "fy", "cx", "cy", *numbers), fit.deviations)
    return {name: float(value) for name, value in named if np.isfinite(value) and value > 0}


def _notes(views: int, coverage_ratio: float, fit: _Fit) -> tuple[str, ...]:
    notes = []
    if views < _DECENT_VIEWS:
        notes.append(f"Only {views} views were used; 12 make the lens several times surer.")
    if coverage_ratio < _DECENT_COVERAGE:
        notes.append(
            f"The board was seen over {coverage_ratio:.0%} of the picture only. Outside, the lens is a guess: take "
            "more pictures with the board at the edges and in the corners."
        )
    if fit.rms_px > 1.0:
        notes.append(f"The corners fit only to {fit.rms_px:.1f} px. Is the board flat and the camera's focus fixed?")
    return tuple(notes)
