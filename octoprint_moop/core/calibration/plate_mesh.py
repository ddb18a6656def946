"""A model with the four ring markers around it, to be sliced and printed together: each print calibrates itself."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, cast

import numpy as np

from ..errors import CalibrationError, MeshError
from ..header import Printer
from .markers import MarkerPlate
from .plate import PlateSettings, bed_middle_mm

if TYPE_CHECKING:
    import trimesh

_GAP_MM = 3.0
# Front, right, back, left of the model's box: where along the side (in parts of half the box), and how much further out
# (in diameters), so that the markers are unlike themselves when turned, mirrored or exchanged, for boxes of any shape.
_ALONG = (0.87, -0.96, 0.73, 0.92)
_FURTHER_OUT = (0.6, 0.3, 0.0, 0.9)


def model_with_markers(
    path: str | Path, printer: Printer, settings: PlateSettings
) -> tuple[trimesh.Trimesh, MarkerPlate]:
    """The model and four rings beside its box as one mesh, standing on the bed, and where the rings are.

    The whole lies with its box's middle on the bed's middle, which is where slicers put what they import: then the
    markers are printed where the plate says.
    Raises MeshError where the model cannot be read, CalibrationError where all that does not fit on the bed.
    """
    import trimesh  # large, and needed here alone

    try:
        model = trimesh.load(str(path), force="mesh")
    except FileNotFoundError:
        raise
    except Exception as error:  # trimesh's readers raise whatever their formats bring
        raise MeshError(f"{path}: not a model that can be read ({error}). Export it as STL, OBJ or 3MF.") from None
    if not isinstance(model, trimesh.Trimesh) or not len(model.faces) or not np.isfinite(model.bounds).all():
        raise MeshError(f"{path}: there is no solid in this file. Export it as STL, OBJ or 3MF.")
    low, high = model.bounds
    centres_mm = _around(low[:2], high[:2], settings)
    radius_mm = settings.diameter_mm / 2
    box = np.array([np.minimum(low[:2], (centres_mm - radius_mm).min(axis=0)),
                    np.maximum(high[:2], (centres_mm + radius_mm).max(axis=0))])  # fmt: skip
    _check_fit(box[1] - box[0], centres_mm - box.mean(axis=0), radius_mm, printer)
    shift = np.append(bed_middle_mm(printer) - box.mean(axis=0), -low[2])
    parts = [model.copy().apply_translation(shift)]
    centres_mm = np.round(centres_mm + shift[:2], 3)
    for x, y in centres_mm:
        ring = trimesh.creation.annulus(settings.hole_diameter_mm / 2, radius_mm, settings.height_mm, sections=128)
        parts.append(ring.apply_translation([x, y, settings.height_mm / 2]))
    plate = MarkerPlate(settings.diameter_mm, settings.height_mm, centres_mm, settings.hole_diameter_mm)
    return cast("trimesh.Trimesh", trimesh.util.concatenate(parts)), plate


def _around(low: np.ndarray, high: np.ndarray, settings: PlateSettings) -> np.ndarray:
    """(4, 2): a ring on each side of the box, further apart where the box is small."""
    middle, half = (low + high) / 2, np.maximum((high - low) / 2, 1.2 * settings.diameter_mm)
    beside = half + settings.diameter_mm / 2 + _GAP_MM
    front, right, back, left = _ALONG
    out = settings.diameter_mm * np.array(_FURTHER_OUT)
    return middle + np.array(
        [
            [front * half[0], -beside[1] - out[0]],
            [beside[0] + out[1], right * half[1]],
            [back * half[0], beside[1] + out[2]],
            [-beside[0] - out[3], left * half[1]],
        ]
    )


def _check_fit(size_mm: np.ndarray, from_middle_mm: np.ndarray, radius_mm: float, printer: Printer) -> None:
    fits = size_mm[0] <= printer.width_mm and size_mm[1] <= printer.depth_mm
    if printer.form_factor == "circular":
        reach_mm = np.linalg.norm(from_middle_mm, axis=1).max() + radius_mm
        fits = fits and reach_mm <= min(printer.width_mm, printer.depth_mm) / 2
    if not fits:
        raise CalibrationError(
            f"With the markers around it the model needs {size_mm[0]:.0f} x {size_mm[1]:.0f} mm, more than the bed of "
            f"{printer.width_mm:g} x {printer.depth_mm:g} mm. Use smaller markers, or print the marker plate by itself."
        )
