"""What the camera must see: the expected mask at any moment of a print."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from .camera import BedMotion, Camera
from .toolpath import Toolpath

NEVER = 0


class MaskRenderer(Protocol):
    """Draws beads. `machine/gl.py` and `core/raster.py` implement it; this file knows neither."""

    name: str

    def birth_map(
        self,
        toolpath: Toolpath,
        camera: Camera,
        room_from_print_mm: np.ndarray,
        beads: np.ndarray | None = None,
    ) -> np.ndarray:
        """(H, W) uint32, the camera's own (distorted) pixels: 1 + index of the first bead that covers the pixel's
        centre, 0 where none ever does.

        room_from_print_mm : (3,) float, added to every point of the print
        beads              : sorted indices of the beads to draw, None for all
        Raises RenderError where drawing fails.
        """


@dataclass(frozen=True, eq=False)
class Expected:
    """The expected state of the view at one moment, all (H, W) in the camera's own pixels.

    birth  : uint32, 1 + index of the first bead that covers the pixel in the complete print, 0 for never
    laid   : number of beads that lie at this moment
    before : number of beads that lay at the last check (so that `before <= birth-1 < laid` is what is new)
    """

    birth: np.ndarray
    laid: int
    before: int = 0

    @property
    def mask(self) -> np.ndarray:
        """uint8, 255 where material must be seen now."""
        return np.where((self.birth > NEVER) & (self.birth <= self.laid), np.uint8(255), np.uint8(0))

    @property
    def complete(self) -> np.ndarray:
        """uint8, 255 where material will be seen when the print is complete."""
        return np.where(self.birth > NEVER, np.uint8(255), np.uint8(0))


class ExpectedViews:
    """Expected views of one print by one camera. A birth map is drawn once for each pose of the bed and kept."""

    def __init__(self, toolpath: Toolpath, camera: Camera, bed: BedMotion, renderer: MaskRenderer) -> None:
        self._toolpath, self._camera, self._bed, self._renderer = toolpath, camera, bed, renderer
        self._births: dict[tuple[float, ...], np.ndarray] = {}

    def at(self, file_pos: int, position_mm: tuple[float, float, float], before: int = 0) -> Expected:
        """What must be seen when everything up to `file_pos` is done and the machine stands at `position_mm`.

        Raises RenderError where drawing fails.
        """
        return Expected(self._birth(position_mm), self._toolpath.laid_at(file_pos), before)

    def _birth(self, position_mm: tuple[float, float, float]) -> np.ndarray:
        shift_mm = self._bed.room_from_print_mm(position_mm)
        pose = tuple(np.round(shift_mm, 3))
        if pose not in self._births:
            while len(self._births) >= 4:  # a pose that changes with every check must not fill the memory
                self._births.pop(next(iter(self._births)))
            self._births[pose] = self._renderer.birth_map(self._toolpath, self._camera, shift_mm)
        return self._births[pose]
