"""The picture that a webcam would take of what has really been printed so far, faults included."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from ..core.camera import BedMotion, Camera
from ..core.toolpath import Role, Toolpath
from .faults import Fault, Matter, matter_at
from .painter import SUPERSAMPLING, Canvas, Light, Painter
from .room import Room

NUISANCES = ("dim", "bright", "hand", "nudge", "white_balance", "black")
ORANGE_BGR = (24.0, 104.0, 240.0)
_OPEN_LAYERS = 10
_FEW = 4_000


@dataclass(frozen=True)
class Nuisance:
    """Something that a camera sees and a print doesn't care about.

    kind     : one of NUISANCES
    layer    : the first layer with it (0-based)
    layers   : for how many layers
    strength : 1.0 is noticeable at a glance
    """

    kind: str
    layer: int
    layers: int = 1_000_000
    strength: float = 1.0

    def __post_init__(self) -> None:
        if self.kind not in NUISANCES:
            raise ValueError(f"Unknown nuisance {self.kind!r}; known are {', '.join(NUISANCES)}.")


class Scene:
    """One print, in one room, before one camera. The same pictures for the same seed.

    material_bgr : the filament under white light, 0..255
    surface      : of the bed, one of room.SURFACES
    with_head    : False for a machine whose head never comes into the picture
    """

    def __init__(
        self,
        toolpath: Toolpath,
        camera: Camera,
        bed: BedMotion,
        material_bgr: tuple[float, float, float] = ORANGE_BGR,
        light: Light | None = None,
        faults: tuple[Fault, ...] = (),
        nuisances: tuple[Nuisance, ...] = (),
        seed: int = 0,
        surface: str = "sheet",
        bed_mm: tuple[float, float] = (250.0, 210.0),
        with_head: bool = True,
    ) -> None:
        self.toolpath, self._camera, self._bed = toolpath, camera, bed
        self._light, self._seed = light or Light(), seed
        self._material_bgr, self._surface, self._bed_mm = material_bgr, surface, bed_mm
        self._with_head = with_head
        self.faults, self._nuisances = tuple(faults), tuple(nuisances)
        self._views: dict[bool, _View] = {}
        self._phase = np.random.default_rng([seed, 5]).uniform(0, 2 * np.pi, 4)
        rows, columns = np.mgrid[-1 : 1 : camera.image_size_px[1] * 1j, -1 : 1 : camera.image_size_px[0] * 1j]
        fall = 1 - self._light.vignette_ratio * (rows**2 + columns**2) / 2
        self._vignette = fall.astype(np.float32)[..., None]

    def layer_at(self, file_pos: int) -> int:
        """The layer that is being printed, -1 before the first."""
        return self.toolpath.layer_at(file_pos)

    def frame(self, file_pos: int, position_mm: tuple[float, float, float], shot: int = 0) -> np.ndarray:
        """(H, W, 3) uint8 BGR, before compression: everything that ends at or before `file_pos` is done.

        position_mm : where the machine stands; shot : numbers pictures of the same moment, which differ in noise only
        """
        layer, laid = self.toolpath.layer_at(file_pos), self.toolpath.laid_at(file_pos)
        view = self._view(layer)
        picture = view.compose(self._matter(laid), position_mm, self._light.mirror_ratio)
        if self._with_head:
            nozzle = np.asarray(position_mm) + self._bed.room_from_print_mm(position_mm)
            view.room.paint_machine(picture, nozzle)
        if self._nuisance("hand", layer):
            view.room.paint_hand(picture, layer)
        return self._expose(picture, file_pos, layer, shot)

    def jpeg(self, file_pos: int, position_mm: tuple[float, float, float], shot: int = 0) -> bytes:
        """The same as the webcam delivers it."""
        frame = self.frame(file_pos, position_mm, shot)
        return cv2.imencode(".jpg", frame, [cv2.IMWRITE_JPEG_QUALITY, self._light.jpeg_quality])[1].tobytes()

    def truth(self, file_pos: int, position_mm: tuple[float, float, float]) -> np.ndarray:
        """(H, W) uint8, 255 where there is matter in the pixel's middle, head and hands taken away. For scores only."""
        view = self._view(self.toolpath.layer_at(file_pos))
        return view.mask(self._matter(self.toolpath.laid_at(file_pos)), position_mm)

    def _matter(self, laid: int) -> Matter:
        return matter_at(self.toolpath, self.faults, laid, self._seed)

    def _nuisance(self, kind: str, layer: int) -> float:
        """Its strength at that layer, 0 for none."""
        active = (n for n in self._nuisances if n.kind == kind and n.layer <= layer < n.layer + n.layers)
        return max((n.strength for n in active), default=0.0)

    def _view(self, layer: int) -> _View:
        nudge = self._nuisance("nudge", layer)
        if (nudge > 0) not in self._views:
            camera = _nudged(self._camera, nudge, self._seed) if nudge else self._camera
            self._views[nudge > 0] = _View(
                Painter(camera, self._material_bgr, self._light, self._seed),
                Room(camera, self._bed_mm, self._surface, self._seed, self._camera),
                self.toolpath, self._bed, camera.image_size_px,
            )  # fmt: skip
        return self._views[nudge > 0]

    def _expose(self, picture: np.ndarray, file_pos: int, layer: int, shot: int) -> np.ndarray:
        light, share = self._light, file_pos / max(self.toolpath.bytes, 1)
        waves = np.sin(2 * np.pi * share * np.array([1.3, 2.9, 1.7, 2.3]) + self._phase)
        level = light.level * (1 + light.drift_ratio * (0.7 * waves[0] + 0.3 * waves[1]))
        level *= 1 - 0.65 * min(self._nuisance("dim", layer), 1.3)
        level *= 1 + 0.7 * self._nuisance("bright", layer)
        level *= 0.0 if self._nuisance("black", layer) else 1.0
        tint = light.white_balance_ratio * waves[2:] + self._nuisance("white_balance", layer) * np.array([0.12, -0.07])
        gains = (level * np.array([1 + tint[0], 1.0, 1 - tint[0] + tint[1] / 2])).astype(np.float32)
        linear = _LINEAR[np.clip(picture * 4, 0, 1023).astype(np.uint16)] * (gains * self._vignette)
        rng = np.random.default_rng([self._seed, 11, file_pos, shot])
        height, width = linear.shape[:2]
        grain = rng.standard_normal((height, width, 1), dtype=np.float32)
        # A webcam works out its colours from neighbouring pixels and smooths them: their noise is coarser.
        coarse = cv2.resize(rng.standard_normal((height // 2, width // 2, 3), dtype=np.float32), (width, height))
        spread = light.noise_ratio * np.sqrt(linear + 0.012)
        linear += spread * (0.7 * grain + 0.9 * coarse)
        linear = cv2.GaussianBlur(linear, (0, 0), 0.55)
        shown = np.sqrt(np.clip(linear, 0, 1))  # close to the sRGB curve, and quick
        return np.round(255 * np.clip(1.02 * shown - 0.01, 0, 1)).astype(np.uint8)


_LINEAR = ((np.arange(1024) / 1020) ** 2).astype(np.float32)


def _nudged(camera: Camera, strength: float, seed: int) -> Camera:
    """The camera after somebody has knocked against it."""
    turn = np.random.default_rng([seed, 6]).normal(0, 1, 3)
    turn *= np.radians(1.2) * strength / np.linalg.norm(turn)
    rotation = cv2.Rodrigues(turn)[0]
    rvec = cv2.Rodrigues(rotation @ cv2.Rodrigues(camera.rvec)[0])[0].ravel()
    return replace(camera, rvec=rvec, tvec_mm=rotation @ camera.tvec_mm)


class _View:
    """Pictures from one standpoint. What is painted for one pose of the bed is kept while the print grows on it."""

    def __init__(
        self, painter: Painter, room: Room, toolpath: Toolpath, bed: BedMotion, size_px: tuple[int, int]
    ) -> None:
        self.room = room
        self._painter, self._toolpath, self._bed, self._size_px = painter, toolpath, bed, size_px
        self._pose: tuple[float, ...] | None = None
        self._backdrop = np.empty(0)
        self._canvas = Canvas.empty(size_px)
        self._painted = 0
        self._reusable = False

    def compose(self, matter: Matter, position_mm: tuple[float, float, float], mirror_ratio: float) -> np.ndarray:
        """(H, W, 3) float32 BGR 0..255: bed, room and print in even light."""
        self._bring_up(matter, position_mm)
        canvas = self._canvas
        dark = cv2.GaussianBlur(canvas.shadow, (0, 0), 2.5).astype(np.float32)[..., None] / 255
        picture = self._backdrop * (1 - 0.5 * dark)
        if mirror_ratio > 0:
            picture += mirror_ratio * cv2.GaussianBlur(canvas.mirror, (0, 0), 2.0).astype(np.float32)
        cover = self._shrunk(canvas.cover).astype(np.float32)[..., None] / 255
        return picture * (1 - cover) + self._shrunk(canvas.colour).astype(np.float32)

    def mask(self, matter: Matter, position_mm: tuple[float, float, float]) -> np.ndarray:
        """(H, W) uint8, 255 where there is matter in the middle of the pixel."""
        self._bring_up(matter, position_mm)
        middle = SUPERSAMPLING // 2
        return self._canvas.cover[middle::SUPERSAMPLING, middle::SUPERSAMPLING].copy()

    def _shrunk(self, fine: np.ndarray) -> np.ndarray:
        return cv2.resize(fine, self._size_px, interpolation=cv2.INTER_AREA)

    def _bring_up(self, matter: Matter, position_mm: tuple[float, float, float]) -> None:
        shift = self._bed.room_from_print_mm(position_mm)
        pose = tuple(np.round(shift, 3))
        if pose != self._pose:
            self._pose, self._backdrop, self._reusable = pose, self.room.backdrop(shift), False
        grown = self._reusable and matter.unchanged and len(matter) >= self._painted
        new = np.arange(self._painted if grown else 0, len(matter))
        if grown and len(new) and matter.ends_mm[new][:, [2, 5]].min() < self._canvas.top_mm - 0.5:
            grown = False  # printing goes on beside something that stands already: what is new may lie behind it
        if not grown:
            self._canvas = Canvas.empty(self._size_px)
            new = self._exposed(matter)
        self._painter.paint(self._canvas, matter, new, shift)
        self._painted, self._reusable = len(matter), matter.unchanged

    def _exposed(self, matter: Matter) -> np.ndarray:
        """Indices of the strokes that can be seen at all: walls, surfaces, and what lies under the open top."""
        layer = np.searchsorted(self._toolpath.layer_start, matter.bead, side="right") - 1
        role = self._toolpath.role[matter.bead]
        covered = np.isin(role, (Role.INNER, Role.INFILL))
        newest = int(layer.max(initial=0))
        return np.flatnonzero(~covered | (layer > newest - _OPEN_LAYERS) | (len(matter) < _FEW))
