"""The outline of a marker: where it must be for a given camera, and where the picture has it, below a pixel."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from ..camera import Camera
from .markers import MarkerPlate

_SIDES = 64
_LEAST_HOLE_PX2 = 30
_TURN = np.linspace(0, 2 * np.pi, _SIDES, endpoint=False)
# A polygon's sides lie within its circle: with this radius they lie on it on average.
_CIRCLE = np.column_stack([np.cos(_TURN), np.sin(_TURN)]) * (1 + (np.pi / _SIDES) ** 2 / 3)


@dataclass(frozen=True, eq=False)
class Outline:
    """A closed convex polygon: rim_mm (N, 3) float64 in the room, seen at px (N, 2) float64 by the camera."""

    rim_mm: np.ndarray
    px: np.ndarray


def marker_outline(camera: Camera, plate: MarkerPlate, marker: int, raised: float = 0.0) -> Outline | None:
    """A marker's silhouette; None where it is not all before the camera.

    It is the hull of both rims: a printed disc is high enough for its side to be seen. A side in shadow looks lower
    than it is: its lower rim is taken `raised` by that part of the height.
    """
    rims_mm = _rims_mm(plate, marker, plate.outer_diameter_mm / 2, raised)
    points = camera.project(rims_mm)
    if not np.isfinite(points).all() or np.abs(points).max() > 1e5:
        return None
    hull = cv2.convexHull(points.astype(np.float32), returnPoints=False).ravel()
    return Outline(rims_mm[hull], points[hull])


def hole_outline(camera: Camera, plate: MarkerPlate, marker: int, raised: float = 0.0) -> Outline | None:
    """The ground seen through a marker's hole: the part common to both rims. None where there is none.

    The side seen through the hole faces the same way as the one seen from outside: `raised` as there.
    """
    if plate.hole_diameter_mm is None:
        return None
    rims_mm = _rims_mm(plate, marker, plate.hole_diameter_mm / 2, raised)
    points = camera.project(rims_mm)
    if not np.isfinite(points).all() or np.abs(points).max() > 1e5:
        return None
    upper, lower = points[:_SIDES], points[_SIDES:]
    # Of each rim, the part that lies within the other bounds what is seen.
    kept = np.concatenate([_inside(upper, lower), _inside(lower, upper)])
    if kept.sum() < 8:
        return None
    hull = cv2.convexHull(points[kept].astype(np.float32), returnPoints=False).ravel()
    outline_px = points[kept][hull]
    if cv2.contourArea(outline_px.astype(np.float32)) < _LEAST_HOLE_PX2:
        return None
    return Outline(rims_mm[kept][hull], outline_px)


def _rims_mm(plate: MarkerPlate, marker: int, radius_mm: float, raised: float) -> np.ndarray:
    """(2 * sides, 3): the upper circle, then the lower one."""
    circle = plate.centres_mm[marker][None] + radius_mm * _CIRCLE
    heights_mm = (plate.height_mm, raised * plate.height_mm)
    return np.vstack([np.column_stack([circle, np.full(_SIDES, z_mm)]) for z_mm in heights_mm])


def _inside(points_px: np.ndarray, polygon_px: np.ndarray) -> np.ndarray:
    side = np.roll(polygon_px, -1, axis=0) - polygon_px
    offset = points_px[:, None] - polygon_px[None]
    turn = side[None, :, 0] * offset[..., 1] - side[None, :, 1] * offset[..., 0]
    return (turn >= 0).all(axis=1) | (turn <= 0).all(axis=1)


@dataclass(frozen=True, eq=False)
class Feet:
    """For points near an outline: distance_px (N,), negative within; the outline's nearest points in the room,
    feet_mm (N, 3); and its outward normals there, normal (N, 2)."""

    distance_px: np.ndarray
    feet_mm: np.ndarray
    normal: np.ndarray


def drop_feet(points_px: np.ndarray, outline: Outline) -> Feet:
    start, side = outline.px, np.roll(outline.px, -1, axis=0) - outline.px
    length = np.maximum((side**2).sum(axis=1), 1e-12)
    offset_x = points_px[:, 0][:, None] - start[:, 0][None]
    offset_y = points_px[:, 1][:, None] - start[:, 1][None]
    along = np.clip((offset_x * side[:, 0] + offset_y * side[:, 1]) / length, 0, 1)
    away = (offset_x - along * side[:, 0]) ** 2 + (offset_y - along * side[:, 1]) ** 2
    nearest = away.argmin(axis=1)
    rows = np.arange(len(points_px))
    share = along[rows, nearest][:, None]
    normal = np.column_stack([side[nearest, 1], -side[nearest, 0]]) / np.sqrt(length[nearest])[:, None]
    to_middle = outline.px.mean(axis=0) - start[nearest]
    normal = np.where(((normal * to_middle).sum(axis=1) > 0)[:, None], -normal, normal)
    off = points_px - (start[nearest] + share * side[nearest])
    sign = np.where((off * normal).sum(axis=1) >= 0, 1.0, -1.0)
    end_mm = np.roll(outline.rim_mm, -1, axis=0)[nearest]
    feet_mm = outline.rim_mm[nearest] * (1 - share) + end_mm * share
    return Feet(sign * np.sqrt(away[rows, nearest]), feet_mm, normal)


def measure_edge_px(
    picture: np.ndarray,
    polygon_px: np.ndarray,
    reach_px: float,
    colour: np.ndarray,
    inwards: bool = False,
    count: int = 72,
) -> np.ndarray:
    """(M, 2) float64: points of the edge near a predicted outline, M <= count, where the picture shows one.

    picture : (H, W, 3) float32
    colour  : (3,) the marker's own; it lies within the outline, or, with `inwards`, around it (a hole)
    Profiles are sampled across the outline; the edge is where the colour is half way between the marker's and that of
    the ground just there.
    """
    points, outward = _along(polygon_px, count)
    outward = -outward if inwards else outward
    offsets = np.arange(-reach_px, reach_px + 0.01, 0.25)
    where = points[:, None] + offsets[None, :, None] * outward[:, None]
    height, width = picture.shape[:2]
    within = ((where >= 1) & (where <= [width - 2, height - 2])).all(axis=(1, 2))
    where, points, outward = where[within], points[within], outward[within]
    if not len(where):
        return np.empty((0, 2))
    profile = cv2.remap(
        picture, where[..., 0].astype(np.float32), where[..., 1].astype(np.float32), cv2.INTER_LINEAR
    )  # fmt: skip
    ground = np.median(profile[:, offsets > 0.55 * reach_px], axis=1)
    contrast = colour[None] - ground
    strength = (contrast**2).sum(axis=1)
    share = ((profile - ground[:, None]) * contrast[:, None]).sum(axis=2) / np.maximum(strength, 1e-6)[:, None]
    falls = (share[:, :-1] >= 0.5) & (share[:, 1:] < 0.5)
    at = np.where(falls, np.abs(offsets[None, :-1] + 0.125), np.inf)
    nearest = at.argmin(axis=1)
    rows = np.arange(len(share))
    high, low = share[rows, nearest], share[rows, nearest + 1]
    offset = offsets[nearest] + 0.25 * (high - 0.5) / np.maximum(high - low, 1e-6)
    # A real edge stands out of the noise, has the marker's colour on its inner side and the ground's beyond.
    clear = np.isfinite(at.min(axis=1)) & (strength > 25.0**2)
    within_share = np.array([line[max(0, k - 8) : max(1, k - 2)].mean() for line, k in zip(share, nearest)])
    beyond_share = np.array([line[min(k + 4, len(line) - 1) : k + 10].mean() for line, k in zip(share, nearest)])
    clear &= (within_share > 0.65) & (within_share < 1.6) & (beyond_share < 0.35)
    return points[clear] + offset[clear, None] * outward[clear]


def inner_colour(picture: np.ndarray, polygon_px: np.ndarray) -> np.ndarray | None:
    """(3,) float32: the median colour well within an outline, None where it lies outside the picture."""
    x, y, width, height = cv2.boundingRect(polygon_px.astype(np.float32))
    left, top = max(x, 0), max(y, 0)
    right, bottom = min(x + width, picture.shape[1]), min(y + height, picture.shape[0])
    if right - left < 3 or bottom - top < 3:
        return None
    mask = np.zeros((bottom - top, right - left), np.uint8)
    cv2.fillConvexPoly(mask, np.round(polygon_px - [left, top]).astype(np.int32), 255)
    mask = cv2.erode(mask, np.ones((5, 5), np.uint8))
    pixels = picture[top:bottom, left:right][mask > 0]
    return np.median(pixels, axis=0) if len(pixels) >= 8 else None


def _along(polygon_px: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Points spread evenly over a convex polygon's border and their outward normals, both (count, 2)."""
    side = np.roll(polygon_px, -1, axis=0) - polygon_px
    length = np.linalg.norm(side, axis=1)
    at = (np.arange(count) + 0.5) / count * length.sum()
    index = np.minimum(np.searchsorted(np.cumsum(length), at), len(side) - 1)
    rest = at - (np.cumsum(length) - length)[index]
    direction = side[index] / np.maximum(length[index], 1e-9)[:, None]
    points = polygon_px[index] + rest[:, None] * direction
    normal = np.column_stack([direction[:, 1], -direction[:, 0]])
    outward = np.sign(((points - polygon_px.mean(axis=0)) * normal).sum(axis=1))
    return points, normal * outward[:, None]
