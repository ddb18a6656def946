"""Two walls seen straight on, painted by hand: every pixel's truth is known without camera or renderer."""

from __future__ import annotations

import cv2
import numpy as np

from octoprint_moop.core.decision.evidence import find
from octoprint_moop.core.decision.findings import Findings, Sight
from octoprint_moop.core.decision.memory import Memory
from octoprint_moop.core.expected.views import Expected, PrintMap

SHAPE = (240, 320)
GROUND, LAYER_PX, LAYERS = 180, 2, 40
WALLS = ((90, 150), (170, 230))  # columns of the left and of the right wall
BED_BGR, PLASTIC_BGR = (60, 62, 58), (30, 120, 235)
PX_PER_MM = 4.0


def wall(number: int, upto: int, since: int = 0) -> np.ndarray:
    """(H, W) bool: layers since..upto (both included) of one wall."""
    mask = np.zeros(SHAPE, bool)
    mask[GROUND - (upto + 1) * LAYER_PX : GROUND - since * LAYER_PX, slice(*WALLS[number])] = True
    return mask


def walls(upto: int) -> np.ndarray:
    return wall(0, upto) | wall(1, upto)


def moved(mask: np.ndarray, right: int, down: int) -> np.ndarray:
    return cv2.warpAffine(mask.astype(np.uint8), np.float32([[1, 0, right], [0, 1, down]]), SHAPE[::-1]) > 0


class Stage:
    """A print in the making. `look` gives the findings of one frame, `good` also learns from it."""

    def __init__(
        self, reference: bool = True, textured: bool = False, plastic_bgr: tuple[int, int, int] = PLASTIC_BGR
    ) -> None:
        birth = np.zeros(SHAPE, np.uint32)
        layer_of, owner = np.full(SHAPE, -1, np.int32), np.full(SHAPE, -1, np.int16)
        for layer in range(LAYERS - 1, -1, -1):
            for number in (0, 1):
                part = wall(number, layer, layer)
                birth[part], layer_of[part], owner[part] = 2 * layer + number + 1, layer, number
        nearest = np.where(np.arange(SHAPE[1])[None, :] < 160, 0, 1).astype(np.int16) * np.ones(SHAPE, np.int16)
        self._plastic_bgr = plastic_bgr
        self.map = PrintMap(layer_of, owner, nearest, 2)
        self._birth, self._rng = birth, np.random.default_rng(3)
        self.bed = np.full((*SHAPE, 3), BED_BGR, np.uint8)
        if textured:
            grain = cv2.GaussianBlur(np.random.default_rng(4).normal(0, 60, SHAPE), (0, 0), 2.0)
            self.bed = np.clip(self.bed + grain[..., None] * 3, 0, 255).astype(np.uint8)
        self.memory = Memory(self.bed if reference else None, SHAPE)

    def sight(
        self, layer: int, matter: np.ndarray, gain: float = 1.0, observed: np.ndarray | None = None,
        bed_px: tuple[int, int] = (0, 0),
    ) -> Sight:  # fmt: skip
        """matter : (H, W) bool, what really lies; observed : what segmentation makes of it, the truth unless given;
        bed_px : by how much the bed is displaced in the picture."""
        bed = np.roll(self.bed, (bed_px[1], bed_px[0]), axis=(0, 1))
        frame = np.where(matter[..., None], self._plastic_bgr, bed) * gain + self._rng.normal(0, 2.0, (*SHAPE, 3))
        seen = matter if observed is None else observed
        expected = Expected(self._birth, 2 * (layer + 1))
        return Sight(
            np.clip(frame, 0, 255).astype(np.uint8), np.where(seen, np.uint8(255), np.uint8(0)),
            np.zeros(SHAPE, np.uint8), expected, self.map, layer, tolerance_px=2.0,
        )  # fmt: skip

    def look(self, layer: int, matter: np.ndarray, **more: object) -> Findings:
        return find(self.sight(layer, matter, **more), self.memory)

    def good(self, layer: int, matter: np.ndarray) -> Findings:
        sight = self.sight(layer, matter)
        found = find(sight, self.memory)
        self.memory.learn(found.window, found.wanted, found.look, found.seen, found.known)
        return found

    def printed(self, upto: int) -> Stage:
        """All went well up to that layer."""
        for layer in range(upto + 1):
            self.good(layer, walls(layer))
        return self
