"""Robust non-linear least squares: Levenberg's and Marquardt's method with Huber's weights, for a few unknowns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Callable

import numpy as np


@dataclass(frozen=True, eq=False)
class Solution:
    """values : (P,) float64. residuals : (N,) at them. weights : (N,) Huber's, 1 for points that fit.
    covariance : (P, P) of `values`, from the residuals' own scatter; infinite where the points leave a value open.
    slopes     : (N, P) of the residuals, for a covariance from another scatter (`covariance_of`).
    """

    values: np.ndarray
    residuals: np.ndarray
    weights: np.ndarray
    covariance: np.ndarray
    slopes: np.ndarray

    @property
    def rms(self) -> float:
        """Root mean square of the residuals, outliers weighed down."""
        return float(np.sqrt((self.weights * self.residuals**2).sum() / max(self.weights.sum(), 1e-12)))


def least_squares(
    residuals: Callable[[np.ndarray], np.ndarray],
    start: np.ndarray,
    steps: np.ndarray,
    outlier: float = np.inf,
    correlated: float = 1.0,
    rounds: int = 40,
    slopes_of: Callable[[np.ndarray], np.ndarray] | None = None,
) -> Solution:
    """Minimises the sum of squared residuals, those beyond `outlier` counting linearly only.

    steps      : (P,) for the numeric slopes, each a small fraction of what matters in that value
    slopes_of  : (N, P) slopes of the residuals at some values, where they are cheaper than twice P residuals
    correlated : how many neighbouring residuals carry the same error; widens the covariance
    A residual that is not finite counts as twice `outlier`, or 1e3.
    """
    ceiling = 2 * outlier if np.isfinite(outlier) else 1e3

    def evaluate(values: np.ndarray) -> np.ndarray:
        return np.nan_to_num(residuals(values), nan=ceiling, posinf=ceiling, neginf=-ceiling)

    def cost(misses: np.ndarray) -> float:
        size = np.abs(misses)
        tail = 2 * np.minimum(outlier, 1e9) * size - np.minimum(outlier, 1e9) ** 2
        return float(np.where(size <= outlier, size**2, tail).sum())

    values = np.array(start, dtype=np.float64)
    misses, damping = evaluate(values), 1e-3
    slopes = weights = np.empty(0)
    for _ in range(rounds):
        weights = np.minimum(1.0, outlier / np.maximum(np.abs(misses), 1e-12))
        slopes = numeric_slopes(evaluate, values, steps) if slopes_of is None else slopes_of(values)
        normal, pull = slopes.T @ (weights[:, None] * slopes), slopes.T @ (weights * misses)
        for _ in range(12):
            damped = normal + damping * np.diag(np.maximum(np.diag(normal), 1e-12))
            change = -np.linalg.lstsq(damped, pull, rcond=None)[0]
            tried = evaluate(values + change)
            if cost(tried) < cost(misses):
                damping = max(damping / 5, 1e-9)
                break
            damping *= 4
        else:
            break
        values, misses = values + change, tried
        if np.all(np.abs(change) < steps * 1e-2):
            break
    weights = np.minimum(1.0, outlier / np.maximum(np.abs(misses), 1e-12))
    degrees = max(float(weights.sum()) / correlated - len(values), 0.0)
    variance = float((weights * misses**2).sum()) / correlated / degrees if degrees > 0 else np.inf
    return Solution(values, misses, weights, covariance_of(slopes, weights, variance * correlated), slopes)


def numeric_slopes(function: Callable[[np.ndarray], np.ndarray], values: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """(..., P) float64: central differences of a function of P values."""
    return np.stack(
        [(function(values + step) - function(values - step)) / (2 * step.sum()) for step in np.diag(steps)], axis=-1
    )


def covariance_of(slopes: np.ndarray, weights: np.ndarray, variance: float) -> np.ndarray:
    """(P, P) float64: covariance of the values where each residual has that variance; infinite where one is open."""
    normal = slopes.T @ (weights[:, None] * slopes)
    scale = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    shape = normal / np.outer(scale, scale)
    if not np.isfinite(variance) or not np.isfinite(shape).all() or np.linalg.cond(shape) > 1e12:
        return np.full(normal.shape, np.inf)
    return np.linalg.inv(shape) / np.outer(scale, scale) * variance
