"""What the camera must see: the expected mask at any moment of a print."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import cv2
import numpy as np

from .camera import BedMotion, Camera
from .toolpath import Toolpath

NEVER = 0
KEPT_POSES = 4


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

    @cached_property
    def mask(self) -> np.ndarray:
        """uint8, 255 where material must be seen now."""
        return np.where(self.birth - np.uint32(1) < np.uint32(self.laid), np.uint8(255), np.uint8(0))  # never wraps round

    @cached_property
    def complete(self) -> np.ndarray:
        """uint8, 255 where material will be seen when the print is complete."""
        return np.where(self.birth > NEVER, np.uint8(255), np.uint8(0))


@dataclass(frozen=True, eq=False)
class PrintMap:
    """Which layer and which object each pixel of a view belongs to, for one pose of the bed. All (H, W).

    layer   : int32, the layer that first covers the pixel, -1 for never
    owner   : int16, the labelled object that alone can cover the pixel; -1 for none, or for more than one
    nearest : int16, the labelled object whose complete silhouette is nearest; -1 where no object is labelled
    objects : number of labelled objects
    """

    layer: np.ndarray
    owner: np.ndarray
    nearest: np.ndarray
    objects: int


class ExpectedViews:
    """Expected views of one print by one camera. Each pose of the bed is drawn once and kept for a while."""

    def __init__(self, toolpath: Toolpath, camera: Camera, bed: BedMotion, renderer: MaskRenderer) -> None:
        self._toolpath, self._camera, self._bed, self._renderer = toolpath, camera, bed, renderer
        self._births: dict[tuple[float, ...], np.ndarray] = {}
        self._maps: dict[tuple[float, ...], PrintMap] = {}

    def pose(self, position_mm: tuple[float, float, float]) -> tuple[float, ...]:
        """What tells one pose of the bed from another, for those who keep something for each."""
        return tuple(np.round(self._bed.room_from_print_mm(position_mm), 3).tolist())

    def at(self, file_pos: int, position_mm: tuple[float, float, float], before: int = 0) -> Expected:
        """What must be seen when everything up to `file_pos` is done and the machine stands at `position_mm`.

        Raises RenderError where drawing fails.
        """
        return Expected(self._birth(position_mm), self._toolpath.laid_at(file_pos), before)

    def map_at(self, position_mm: tuple[float, float, float]) -> PrintMap:
        """Raises RenderError where drawing fails."""
        pose = self.pose(position_mm)
        if pose not in self._maps:
            _make_room(self._maps)
            self._maps[pose] = self._print_map(self._birth(position_mm), np.array(pose))
        return self._maps[pose]

    def _birth(self, position_mm: tuple[float, float, float]) -> np.ndarray:
        pose = self.pose(position_mm)
        if pose not in self._births:
            _make_room(self._births)
            self._births[pose] = self._renderer.birth_map(self._toolpath, self._camera, np.array(pose))
        return self._births[pose]

    def _print_map(self, birth: np.ndarray, shift_mm: np.ndarray) -> PrintMap:
        layer = np.searchsorted(self._toolpath.layer_start, birth, side="left").astype(np.int32) - 1
        owner, covers = np.full(birth.shape, -1, np.int16), np.zeros(birth.shape, np.int16)
        silhouettes = np.zeros(birth.shape, np.uint8)
        for number in range(len(self._toolpath.objects)):
            beads = np.flatnonzero(self._toolpath.object_id == number)
            if not len(beads):
                continue
            covered = self._renderer.birth_map(self._toolpath, self._camera, shift_mm, beads) > NEVER
            owner[covered] = number
            covers += covered
            silhouettes[covered] = 255
        owner[covers > 1] = -1
        return PrintMap(layer, owner, _nearest(owner, silhouettes), len(self._toolpath.objects))


def _nearest(owner: np.ndarray, silhouettes: np.ndarray) -> np.ndarray:
    """(H, W) int16: the owner of the nearest pixel that has one, -1 where no pixel has."""
    owned = (owner >= 0) & (silhouettes > 0)
    if not owned.any():
        return np.full(owner.shape, -1, np.int16)
    _, labels = cv2.distanceTransformWithLabels(
        np.where(owned, np.uint8(0), np.uint8(255)), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    owner_of_label = np.full(int(labels.max()) + 1, -1, np.int16)
    owner_of_label[labels[owned]] = owner[owned]
    return owner_of_label[labels]


def _make_room(cache: dict) -> None:
    """A pose that changes with every check must not fill the memory."""
    while len(cache) >= KEPT_POSES:
        cache.pop(next(iter(cache)))
