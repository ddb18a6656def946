"""Corners of a checkerboard to a few hundredths of a pixel: each is fitted with a picture of itself.

Around a corner two edges cross, blurred by lens and sensor. In the board's own coordinates, which a first calibration
gives, that is I = a + (b + c u + d v) erf((u − u₀ − s v) / w) erf((v − v₀ − t u) / z) + e u + f v; its twelve numbers are
fitted to the grey levels (Gauss and Newton). Perspective and distortion are no part of it, as they are in a fit in the
picture's coordinates (cf. Datta, Kim and Kanade, "Accurate camera calibration using iterative refinement of control
points", ICCV workshops 2009). On the rendered boards this halves the corners' error.
"""

from __future__ import annotations

import cv2
import numpy as np

from ..camera import Camera
from .chessboard import Board

_REACH, _SAMPLES = 0.42, 17  # how far around a corner, in squares, and how many samples each way
_ROUNDS = 12
_MOST_PX, _MOST_LEFT = 1.0, 0.35  # a fit that strays, or leaves so much of the contrast, is not believed
_U, _V = (part.ravel() for part in np.meshgrid(*[np.linspace(-_REACH, _REACH, _SAMPLES)] * 2))


def fit_corners(grey: np.ndarray, camera: Camera, corners_px: np.ndarray, board: Board) -> np.ndarray:
    """(N, 2) float64: the corners, better; where a fit fails, as they were.

    grey : (H, W) uint8; camera : stands where it saw the board, whose plane is z = 0; corners_px : (N, 2), roughly
    """
    points_mm = board.points_mm()
    patch = np.column_stack([_U, _V, np.zeros(_U.size)]) * board.square_mm
    seen_px = camera.project((points_mm[:, None] + patch[None]).reshape(-1, 3)).astype(np.float32)
    shape = (len(points_mm), _U.size)
    levels = cv2.remap(
        grey.astype(np.float32), seen_px[:, 0].reshape(shape), seen_px[:, 1].reshape(shape), cv2.INTER_CUBIC,
        borderMode=cv2.BORDER_REPLICATE,
    )  # fmt: skip
    found = np.array([_fit(level.astype(np.float64)) for level in levels])
    better_px = camera.project(points_mm + np.column_stack([found, np.zeros(len(found))]) * board.square_mm)
    believed = np.linalg.norm(better_px - corners_px, axis=1) < _MOST_PX
    return np.where(believed[:, None], better_px, corners_px)


def _fit(levels: np.ndarray) -> np.ndarray:
    """(2,) float64: where the corner is, in squares; NaN where these levels are none."""
    shape = np.array([0.0, 0.0, 0.0, 0.0, np.log(0.12), np.log(0.12)])  # u0, v0, s, t, log w, log z
    damping, nowhere = 1e-3, np.full(2, np.nan)
    design, slopes = _model(shape)
    linear = np.linalg.lstsq(design, levels, rcond=None)[0]
    left = levels - design @ linear
    for _ in range(_ROUNDS):
        contrast = linear[1] + linear[4] * _U + linear[5] * _V
        jacobian = np.hstack([design, slopes * contrast[:, None]])
        normal = jacobian.T @ jacobian
        try:
            step = np.linalg.solve(normal + damping * np.diag(np.diag(normal) + 1e-9), jacobian.T @ left)
        except np.linalg.LinAlgError:
            return nowhere
        tried = shape + np.clip(step[6:], -0.3, 0.3)
        new_design, new_slopes = _model(tried)
        new_linear = linear + step[:6]
        new_left = levels - new_design @ new_linear
        if new_left @ new_left < left @ left:
            shape, linear, left, design, slopes = tried, new_linear, new_left, new_design, new_slopes
            damping /= 4
            if np.abs(step[6:8]).max() < 1e-4:
                break
        else:
            damping *= 8
    sure = np.sqrt((left**2).mean()) < _MOST_LEFT * abs(linear[1]) and np.abs(shape[:2]).max() < _REACH / 2
    return shape[:2] if sure else nowhere


def _model(shape: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(N, 6): what the linear numbers a, b, e, f, c, d stand for; (N, 6): slopes of the crossing's part by `shape`."""
    u0, v0, s, t, log_w, log_z = shape
    w, z = np.exp(log_w), np.exp(log_z)
    across_u, across_v = (_U - u0 - s * _V) / w, (_V - v0 - t * _U) / z
    edge_u, edge_v = _erf(across_u), _erf(across_v)
    slope_u = 2 / np.sqrt(np.pi) * np.exp(-(across_u**2)) * edge_v
    slope_v = 2 / np.sqrt(np.pi) * np.exp(-(across_v**2)) * edge_u
    crossing = edge_u * edge_v
    design = np.column_stack([np.ones_like(_U), crossing, _U, _V, crossing * _U, crossing * _V])
    slopes = np.column_stack(
        [-slope_u / w, -slope_v / z, -_V * slope_u / w, -_U * slope_v / z, -across_u * slope_u, -across_v * slope_v]
    )
    return design, slopes


def _erf(x: np.ndarray) -> np.ndarray:
    """To 1.5e-7: Abramowitz and Stegun, 7.1.26."""
    k = 1 / (1 + 0.3275911 * np.abs(x))
    series = k * (0.254829592 + k * (-0.284496736 + k * (1.421413741 + k * (-1.453152027 + k * 1.061405429))))
    return np.sign(x) * (1 - series * np.exp(-(x**2)))
