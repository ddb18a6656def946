"""What the camera must see: the expected mask at any moment of a print."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import cv2
import numpy as np

from ..camera import BedMotion, Camera
from ..head import HeadModel
from ..toolpath import Role, Toolpath
from .hardware import hidden_by
from .lens import blind_area
from .solid import Solid

NEVER = 0
NOTHING = -1
MOST_BEADS = 2**31 - 2

OUTWARD = (Role.OUTER, Role.SURFACE, Role.SUPPORT, Role.BRIM, Role.TOWER)
# Up to this many beads a pose that does not last is drawn whole; beyond, what lies inside is left out.
WHOLE_BEADS = 200_000
KEPT_POSES = 4  # a pose that changes with every check must not fill the memory


class MaskRenderer(Protocol):
    """Draws beads. `machine/gl.py` and `core/expected/raster.py` implement it; this file knows neither."""

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

    def solid_map(self, solid: Solid, camera: Camera, room_from_print_mm: np.ndarray) -> np.ndarray:
        """(H, W) uint32: 1 + height in micrometres at which the pixel's centre is first covered when the solid grows
        from the bed upwards: that of the lowest point of its surface on the pixel's ray. 0 where it never is.

        Raises RenderError where drawing fails.
        """


@dataclass(frozen=True, eq=False)
class Silhouette:
    """What a view will show of the complete print, for as long as its birth map is the same.

    birth : (H, W) uint32, as of Expected
    """

    birth: np.ndarray

    @cached_property
    def mask(self) -> np.ndarray:
        """(H, W) uint8, 255 where material will be seen when the print is complete."""
        return _between(self.birth, 0, MOST_BEADS)

    @cached_property
    def surroundings(self) -> tuple[slice, slice]:
        return surroundings(self.mask)


@dataclass(frozen=True, eq=False)
class Expected:
    """The expected state of the view at one moment, all (H, W) in the camera's own pixels.

    birth  : uint32, 1 + index of the first bead that covers the pixel in the complete print, 0 for never
    laid   : number of beads that lie at this moment
    doubt  : so many of the `laid` may not lie yet, since the printer lags behind the file
    hidden : uint8, 255 where the lens's edge leaves nothing to be seen; None for nowhere
    volume : uint8, 255 where the head or the gantry may stand before the print; None where they are out of the way
    known_silhouette : of the same birth map, where it is there already
    """

    birth: np.ndarray
    laid: int
    doubt: int = 0
    hidden: np.ndarray | None = None
    volume: np.ndarray | None = None
    known_silhouette: Silhouette | None = None

    @cached_property
    def silhouette(self) -> Silhouette:
        known = self.known_silhouette
        return known if known is not None and known.birth is self.birth else Silhouette(self.birth)

    @cached_property
    def mask(self) -> np.ndarray:
        """uint8, 255 where material must be seen now."""
        return _between(self.birth, 0, self.laid)

    @property
    def complete(self) -> np.ndarray:
        """uint8, 255 where material will be seen when the print is complete."""
        return self.silhouette.mask

    @property
    def surroundings(self) -> tuple[slice, slice]:
        """Rows and columns in which matter may lie that has to do with the print; see the function of that name."""
        return self.silhouette.surroundings

    @cached_property
    def ignored(self) -> np.ndarray | None:
        """uint8, 255 where nothing can be said: hidden, or covered first by a bead that may not lie yet. None for nowhere."""
        if not self.doubt:
            return self.hidden
        doubtful = _between(self.birth, max(self.laid - self.doubt, 0), self.laid)
        return doubtful if self.hidden is None else doubtful | self.hidden

    @cached_property
    def head(self) -> np.ndarray:
        """uint8, 255 where the head or the gantry may be."""
        return np.zeros(self.birth.shape, np.uint8) if self.volume is None else self.volume


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


@dataclass(frozen=True)
class _Drawing:
    """What one birth map depends on: the bed's pose, who is cancelled, and the layer where only outward beads count."""

    shift_mm: tuple[float, ...]
    gone: tuple[tuple[int, int], ...]
    layer: int | None


class ExpectedViews:
    """Expected views of one print by one camera. A birth map is drawn once for each pose of the bed and kept.

    Where the pose is another at each check (a bed that drops, a slinger that is not parked) and the print is large,
    only what can be seen from outside is drawn: outward beads and the whole of the last layer.
    """

    def __init__(
        self, toolpath: Toolpath, camera: Camera, bed: BedMotion, renderer: MaskRenderer, head: HeadModel | None = None
    ) -> None:
        self._toolpath, self._camera, self._bed, self._renderer, self._head = toolpath, camera, bed, renderer, head
        self._births: dict[_Drawing, Silhouette] = {}
        self._maps: dict[_Drawing, PrintMap] = {}
        blind = blind_area(camera)
        self._blind = blind if blind.any() else None

    def pose(self, position_mm: tuple[float, float, float]) -> tuple[float, ...]:
        """What tells one pose of the bed from another, for those who keep something for each."""
        return tuple(np.round(self._bed.room_from_print_mm(position_mm), 3).tolist())

    def at(
        self,
        file_pos: int,
        position_mm: tuple[float, float, float],
        cancelled: Mapping[int, int] | None = None,
        sure_pos: int | None = None,
        parked: bool = True,
    ) -> Expected:
        """What must be seen when everything up to `file_pos` is done and the machine stands at `position_mm`.

        cancelled : objects that were cancelled while printing: index -> file position from which on it is not printed
        sure_pos  : what ends after it may not be done yet, where the printer lags behind; None for no doubt
        parked    : False where the head stands over the print; then its volume is ignored
        Raises RenderError where drawing fails.
        """
        laid = self._toolpath.laid_at(file_pos)
        volume = None
        if not parked and self._head is not None:
            volume = hidden_by(self._head, position_mm, self._bed, self._camera)
        silhouette = self._silhouette(self._drawing(position_mm, file_pos, cancelled, parked))
        doubt = 0 if sure_pos is None else laid - self._toolpath.laid_at(sure_pos)
        return Expected(silhouette.birth, laid, doubt, self._blind, volume, silhouette)

    def map_at(
        self,
        position_mm: tuple[float, float, float],
        file_pos: int = 0,
        cancelled: Mapping[int, int] | None = None,
        parked: bool = True,
    ) -> PrintMap:
        """Layers and objects of the complete print at a pose. Raises RenderError where drawing fails."""
        drawing = self._drawing(position_mm, file_pos, cancelled, parked)
        if drawing not in self._maps:
            _make_room(self._maps)
            self._maps[drawing] = self._print_map(drawing)
        return self._maps[drawing]

    def covered_at(self, position_mm: tuple[float, float, float], beads: np.ndarray) -> np.ndarray:
        """(H, W) uint8, 255 where these beads (sorted indices) would be seen if nothing else lay there.

        Raises RenderError where drawing fails.
        """
        birth = self._renderer.birth_map(self._toolpath, self._camera, np.array(self.pose(position_mm)), beads)
        return _between(birth, 0, MOST_BEADS)

    def _drawing(
        self,
        position_mm: tuple[float, float, float],
        file_pos: int,
        cancelled: Mapping[int, int] | None,
        parked: bool,
    ) -> _Drawing:
        gone = dict(self._toolpath.cancelled)
        for index, cancel_pos in (cancelled or {}).items():
            gone[index] = min(cancel_pos, gone.get(index, cancel_pos))
        passing = self._bed.kind == "z" or (self._bed.kind == "y" and not parked)
        layer = None
        if passing and len(self._toolpath) > WHOLE_BEADS:
            layer = max(self._toolpath.layer_at(file_pos), 0)
        return _Drawing(self.pose(position_mm), tuple(sorted(gone.items())), layer)

    def _silhouette(self, drawing: _Drawing) -> Silhouette:
        if drawing not in self._births:
            _make_room(self._births)
            self._births[drawing] = Silhouette(self._draw(drawing, self._chosen(drawing)))
        return self._births[drawing]

    def _draw(self, drawing: _Drawing, chosen: np.ndarray | None) -> np.ndarray:
        return self._renderer.birth_map(self._toolpath, self._camera, np.array(drawing.shift_mm), chosen)

    def _chosen(self, drawing: _Drawing) -> np.ndarray | None:
        """Sorted indices of the beads to draw; None for all."""
        if not drawing.gone and drawing.layer is None:
            return None
        wanted = np.ones(len(self._toolpath), dtype=bool)
        if drawing.layer is not None:
            first, end = self._toolpath.layer_start[[drawing.layer, drawing.layer + 1]]
            wanted = self._outward.copy()
            wanted[first:end] = True
        for index, file_pos in drawing.gone:
            wanted &= (self._toolpath.object_id != index) | (self._toolpath.end_pos <= file_pos)
        return np.flatnonzero(wanted)

    @cached_property
    def _outward(self) -> np.ndarray:
        return np.isin(self._toolpath.role, np.array(OUTWARD, dtype=np.uint8))

    def _alone(self, drawing: _Drawing) -> Iterator[tuple[int, np.ndarray]]:
        """Each labelled object's number, and (H, W) bool, where it will be seen if no other stands before it."""
        chosen = self._chosen(drawing)
        owner = self._toolpath.object_id if chosen is None else self._toolpath.object_id[chosen]
        for number in range(len(self._toolpath.objects)):
            own = np.flatnonzero(owner == number)
            if own.size:
                yield number, self._draw(drawing, own if chosen is None else chosen[own]) > 0

    def _print_map(self, drawing: _Drawing) -> PrintMap:
        birth = self._silhouette(drawing).birth
        layer = np.searchsorted(self._toolpath.layer_start, birth, side="left").astype(np.int32) - 1
        owner, covers = np.full(birth.shape, NOTHING, np.int16), np.zeros(birth.shape, np.int16)
        for number, covered in self._alone(drawing):
            owner[covered] = number
            covers += covered
        owner[covers > 1] = NOTHING
        return PrintMap(layer, owner, _nearest(owner), len(self._toolpath.objects))


def box_about(mask: np.ndarray, margin: int) -> tuple[slice, slice]:
    """Rows and columns that hold a mask (uint8) and so many pixels around."""
    height, width = mask.shape
    x, y, w, h = cv2.boundingRect(mask)
    return slice(max(y - margin, 0), min(y + h + margin, height)), slice(max(x - margin, 0), min(x + w + margin, width))


def surroundings(complete: np.ndarray, least_px: int = 24) -> tuple[slice, slice]:
    """Rows and columns in which matter may lie that has to do with a print: its own, and a quarter of its size around.

    complete : (H, W) uint8, as of Expected; where it is empty all may be looked at
    """
    _, _, width, height = cv2.boundingRect(complete)
    return box_about(complete, max(width, height) // 4 + least_px if width else max(complete.shape))


def _between(birth: np.ndarray, first: int, end: int) -> np.ndarray:
    """uint8, 255 where the bead of index `birth - 1` is one of first, ..., end - 1."""
    return cv2.inRange(birth.view(np.int32), first + 1, end)


def _nearest(owner: np.ndarray) -> np.ndarray:
    """(H, W) int16: the owner of the nearest pixel that has one, NOTHING where no pixel has."""
    owned = owner != NOTHING
    if not owned.any():
        return owner.copy()
    _, labels = cv2.distanceTransformWithLabels(
        np.where(owned, np.uint8(0), np.uint8(255)), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    owner_of_label = np.full(int(labels.max()) + 1, NOTHING, np.int16)
    owner_of_label[labels[owned]] = owner[owned]
    return owner_of_label[labels]


def _make_room(kept: dict) -> None:
    while len(kept) >= KEPT_POSES:
        kept.pop(next(iter(kept)))
