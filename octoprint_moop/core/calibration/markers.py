"""Ring markers: discs with holes on the bed, found in a picture as ellipses of the filament's colour.

The paper's way (Lyngby et al. 2017, section 2.4): segment, follow the contours, fit ellipses algebraically
(Fitzgibbon, Pilu and Fisher, "Direct least square fitting of ellipses", PAMI 21, 1999) and drop those that lie within
another. Which of them are the markers is decided in `assign`, where their places on the bed are known.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from ..errors import CalibrationError
from ..segmentation.segment import HsvThresholds, segment_hsv
from .calibrate import Lens

_LEAST_CONTOUR = 12  # pixels: an ellipse of fewer says nothing of its shape
_MOST_DISCS = 24


@dataclass(frozen=True, eq=False)
class MarkerPlate:
    """Discs of `outer_diameter_mm` and `height_mm` that lie on the bed with their centres at `centres_mm` (N, 2).

    hole_diameter_mm is the diameter of one round hole in each disc's middle, or None where the holes are not known
    (they are then not measured at).
    """

    outer_diameter_mm: float
    height_mm: float
    centres_mm: np.ndarray
    hole_diameter_mm: float | None = None

    def __post_init__(self) -> None:
        try:
            sizes = (float(self.outer_diameter_mm), float(self.height_mm))
            centres = np.array(self.centres_mm, dtype=np.float64)
            hole = None if self.hole_diameter_mm is None else float(self.hole_diameter_mm)
        except (TypeError, ValueError):
            raise CalibrationError("The markers' numbers are not numbers. Write markers.json again.") from None
        if not all(math.isfinite(size) for size in sizes) or not 1 <= sizes[0] <= 500 or not 0 <= sizes[1] <= 100:
            raise CalibrationError(
                f"Markers {sizes[0]} mm wide and {sizes[1]} mm high cannot be; give the outer diameter (1 to 500 mm) "
                "and the height (0 to 100 mm) as printed."
            )
        if hole is not None and not 0 < hole < sizes[0]:
            raise CalibrationError(f"A hole of {hole} mm does not fit in a marker of {sizes[0]} mm.")
        if centres.ndim != 2 or centres.shape[1] != 2 or len(centres) < 3:
            raise CalibrationError("centres_mm must list at least three [x, y] pairs; four or more are better.")
        if not np.isfinite(centres).all() or np.abs(centres).max() > 1e5:
            raise CalibrationError("A marker's centre is not a finite number of millimetres. Write markers.json again.")
        apart = np.linalg.norm(centres[:, None] - centres[None], axis=2) + np.diag(np.full(len(centres), np.inf))
        if apart.min() < sizes[0]:
            first, second = np.unravel_index(apart.argmin(), apart.shape)
            raise CalibrationError(
                f"Markers {first + 1} and {second + 1} are {apart.min():.1f} mm apart and {sizes[0]:g} mm wide: they "
                "overlap. Correct markers.json."
            )
        spread = np.linalg.svd(centres - centres.mean(axis=0), compute_uv=False)
        if spread[1] < 0.05 * spread[0]:
            raise CalibrationError("The markers lie on one line, which gives no pose. Spread them over the bed.")
        centres.flags.writeable = False
        for name, value in zip(("outer_diameter_mm", "height_mm"), sizes):
            object.__setattr__(self, name, value)
        object.__setattr__(self, "centres_mm", centres)
        object.__setattr__(self, "hole_diameter_mm", hole)

    @classmethod
    def from_json(cls, data: Any) -> MarkerPlate:
        """Raises CalibrationError naming what is missing or makes no sense."""
        if not isinstance(data, Mapping):
            raise CalibrationError("markers.json must be an object with outer_diameter_mm, height_mm and centres_mm.")
        missing = [key for key in ("outer_diameter_mm", "height_mm", "centres_mm") if data.get(key) is None]
        if missing:
            raise CalibrationError(f"markers.json has no {', '.join(missing)}. Write it again with `moop markers`.")
        return cls(data["outer_diameter_mm"], data["height_mm"], data["centres_mm"], data.get("hole_diameter_mm"))

    def to_json(self) -> dict[str, Any]:
        data: dict[str, Any] = {
            "outer_diameter_mm": self.outer_diameter_mm,
            "height_mm": self.height_mm,
            "centres_mm": self.centres_mm.tolist(),
        }
        if self.hole_diameter_mm is not None:
            data["hole_diameter_mm"] = self.hole_diameter_mm
        return data

    def mirrored(self) -> MarkerPlate:
        """The plate as a mirrored picture would show it."""
        return MarkerPlate(self.outer_diameter_mm, self.height_mm, self.centres_mm * [-1, 1], self.hole_diameter_mm)

    def tops_mm(self) -> np.ndarray:
        """(N, 3) float64: the centres of the discs' upper faces."""
        return np.column_stack([self.centres_mm, np.full(len(self.centres_mm), self.height_mm)])


@dataclass(frozen=True, eq=False)
class Disc:
    """Something elliptic in the picture.

    centre_px, axes_px (full lengths), angle_deg : the ellipse as cv2 gives it
    contour_px : (N, 2) float64, the outermost pixels of the blob
    fit_ratio  : mean distance of the contour from the ellipse over its mean radius; 0 for a perfect ellipse
    """

    centre_px: tuple[float, float]
    axes_px: tuple[float, float]
    angle_deg: float
    contour_px: np.ndarray
    fit_ratio: float

    @property
    def unit_from_px(self) -> np.ndarray:
        """(3, 3): maps the ellipse onto the unit circle."""
        angle = math.radians(self.angle_deg)
        turn = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
        scale = np.diag(2 / np.array(self.axes_px)) @ turn
        return np.vstack([np.column_stack([scale, -scale @ np.array(self.centre_px)]), [0, 0, 1]])

    def boundary_px(self, count: int = 64) -> np.ndarray:
        """(count, 2) float64 points on the ellipse."""
        turn = np.linspace(0, 2 * math.pi, count, endpoint=False)
        circle = np.column_stack([np.cos(turn), np.sin(turn), np.ones(count)])
        return (circle @ np.linalg.inv(self.unit_from_px).T)[:, :2]


def find_discs(image: np.ndarray, colour: HsvThresholds) -> list[Disc]:
    """The ellipses of that colour in a picture, none within another, the best-shaped first, at most 24.

    image : (H, W, 3) uint8 BGR
    A disc that is partly out of hue is fitted to the part of its contour that is an ellipse's.
    """
    # Noise and JPEG's coarse colour leave a far marker in crumbs; the precise edge is found later, from the picture.
    mask = segment_hsv(cv2.GaussianBlur(image, (0, 0), 1.0), colour)
    mask = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (5, 5)))
    contours, _ = cv2.findContours(mask, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    discs = [disc for contour in contours if (disc := _fit_disc(contour.reshape(-1, 2).astype(np.float64))) is not None]
    discs.sort(key=lambda disc: -disc.axes_px[0] * disc.axes_px[1])
    outer: list[Disc] = []
    for disc in discs:
        # An ellipse is enclosed if its centre falls into the unit circle that another, larger one is mapped onto.
        inside = [np.hypot(*(other.unit_from_px @ [*disc.centre_px, 1.0])[:2]) < 1.0 for other in outer]
        if not any(inside):
            outer.append(disc)
    outer.sort(key=lambda disc: disc.fit_ratio)
    return outer[:_MOST_DISCS]


def _fit_disc(contour_px: np.ndarray) -> Disc | None:
    """The ellipse of a blob, or None where it is too small or like no ellipse at all."""
    if len(contour_px) < _LEAST_CONTOUR:
        return None
    hull_px = cv2.convexHull(contour_px.astype(np.float32)).reshape(-1, 2)
    if cv2.contourArea(hull_px) < 25:
        return None
    # Holes that break through the rim and parts out of hue lie within the hull of what is left.
    depth_px = np.array([cv2.pointPolygonTest(hull_px, (float(x), float(y)), True) for x, y in contour_px])
    kept = contour_px[depth_px < 1.5]
    best: Disc | None = None
    for _ in range(6):
        # The contour's pixels lie within the blob: its border is half a pixel further out on each side.
        centre, axes, angle_deg = cv2.fitEllipseDirect(kept.astype(np.float32))
        if not (np.isfinite([*centre, *axes, angle_deg]).all() and min(axes) > 2 and max(axes) < 40 * min(axes)):
            return best
        centre_px, axes_px = (float(centre[0]), float(centre[1])), (float(axes[0]) + 1, float(axes[1]) + 1)
        shape = Disc(centre_px, axes_px, float(angle_deg), contour_px, 0.0)
        unit = (np.column_stack([contour_px, np.ones(len(contour_px))]) @ shape.unit_from_px.T)[:, :2]
        off_ratio = np.abs(np.linalg.norm(unit, axis=1) - np.median(np.linalg.norm(unit, axis=1)))
        best = replace(shape, fit_ratio=float(np.minimum(off_ratio, 0.5).mean()))
        near = off_ratio < max(1.5 * float(np.median(off_ratio)), 0.05)
        if near.sum() < max(_LEAST_CONTOUR, 0.4 * len(contour_px)):
            break
        kept = contour_px[near]
    return best if best is not None and best.fit_ratio < 0.25 else None


def circle_poses(disc: Disc, diameter_mm: float, lens: Lens) -> list[tuple[np.ndarray, np.ndarray]]:
    """The two discs in space that look like this ellipse: (centre (3,) mm, normal (3,) towards the camera) each.

    Both in the camera's frame. The cone through the ellipse is cut by planes in which it is a circle (Chen, Wu and
    Wada, "Camera calibration with two arbitrary coplanar circles", ECCV 2004). Empty where the lens does not tell the
    rays.
    """
    rays = lens.rays(disc.boundary_px())
    if not np.isfinite(rays).all():
        return []
    shift, scale = rays.mean(axis=0), float(rays.std()) or 1.0
    x, y = ((rays - shift) / scale).T
    _, _, rows = np.linalg.svd(np.column_stack([x * x, 2 * x * y, y * y, 2 * x, 2 * y, np.ones_like(x)]))
    a, b, c, d, e, f = rows[-1]
    normalise = np.array([[1 / scale, 0, -shift[0] / scale], [0, 1 / scale, -shift[1] / scale], [0, 0, 1]])
    cone = normalise.T @ np.array([[a, b, d], [b, c, e], [d, e, f]]) @ normalise
    values, axes = np.linalg.eigh(cone / np.linalg.norm(cone))
    if values[1] < 0:
        values, axes = -values[::-1], axes[:, ::-1]
    third, second, first = values  # ascending: third < 0 < second <= first
    if not third < 0 < second:
        return []
    tilt, rise = math.sqrt((first - second) / (first - third)), math.sqrt((second - third) / (first - third))
    reach_mm = second * (diameter_mm / 2) / math.sqrt(-first * third)
    frame = axes[:, [2, 1, 0]]
    poses = []
    for side in (1.0, -1.0):
        centre_mm = frame @ np.array([side * third / second * tilt, 0.0, -first / second * rise]) * reach_mm
        normal = frame @ np.array([side * tilt, 0.0, -rise])
        centre_mm = centre_mm if centre_mm[2] > 0 else -centre_mm
        poses.append((centre_mm, normal if normal @ centre_mm < 0 else -normal))
    return poses
