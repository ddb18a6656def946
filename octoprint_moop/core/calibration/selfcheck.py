"""What a print's good checks say about the camera's calibration: how far it is off, and when to correct it.

Only checks in which all is well are asked, and only the first of a print may correct the camera: a print that fails
slowly must find the camera where it was. What is corrected holds for this print; the next one begins with what the
set-up found.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..camera import Camera
from ..toolpath import Toolpath
from .refine import Refinement, SilhouetteEdges, SilhouetteView, refine_camera, silhouette_edges

JUDGED_FROM = 4  # good checks; and again whenever there are twice as many
EVERY_UNTIL, LATER_EVERY = 8, 4  # good checks of which each is asked; and how many of the next it is one of
CORRECTED_UNTIL = 16  # good checks
KEPT_LAYERS = 6
BAND_PER_ERROR = 2.5  # an edge that is off by so many times the usual is off as 1 in 100 would be
WIDEST_BAND_PX = 4.0  # at 640 pixels across: beyond this the user is told, and nothing is excused


@dataclass(frozen=True)
class Fit:
    """How well the calibration fits this print: error_px along the edges, and a sentence. corrected : by ourselves."""

    error_px: float
    told: str
    corrected: bool = False


class SelfCheck:
    """For one camera of one print. `good` is to be told of every check in which all was well, in time order."""

    def __init__(self, camera: Camera, toolpath: Toolpath) -> None:
        self.camera, self._toolpath = camera, toolpath
        self._finer = max(1.0, camera.image_size_px[0] / 640)
        self._layers: list[SilhouetteEdges] = []
        self._good_checks = 0
        self._corrected_px, self._from_markers_px = 0.0, 0.0
        self.fit: Fit | None = None

    def good(self, view: SilhouetteView) -> Camera | None:
        """A better camera to go on with, where it is safe to take one; else None."""
        self._good_checks += 1
        count = self._good_checks
        if count > EVERY_UNTIL and count % max(LATER_EVERY, 1 << (count.bit_length() - 3)):
            return None  # later, layers further apart say more
        self._layers = [*self._layers, silhouette_edges(self.camera, self._toolpath, view)][-KEPT_LAYERS:]
        if count < JUDGED_FROM or count & (count - 1):
            return None
        found = refine_camera(self.camera, self._layers)
        if not math.isfinite(found.off_px):
            return None
        better = found.camera if count <= CORRECTED_UNTIL else None
        if better is not None:
            self._corrected_px += found.moved_px
            self.camera, self._layers = better, []
        self.fit = self._fit(found, better is not None)
        return better

    def found_anew(self, camera: Camera, pose_mm: np.ndarray) -> None:
        """The markers of this print have told where the camera stands. pose_mm : (3,) of the bed, added to the print."""
        low, high = self._toolpath.bounds_mm()
        points_mm = np.array([[x, y, 0.0] for x in (low[0], high[0]) for y in (low[1], high[1])]) + pose_mm
        apart_px = np.linalg.norm(camera.project(points_mm) - self.camera.project(points_mm), axis=1)
        self._from_markers_px = float(np.nanmax(apart_px)) if np.isfinite(apart_px).any() else math.inf
        self.camera, self._layers = camera, []

    def band_px(self, usual_px: float) -> float:
        """How wide the band about expected edges must be in which a difference says little; never less than usual."""
        error_px = 0.0 if self.fit is None else BAND_PER_ERROR * self.fit.error_px
        return max(usual_px, min(error_px, WIDEST_BAND_PX * self._finer))

    def _fit(self, found: Refinement, corrected: bool) -> Fit:
        error_px = found.left_px if corrected else found.off_px
        if self._from_markers_px:
            told = (
                f"The markers in this print tell where the camera stands, {self._from_markers_px:.1f} px from where it "
                f"was thought to be. That fits to {error_px:.1f} px."
            )
        elif self._corrected_px:
            told = (
                f"This print showed the calibration to be {self._corrected_px:.1f} px off. Corrected for this print, it "
                f"fits to {error_px:.1f} px."
            )
        else:
            told = f"The calibration fits to {error_px:.1f} px."
        if BAND_PER_ERROR * error_px > WIDEST_BAND_PX * self._finer:
            told += " That is much: calibrate the camera's place again."
        return Fit(error_px, told, self._corrected_px > 0 or self._from_markers_px > 0)
