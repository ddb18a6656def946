"""Which road a print's expected mask comes by: its G-code's beads, a mesh with them, or a mesh alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Callable

from ..core.errors import GcodeError, MeshError
from ..core.expected.meshroad import MeshRoad, by_height, sliced
from ..core.expected.placing import Placement, place
from ..core.expected.solid import Solid, read_solid
from ..core.expected.views import MaskRenderer
from ..core.gcode.read import read_gcode
from ..core.header import Moment
from ..core.toolpath import Toolpath


@dataclass(frozen=True)
class MeshChoice:
    """A model that somebody chose for a print.

    layer_height_mm : for a print whose G-code cannot be read; None where it can
    """

    path: Path
    placement: Placement = Placement()
    layer_height_mm: float | None = None

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> MeshChoice:
        """Raises MeshError."""
        height = data.get("layer_height_mm")
        try:
            height_mm = None if height is None else float(height)
        except (TypeError, ValueError):
            raise MeshError(f"The layer height is {height!r}; a number of mm is needed.") from None
        return cls(Path(str(data["path"])), Placement.from_json(data), height_mm)


@dataclass(frozen=True, eq=False)
class Road:
    """What an Inspector needs to know of a print, by whichever road.

    toolpath : the G-code's; for a mesh alone its outlines, whose file positions count layers
    solid    : the placed mesh, None where none is used
    layer_height_mm : None where the clock is the file position; else it is the nozzle's height, see `moment`
    notes    : sentences for the user
    """

    toolpath: Toolpath
    solid: Solid | None = None
    layer_height_mm: float | None = None
    notes: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """gcode, mesh, or height: a mesh alone, by the nozzle's height."""
        if self.solid is None:
            return "gcode"
        return "mesh" if self.layer_height_mm is None else "height"

    def drawn_by(self, renderer: MaskRenderer) -> MaskRenderer:
        return renderer if self.solid is None else MeshRoad(renderer, self.solid)

    def moment(self, moment: Moment) -> Moment:
        """The same moment on this road's clock."""
        return moment if self.layer_height_mm is None else by_height(moment, self.toolpath, self.layer_height_mm)


def find_road(
    job: Path | None,
    mesh: MeshChoice | None = None,
    cache: Path | None = None,
    progress: Callable[[float], None] | None = None,
) -> Road:
    """job : the G-code file, None where there is none, as with a print from the printer's own storage.
    progress : called with the ratio read, 0 to 1

    Raises GcodeError and MeshError; a file that cannot be read as G-code is no error where a mesh with its layer
    height stands in for it.
    """
    why, toolpath = "There is no G-code to be read.", None
    try:
        toolpath = None if job is None else read_gcode(job, cache_dir=cache, progress=progress)
    except GcodeError as error:
        if mesh is None:
            raise
        why = str(error)
    if mesh is None:
        if toolpath is None:
            raise GcodeError("There is no G-code to compare with. Print from OctoPrint, or give the print a model.")
        return Road(toolpath, notes=toolpath.notes)
    if toolpath is not None:
        solid = place(read_solid(mesh.path), mesh.placement, toolpath)
        return Road(toolpath, solid, notes=(*toolpath.notes, *solid.notes))
    if mesh.layer_height_mm is None:
        raise MeshError(f"{why} With the print's layer height, the model alone is enough: enter it beside the model.")
    solid = place(read_solid(mesh.path), mesh.placement)
    note = f"{why} What is expected is the model up to the nozzle's height; its outermost millimetre is not judged."
    return Road(sliced(solid, mesh.layer_height_mm), solid, mesh.layer_height_mm, (note, *solid.notes))
