"""G2, G3 and G5: arcs and curves as chords."""

from __future__ import annotations

import math

import numpy as np

CHORD_ERROR_MM = 0.05
TIE_RATIO = (
    1e-9  # of a chord: a small circle is three chords to the last bit or two, and rounding must not make it four
)
MAX_CHORDS = 2000  # of one command; the P parameter would allow millions
LEAST_MOVE_MM = 1e-6
GREATEST_RADIUS_MM = 1e6


def chords(
    start_mm: np.ndarray,
    end_mm: np.ndarray,
    centre_mm: np.ndarray,
    clockwise: np.ndarray,
    turns: np.ndarray,
    most: int = MAX_CHORDS,
) -> tuple[np.ndarray, np.ndarray]:
    """Chords that leave their arcs by at most CHORD_ERROR_MM (where `most` suffice).

    start_mm, end_mm : (n, 3) float64. An arc that ends over its start is a full circle; Z climbs evenly (a helix).
    centre_mm        : (n, 2) float64; NaN gives one straight chord
    clockwise        : (n,) bool, G2
    turns            : (n,) int, the P parameter: circles in all if closed, additional ones else

    Returns the number of chords of each arc, (n,) int64, and their ends one arc after the other, (sum, 3) float64.
    """
    a, b = start_mm[:, :2] - centre_mm, end_mm[:, :2] - centre_mm
    radius, last_radius = np.hypot(a[:, 0], a[:, 1]), np.hypot(b[:, 0], b[:, 1])
    straight = ~((radius > LEAST_MOVE_MM) & (radius < GREATEST_RADIUS_MM))
    closed = np.hypot(*(end_mm - start_mm)[:, :2].T) < LEAST_MOVE_MM
    angle = np.arctan2(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0], a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1])
    angle = np.where(closed | straight, 0.0, angle)
    angle = np.where(clockwise & (angle >= 0.0), angle - 2 * math.pi, angle)
    angle = np.where(~clockwise & (angle <= 0.0), angle + 2 * math.pi, angle)
    more = np.clip(turns - closed, 0, MAX_CHORDS)
    angle += np.sign(angle) * 2 * math.pi * more
    with np.errstate(divide="ignore", invalid="ignore"):
        widest = 2.0 * np.arccos(1.0 - np.minimum(CHORD_ERROR_MM / radius, 0.5))
        count = np.ceil(np.abs(angle) / widest - TIE_RATIO)
    count = np.where(straight, 1, np.clip(np.nan_to_num(count, nan=1.0), 1, most)).astype(np.int64)

    which = np.repeat(np.arange(len(count)), count)
    ordinal = np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count) + 1
    part = ordinal / count[which]
    r = radius[which] + (last_radius - radius)[which] * part
    phi = np.arctan2(a[:, 1], a[:, 0])[which] + angle[which] * part
    points = np.empty((len(which), 3))
    points[:, 0] = centre_mm[which, 0] + r * np.cos(phi)
    points[:, 1] = centre_mm[which, 1] + r * np.sin(phi)
    points[:, 2] = start_mm[which, 2] + (end_mm - start_mm)[which, 2] * part
    final = ordinal == count[which]
    points[final] = end_mm[which[final]]
    return count, points


def centres_by_radius(
    start_mm: np.ndarray, end_mm: np.ndarray, radius_mm: np.ndarray, clockwise: np.ndarray
) -> np.ndarray:
    """(n, 2) centres of arcs given by R: the short way round for R > 0, the long way for R < 0; NaN if closed."""
    chord = (end_mm - start_mm)[:, :2]
    length = np.hypot(chord[:, 0], chord[:, 1])
    rise = np.sqrt(np.maximum(radius_mm**2 - length**2 / 4.0, 0.0))
    rise = np.where(clockwise == (radius_mm > 0.0), -rise, rise)
    hopeless = (length < LEAST_MOVE_MM) | (np.abs(radius_mm) < LEAST_MOVE_MM)
    unit = chord / np.where(hopeless, np.nan, length)[:, None]
    return (start_mm + end_mm)[:, :2] / 2.0 + np.column_stack([-unit[:, 1], unit[:, 0]]) * rise[:, None]


def bezier(start_mm: np.ndarray, first_mm: np.ndarray, second_mm: np.ndarray, end_mm: np.ndarray) -> np.ndarray:
    """(n + 1, 3) points of a cubic curve that its chords leave by at most CHORD_ERROR_MM (where MAX_CHORDS suffice).

    start_mm, end_mm : (3,); Z climbs evenly. first_mm : (2,) from the start to the first control point. second_mm : (2,) from
    the end to the second

    A chord over 1/n of the parameter leaves the curve by at most |B''| / 8n², and |B''| by 6 times the larger second
    difference of the control points.
    """
    corners = np.stack([start_mm[:2], start_mm[:2] + first_mm, end_mm[:2] + second_mm, end_mm[:2]])
    bend = 6.0 * float(np.hypot(*np.diff(corners, n=2, axis=0).T).max())
    count = min(max(math.ceil(math.sqrt(bend / (8.0 * CHORD_ERROR_MM))), 1), MAX_CHORDS)
    t = np.linspace(0.0, 1.0, count + 1)[:, None]
    weights = np.hstack([(1 - t) ** 3, 3 * t * (1 - t) ** 2, 3 * t**2 * (1 - t), t**3])
    points = np.hstack([weights @ corners, start_mm[2] + (end_mm[2] - start_mm[2]) * t])
    points[0], points[-1] = start_mm, end_mm
    return points
