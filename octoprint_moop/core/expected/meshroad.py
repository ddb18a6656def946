"""The paper's road: what must be seen, from the model's mesh instead of the beads."""

from __future__ import annotations

import numpy as np

from ..camera import Camera
from ..toolpath import Role, Toolpath
from .solid import MICROMETRES, Solid
from .views import NEVER, MaskRenderer

BESIDES = (Role.SUPPORT, Role.BRIM, Role.TOWER)  # what a slicer adds; no model has it


class MeshRoad:
    """A MaskRenderer that draws a solid where another draws the beads of walls and infill.

    The G-code still tells when which height is reached, and its skirts, supports and towers are drawn as its beads. A
    layer of the solid counts as laid by the layer's last bead. A mesh knows no labelled objects: each object's own map
    shows all of it.
    """

    def __init__(self, renderer: MaskRenderer, solid: Solid) -> None:
        self._renderer, self._solid = renderer, solid
        self.name = renderer.name

    def birth_map(
        self,
        toolpath: Toolpath,
        camera: Camera,
        room_from_print_mm: np.ndarray,
        beads: np.ndarray | None = None,
    ) -> np.ndarray:
        """As MaskRenderer says."""
        heights = self._renderer.solid_map(self._solid, camera, room_from_print_mm)
        layer = np.searchsorted(_sliced_at(toolpath), heights.astype(np.float64) - 1)
        last_bead = toolpath.layer_start[1:][np.minimum(layer, toolpath.layers - 1)]
        births = np.where(heights > NEVER, last_bead, np.iinfo(np.uint32).max).astype(np.uint32)
        besides = np.isin(toolpath.role, np.array(BESIDES, dtype=np.uint8))
        chosen = np.flatnonzero(besides) if beads is None else beads[besides[beads]]
        if chosen.size:
            drawn = self._renderer.birth_map(toolpath, camera, room_from_print_mm, chosen)
            births = np.minimum(births, np.where(drawn > NEVER, drawn, np.iinfo(np.uint32).max))
        births[births == np.iinfo(np.uint32).max] = NEVER
        return births

    def solid_map(self, solid: Solid, camera: Camera, room_from_print_mm: np.ndarray) -> np.ndarray:
        """As MaskRenderer says."""
        return self._renderer.solid_map(solid, camera, room_from_print_mm)


def _sliced_at(toolpath: Toolpath) -> np.ndarray:
    """(L,) float64, never decreasing, micrometres: slicers lay in a layer what they meet at the middle of its height.

    Printed object by object, heights begin anew; what stands is then told by the highest layer so far.
    """
    top = np.maximum.accumulate(toolpath.layer_z_mm.astype(np.float64)) * MICROMETRES
    return (top + np.concatenate([[0.0], top[:-1]])) / 2
