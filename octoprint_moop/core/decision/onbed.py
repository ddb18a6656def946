"""What the diagnosis asks of the camera: where on the bed a pixel lies, and where what rises from it is seen."""

from __future__ import annotations

from typing import Protocol

import numpy as np


class Place(Protocol):
    """What the diagnosis asks of the camera: core/view/place.py."""

    def covered(self, object_id: int, first_layer: int) -> np.ndarray:
        """(H, W) uint8, 255 where what lies of that object (-1: of everything) from `first_layer` on would be seen alone."""

    def on_bed_mm(self, pixels: np.ndarray, z_mm: float) -> np.ndarray:
        """(N, 2): where lines of sight through the sight's pixels (N, 2) meet the plane z = z_mm, print coordinates."""

    def layer_z_mm(self, layer: int) -> float: ...


def up_px_per_mm(place: Place, pixel: np.ndarray) -> np.ndarray:
    """(2,): by how much what lies on the bed at a pixel moves in the picture for each millimetre that it rises."""
    at_mm = place.on_bed_mm(pixel + np.array([(0, 0), (1, 0), (0, 1)]), 1.0)
    below_mm = place.on_bed_mm(pixel[None], 0.0)[0]
    per_px = (at_mm[1:] - at_mm[0]).T
    if abs(np.linalg.det(per_px)) < 1e-9:
        return np.zeros(2)
    return np.linalg.solve(per_px, below_mm - at_mm[0])


def mm_per_px(place: Place, pixel: np.ndarray) -> np.ndarray:
    """(2, 2): the step on the bed, in columns, for a step of one pixel to the right and one down."""
    at_mm = place.on_bed_mm(pixel + np.array([(0, 0), (1, 0), (0, 1)]), 0.0)
    return (at_mm[1:] - at_mm[0]).T
