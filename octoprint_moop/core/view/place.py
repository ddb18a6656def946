"""Where things of a print lie before a camera, for the naming of failures."""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np

from ..camera import BedMotion, Camera
from ..expected.views import ExpectedViews
from ..header import Moment
from ..toolpath import Toolpath
from .window import Window


@dataclass(frozen=True, eq=False)
class Place:
    """The print before this camera at one moment; see `movements.Place`. Pixels are the window's."""

    window: Window
    toolpath: Toolpath
    camera: Camera
    bed: BedMotion
    expected: ExpectedViews
    moment: Moment
    _covered: dict[int, dict[int, np.ndarray]] = field(default_factory=dict)

    def covered(self, object_id: int, first_layer: int) -> np.ndarray:
        """Raises RenderError where drawing fails."""
        first_layer = max(first_layer, 0)
        known = self._covered.setdefault(object_id, {})
        if first_layer not in known:
            # layer upon layer is asked for, downwards: only what is not drawn yet is drawn
            above = min((layer for layer in known if layer > first_layer), default=None)
            first, laid = self.toolpath.layer_start[first_layer], self.toolpath.laid_at(self.moment.file_pos)
            end = laid if above is None else min(int(self.toolpath.layer_start[above]), laid)
            beads = np.arange(first, max(end, first))
            if object_id >= 0:
                beads = beads[self.toolpath.object_id[first : max(end, first)] == object_id]
            drawn = self.window.sampled(self.expected.covered_at(self.moment.position_mm, beads))
            known[first_layer] = drawn if above is None else drawn | known[above]
        return known[first_layer]

    def on_bed_mm(self, pixels: np.ndarray, z_mm: float) -> np.ndarray:
        shift_mm = self.bed.room_from_print_mm(self.moment.position_mm)
        rays_room = self.camera.rays(self.window.in_picture(pixels)) @ cv2.Rodrigues(self.camera.rvec)[0]
        centre = self.camera.centre_mm
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = (z_mm + shift_mm[2] - centre[2]) / rays_room[:, 2]
        return (centre + rays_room * depth[:, None] - shift_mm)[:, :2]

    def layer_z_mm(self, layer: int) -> float:
        return float(self.toolpath.layer_z_mm[layer])
