"""Prints of other people's slicers, painted by the demo's simulated webcam: cameras, colours, lights, faults by seed."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np

from benchmarks.composited import Base, Picture
from octoprint_moop.core.camera import BedMotion, Camera
from octoprint_moop.core.gcode.read import read_gcode
from octoprint_moop.core.header import Header, Moment, Printer
from octoprint_moop.core.segmentation.segment import HsvThresholds, hsv
from octoprint_moop.core.toolpath import Toolpath
from octoprint_moop.demo.faults import KINDS, Fault
from octoprint_moop.demo.painter import Light
from octoprint_moop.demo.simulate import NUISANCES, Nuisance, Scene

MODELS = (
    "prusaslicer_multi", "cura_multi", "slic3r_multi", "superslicer_multi", "m486_multi", "cura_3.6.0_calcube",
    "ideamaker_multi", "kirimoto_multi", "prusaslicer_2.7.4_vase",
)  # fmt: skip
COLOURS_BGR = (
    (24.0, 104.0, 240.0),
    (40.0, 190.0, 60.0),
    (200.0, 70.0, 30.0),
    (40.0, 30.0, 210.0),
    (30.0, 200.0, 235.0),
)
MANY_COLOURS_BGR = (
    *COLOURS_BGR, (235.0, 235.0, 235.0), (30.0, 30.0, 30.0), (128.0, 128.0, 130.0), (150.0, 90.0, 220.0),
    (60.0, 90.0, 130.0), (190.0, 170.0, 60.0),
)  # fmt: skip
FAULT_NAMES = {"extrusion_stop": "extrusion"}
MOST_LAYERS, SIZE_PX = 40, (480, 360)


@cache
def _toolpath(path: Path) -> Toolpath:
    return read_gcode(path)


@dataclass(eq=False)
class PaintedStory:
    """One run, in the terms of `composited.Story`."""

    toolpath: Toolpath
    header: Header
    name: str
    strength: float
    nuisances: tuple[str, ...]
    fault: str | None
    onset: int
    object_name: str | None
    reference: np.ndarray
    _scene: Scene
    _clean: Scene
    _layers: np.ndarray
    _stands: bool = False

    @classmethod
    def drawn(cls, seed: int, rng: np.random.Generator, models: Path) -> PaintedStory:
        """A print with a fault in seven of ten, and a nuisance in four."""
        name, toolpath = _model(rng, models)
        low, high = toolpath.bounds_mm()
        bed_mm = (max(high[0] + 30, 220.0), max(high[1] + 30, 210.0))
        bed = BedMotion(str(rng.choice(["fixed", "y"])), (0.0, bed_mm[1], 0.0))
        camera = _camera(low, high, rng, SIZE_PX)
        layers = _layers(toolpath)
        kind = None if rng.random() < 0.3 else str(rng.choice(KINDS))
        strength, onset, faults, object_name = float(rng.choice([0.4, 0.7, 1.0, 1.5])), 0, (), None
        if kind:
            onset = int(rng.integers(3, max(4, len(layers) - 8)))
            number = None
            if len(toolpath.objects) > 1 and kind != "layer_shift":
                number = int(rng.integers(len(toolpath.objects)))
                object_name = toolpath.objects[number]
            faults = (Fault(kind, int(layers[onset]), number, strength),)
        nuisances = ()
        if rng.random() < 0.4:
            begin = int(layers[rng.integers(1, len(layers) - 2)])
            nuisances = (Nuisance(str(rng.choice(NUISANCES)), begin, 3, float(rng.uniform(0.4, 1.0))),)
        light = Light(level=float(rng.uniform(0.7, 1.1)), mirror_ratio=float(rng.choice([0.0, 0.12])))
        look = {
            "material_bgr": COLOURS_BGR[rng.integers(len(COLOURS_BGR))], "light": light, "seed": seed,
            "surface": str(rng.choice(["sheet", "steel", "glass"])), "bed_mm": bed_mm, "with_head": False,
        }  # fmt: skip
        scene = Scene(toolpath, camera, bed, faults=faults, nuisances=nuisances, **look)
        clean = Scene(toolpath, camera, bed, **look)
        story = cls(
            toolpath, Header(Printer(*bed_mm, 210, bed=bed), ((None, camera),), None, name, toolpath.bytes), name,
            strength, tuple(n.kind for n in nuisances), FAULT_NAMES.get(kind, kind) if kind else None, onset, object_name,
            _decoded(clean.jpeg(0, (0.0, bed_mm[1], 0.0))), scene, clean, layers,
        )  # fmt: skip
        story.header = replace(story.header, material=story._picked())
        return story

    @classmethod
    def good(cls, seed: int, models: Path, size_px: tuple[int, int], still: bool) -> PaintedStory:
        """A print that goes well, of any colour, on any bed.

        still : the bed stands at each picture where it stood at the one before, and the head never comes into view; if
        not, one print in five is seen with its head where it stands, and one in four on a bed that sinks
        """
        rng = np.random.default_rng([seed, 17])
        name, toolpath = _model(rng, models)
        low, high = toolpath.bounds_mm()
        bed_mm = (max(high[0] + 30, 220.0), max(high[1] + 30, 210.0))
        kind = "fixed" if still else str(rng.choice(["fixed", "y", "z"], p=[0.5, 0.25, 0.25]))
        stands = not still and rng.random() < 1 / 5
        # the camera is set up to see the bed where it stands when the pictures are taken
        bed = BedMotion(kind, (0.0, float((low[1] + high[1]) / 2) if stands else bed_mm[1], 0.0))
        camera = _camera(low, high, rng, size_px)
        light = Light(level=float(rng.uniform(0.6, 1.2)), mirror_ratio=float(rng.choice([0.0, 0.12])))
        clean = Scene(
            toolpath, camera, bed, material_bgr=MANY_COLOURS_BGR[rng.integers(len(MANY_COLOURS_BGR))], light=light,
            seed=seed, surface=str(rng.choice(["sheet", "steel", "glass"])), bed_mm=bed_mm, with_head=stands,
        )  # fmt: skip
        header = Header(Printer(*bed_mm, 210, bed=bed), ((None, camera),), None, name, toolpath.bytes)
        story = cls(
            toolpath, header, name, 1.0, (), None, 0, None, _decoded(clean.jpeg(0, (0.0, bed.reference_mm[1], 0.0))), clean,
            clean, _layers(toolpath), stands,
        )  # fmt: skip
        return story

    def painted(self) -> Base:
        """All its pictures, to put faults and nuisances into."""
        moments = tuple(self.moment(number) for number in range(len(self)))
        pictures = [self.picture(number) for number in range(len(self))]
        totals = np.full(len(self), max(int(np.count_nonzero(pictures[-1].mask)), 1))
        frames, masks = np.stack([one.frame for one in pictures]), np.stack([one.mask for one in pictures])
        return Base(self.name, self.header, self.toolpath, moments, frames, masks, self.reference, totals)

    def __len__(self) -> int:
        return len(self._layers)

    def moment(self, number: int) -> Moment:
        layer = int(self._layers[number])
        z_mm, file_pos = float(self.toolpath.layer_z_mm[layer]), int(self.toolpath.layer_end_pos[layer])
        position_mm = (0.0, self.header.printer.bed.reference_mm[1], z_mm)
        if self._stands:
            x, y, z = self.toolpath.beads_mm[self.toolpath.laid_at(file_pos) - 1][3:6].astype(float)
            position_mm = (float(x), float(y), float(z))
        return Moment(f"{number:06d}.jpg", file_pos, layer, position_mm, parked=not self._stands)

    def picture(self, number: int) -> Picture:
        moment = self.moment(number)
        frame = _decoded(self._scene.jpeg(moment.file_pos, moment.position_mm))
        return Picture(frame, self._scene.truth(moment.file_pos, moment.position_mm) > 0)

    def clean_mask(self, number: int) -> np.ndarray:
        moment = self.moment(number)
        return self._clean.truth(moment.file_pos, moment.position_mm) > 0

    def total_px(self, number: int) -> int:
        return max(int(np.count_nonzero(self.clean_mask(len(self) - 1))), 1)

    def finished(self, number: int) -> np.ndarray:
        moment = self.moment(number)
        return _decoded(self._clean.jpeg(moment.file_pos, moment.position_mm, shot=1))

    def _picked(self) -> HsvThresholds:
        """Thresholds as a careful user picks them: around nine tenths of what the filament shows half way up."""
        number = len(self) // 2
        inside = cv2.erode(self.clean_mask(number).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
        hue, saturation, value = hsv(self.finished(number))[inside].T
        middle = np.degrees(np.angle(np.exp(1j * np.radians(hue)).mean())) % 360
        off = (hue - middle + 180) % 360 - 180
        low, high = np.percentile(off, [3, 97]) + [-6, 6]
        return HsvThresholds(
            float((middle + low) % 360), float((middle + high) % 360),
            float(0.8 * np.percentile(saturation, 4)), float(0.8 * np.percentile(value, 4)),
        )  # fmt: skip


def _decoded(jpeg: bytes) -> np.ndarray:
    return cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)


def _model(rng: np.random.Generator, models: Path) -> tuple[str, Toolpath]:
    name = str(rng.choice(MODELS))
    return name, _toolpath(models / f"{name}.gcode")


def _layers(toolpath: Toolpath) -> np.ndarray:
    """The first four and some of all others, evenly."""
    some = np.linspace(0, toolpath.layers - 1, min(MOST_LAYERS, toolpath.layers)).round().astype(int)
    return np.unique(np.concatenate([np.arange(min(4, toolpath.layers)), some]))


def _camera(low_mm: np.ndarray, high_mm: np.ndarray, rng: np.random.Generator, size_px: tuple[int, int]) -> Camera:
    """A camera before the bed that looks at the print, which fills a third to two thirds of its picture."""
    target = (low_mm + high_mm) / 2
    extent = max(float((high_mm - low_mm).max()), 25.0)
    focal_px = size_px[0] * rng.uniform(0.8, 1.3)
    distance = focal_px * extent / (size_px[0] * rng.uniform(0.3, 0.6))
    round_deg, up_deg = rng.uniform(-50, 50), rng.uniform(18, 50)
    turn, rise = np.radians(round_deg), np.radians(up_deg)
    eye = target + distance * np.array([np.sin(turn) * np.cos(rise), -np.cos(turn) * np.cos(rise), np.sin(rise)])
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    K = [[focal_px, 0, size_px[0] / 2 - 0.5], [0, focal_px, size_px[1] / 2 - 0.5], [0, 0, 1]]
    bend = float(rng.uniform(-0.2, 0.05))
    return Camera(size_px, K, [bend, -0.3 * bend, 0, 0, 0], cv2.Rodrigues(rotation)[0].ravel(), -rotation @ eye)
