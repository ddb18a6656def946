"""The paper's road: what must be seen, from the model's mesh instead of the beads."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..camera import Camera
from ..errors import MeshError
from ..header import Moment
from ..toolpath import NO_OBJECT, Role, Toolpath
from .solid import MICROMETRES, Solid
from .views import NEVER, MaskRenderer

BESIDES = (Role.SUPPORT, Role.BRIM, Role.TOWER)  # what a slicer adds; no model has it
LAYER_HEIGHTS_MM = (0.02, 2.0)
MOST_SLICED = 3_000_000
HOP_MM = 1.0  # the nozzle may be this far above the layer that it prints
OUTLINE_MM = 0.4  # width of the beads that stand for a model's outline


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


def sliced(solid: Solid, layer_height_mm: float) -> Toolpath:
    """What is laid of a model whose G-code nobody can read: its outline at the middle of each layer, as outer walls.

    The file position of such a print counts layers: layer k lies from position k + 1 on. See `by_height`.
    Raises MeshError where the height is none, nothing stands above the bed, or it would be too many lines.
    """
    least_mm, most_mm = LAYER_HEIGHTS_MM
    if not least_mm <= layer_height_mm <= most_mm:
        raise MeshError(f"The layer height is {layer_height_mm:g} mm; {least_mm:g} to {most_mm:g} mm is allowed.")
    triangles = solid.triangles_mm.astype(np.float64)
    z = triangles[:, :, 2] / layer_height_mm
    first = np.maximum(np.ceil(z.min(axis=1) - 0.5), 0).astype(np.int64)
    count = np.maximum(np.floor(z.max(axis=1) - 0.5).astype(np.int64) - first + 1, 0)
    if count.sum() > MOST_SLICED:
        raise MeshError(f"The model is too fine to be sliced here: {count.sum()} lines. Use one of fewer triangles.")
    which = np.repeat(np.arange(len(count)), count)
    layer = first[which] + np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)
    begin, end = triangles[which], np.roll(triangles[which], -1, axis=1)
    plane = ((layer + 0.5) * layer_height_mm)[:, None]
    crosses = (begin[:, :, 2] > plane) != (end[:, :, 2] > plane)
    both = crosses.sum(axis=1) == 2
    order = np.argsort(~crosses, axis=1, kind="stable")[both, :2]
    with np.errstate(divide="ignore", invalid="ignore"):
        part = (plane - begin[:, :, 2]) / (end[:, :, 2] - begin[:, :, 2])
        at = (begin + (end - begin) * part[:, :, None])[both]
    ends = np.take_along_axis(at, order[:, :, None], axis=1)
    layer = layer[both]
    if not len(layer):
        raise MeshError("Nothing of the model stands on the bed, where the print begins. Place it again.")
    rows = np.argsort(layer, kind="stable")
    layer, ends = layer[rows], ends[rows]
    ends[:, :, 2] = ((layer + 1) * layer_height_mm)[:, None]
    size = np.full((len(layer), 2), (OUTLINE_MM, layer_height_mm))
    layers, starts = np.unique(layer, return_index=True)
    return Toolpath(
        beads_mm=np.column_stack([ends.reshape(-1, 6), size]).astype(np.float32),
        end_pos=layer + 1,
        layer_start=np.append(starts, len(layer)),
        layer_end_pos=layers + 1,
        layer_z_mm=((layers + 1) * layer_height_mm).astype(np.float32),
        role=np.full(len(layer), Role.OUTER, np.uint8),
        object_id=np.full(len(layer), NO_OBJECT, np.int16),
        bytes=int(layers[-1]) + 1,
    )


def by_height(moment: Moment, toolpath: Toolpath, layer_height_mm: float) -> Moment:
    """The same moment on the clock of a `sliced` model: by the height of the nozzle.

    Where it prints, or hops over what it has printed, is not known; what that leaves open is not judged.
    """
    z_mm = moment.position_mm[2]
    begun = max(int(np.floor(z_mm / layer_height_mm + 0.5)), 0)
    sure = max(int(np.floor((z_mm - HOP_MM) / layer_height_mm)) - 1, 0)
    return replace(moment, file_pos=begun, sure_pos=min(sure, begun), layer=max(toolpath.layer_at(begun), 0))
