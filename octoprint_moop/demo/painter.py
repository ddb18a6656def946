"""Paints beads as a camera sees them: from the far to the near, each a rounded bar with a lit top and side.

Nothing here is shared with what the checker draws: neither the geometry nor the way of hiding what lies behind.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from ..core.camera import Camera
from .faults import Matter

SUPERSAMPLING = 3  # odd, so that one sample lies in the pixel's middle
_SUBPIXEL_BITS = 4


@dataclass(frozen=True)
class Light:
    """The light in the room and what the webcam makes of it.

    level               : brightness of the lamp, 1 is well exposed
    towards             : direction from the print to the lamp
    ambient_ratio       : share of the light that comes from everywhere
    gloss_ratio         : strength of the highlights on the plastic
    mirror_ratio        : how much of the print the bed reflects
    drift_ratio         : slow wandering of brightness in the course of a print, up and down
    white_balance_ratio : the same of the colours
    noise_ratio         : standard deviation of the sensor's noise at full signal
    vignette_ratio      : loss of light in the corners of the picture
    jpeg_quality        : 1 to 100
    """

    level: float = 1.0
    towards: tuple[float, float, float] = (-0.55, -0.45, 0.8)
    ambient_ratio: float = 0.42
    gloss_ratio: float = 0.35
    mirror_ratio: float = 0.12
    drift_ratio: float = 0.06
    white_balance_ratio: float = 0.03
    noise_ratio: float = 0.016
    vignette_ratio: float = 0.3
    jpeg_quality: int = 88


@dataclass(eq=False)
class Canvas:
    """Matter painted so far, at SUPERSAMPLING times the frame's size, shadow and mirror image at the frame's size.

    colour (uint8 BGR), cover (uint8, 255 where there is matter), shadow (uint8), mirror (uint8 BGR), and the height
    of the highest bead in it.
    """

    colour: np.ndarray
    cover: np.ndarray
    shadow: np.ndarray
    mirror: np.ndarray
    top_mm: float = -np.inf

    @classmethod
    def empty(cls, size_px: tuple[int, int]) -> Canvas:
        width, height = size_px
        fine = (height * SUPERSAMPLING, width * SUPERSAMPLING)
        return cls(
            np.zeros((*fine, 3), np.uint8), np.zeros(fine, np.uint8),
            np.zeros((height, width), np.uint8), np.zeros((height, width, 3), np.uint8),
        )  # fmt: skip


class Painter:
    """Paints strokes of one material under one light, for one camera.

    material_bgr : (3,) 0..255, the filament under white light
    """

    def __init__(self, camera: Camera, material_bgr: tuple[float, float, float], light: Light, seed: int) -> None:
        self._camera, self._light = camera, light
        self._albedo = (np.asarray(material_bgr, dtype=np.float64) / 255) ** 2.2
        self._towards = np.asarray(light.towards, dtype=np.float64) / np.linalg.norm(light.towards)
        self._tone = np.random.default_rng([seed, 7]).normal(1.0, 0.02, 4096)

    def paint(self, canvas: Canvas, matter: Matter, strokes: np.ndarray, shift_mm: np.ndarray) -> None:
        """Adds the strokes (indices) of `matter` to the canvas, which must hold nothing that lies above them.

        shift_mm : (3,) from print to room coordinates
        """
        if not len(strokes):
            return
        ends = matter.ends_mm[strokes] + np.tile(shift_mm, 2)
        order = self._far_to_near(ends)
        strokes, ends = strokes[order], ends[order]
        width, height = matter.size_mm[strokes].T
        start, end = ends[:, :3], ends[:, 3:]
        along = end - start
        along[:, 2] = 0
        length = np.linalg.norm(along, axis=1, keepdims=True)
        along = np.where(length > 1e-9, along / np.maximum(length, 1e-9), [1.0, 0.0, 0.0])
        across = np.column_stack([-along[:, 1], along[:, 0], np.zeros(len(along))])
        # The side that the camera sees.
        to_camera = self._camera.centre_mm - (start + end) / 2
        # OpenCV fills a polygon's edge as well, half a pixel beyond it on each side.
        fine_mm = np.linalg.norm(to_camera, axis=1) / (self._camera.K[0, 0] * SUPERSAMPLING)
        width, height = np.maximum(width - fine_mm, 0.1), np.maximum(height - fine_mm, 0.05)
        start, end = start - [0.0, 0.0, 0.5] * fine_mm[:, None], end - [0.0, 0.0, 0.5] * fine_mm[:, None]
        across *= np.where((across * to_camera).sum(axis=1) < 0, -1.0, 1.0)[:, None]
        to_camera /= np.linalg.norm(to_camera, axis=1, keepdims=True)

        bars = _Bars(*(self._frames(point, along, across) for point in (start, end)))
        outline, side, top = _outline(bars, width, height), _side(bars, width, height), _top(bars, width)
        groove_bgr, side_bgr, top_bgr = self._colours(along, across, to_camera, matter.bead[strokes])
        self._paint_polygons(canvas, outline, side, top, groove_bgr, side_bgr, top_bgr)
        self._paint_shadow(canvas.shadow, start, end, width, shift_mm[2])
        if self._light.mirror_ratio > 0:
            self._paint_mirror(canvas.mirror, start, end, width, height, shift_mm[2], side_bgr)
        canvas.top_mm = max(canvas.top_mm, float(matter.ends_mm[strokes][:, [2, 5]].max()))

    def _far_to_near(self, ends_mm: np.ndarray) -> np.ndarray:
        """Layers from the camera's far side to the near one, and the beads of a layer from far to near.

        Layers are slabs, and of two slabs the one on the camera's side of the plane between them hides the other: so
        this is exact for whole layers, and off by parts of a bead for what lies askew.
        """
        middle = (ends_mm[:, :3] + ends_mm[:, 3:]) / 2
        centre = self._camera.centre_mm
        slab = np.round(middle[:, 2] / 0.05)
        rank = -np.abs(slab - centre[2] / 0.05)  # from above and from below towards the camera's own height
        distance = np.linalg.norm(middle[:, :2] - centre[:2], axis=1)
        return np.lexsort((-distance, rank))

    def _frames(self, point: np.ndarray, along: np.ndarray, across: np.ndarray) -> np.ndarray:
        """(N, 4, 2) float64, canvas pixels: each point, and what a millimetre along, across and up adds to it.

        A bead is so thin that its picture is that of a flat lens: the error is a hundredth of a pixel.
        """
        up = np.broadcast_to([0.0, 0.0, 1.0], along.shape)
        corners = np.stack([point, point + along, point + across, point + up], axis=1)
        pixels = self._camera.project(corners.reshape(-1, 3)).reshape(-1, 4, 2)
        pixels = (np.nan_to_num(pixels, nan=-1e5).clip(-1e5, 1e5) + 0.5) * SUPERSAMPLING - 0.5
        pixels[:, 1:] -= pixels[:, :1]
        return pixels

    def _colours(
        self, along: np.ndarray, across: np.ndarray, to_camera: np.ndarray, bead: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """BGR colours of the groove between beads, the side and the top: each (N, 3), 0..255."""
        light, ambient = self._light, self._light.ambient_ratio
        tone = self._tone[bead % len(self._tone)][:, None]
        half = to_camera + self._towards
        half /= np.linalg.norm(half, axis=1, keepdims=True)
        # A bead is a cylinder: it shines where the half vector stands across it (Kajiya and Kay, 1989).
        shine = light.gloss_ratio * (1 - np.abs((half * along).sum(axis=1, keepdims=True))) ** 8

        def lit(normal: np.ndarray, open_ratio: float, gloss: float) -> np.ndarray:
            facing = np.clip((normal * self._towards).sum(axis=1, keepdims=True), 0, None)
            sky = 0.6 + 0.4 * normal[:, 2:3]
            linear = self._albedo * tone * open_ratio * (ambient * sky + 1.15 * (1 - ambient) * facing)
            linear = linear + gloss * shine * facing
            return 255 * np.clip(linear * 1.2, 0, 1) ** (1 / 2.2)

        up = np.broadcast_to([0.0, 0.0, 1.0], along.shape)
        rounded = across * 0.93 + up * 0.37
        return lit(across, 0.4, 0.0), lit(rounded, 1.0, 0.5), lit(up, 1.0, 0.25)

    @staticmethod
    def _paint_polygons(
        canvas: Canvas, outline: np.ndarray, side: np.ndarray, top: np.ndarray,
        groove_bgr: np.ndarray, side_bgr: np.ndarray, top_bgr: np.ndarray,
    ) -> None:  # fmt: skip
        height, width = canvas.cover.shape
        low, high = outline.min(axis=1), outline.max(axis=1)
        limit = np.array([width, height]) << _SUBPIXEL_BITS
        inside = ((high > 0) & (low < limit)).all(axis=1) & (high - low < limit).all(axis=1)
        colours = np.hstack([groove_bgr, side_bgr, top_bgr]).round().tolist()
        fill, bits = cv2.fillConvexPoly, _SUBPIXEL_BITS
        for row in np.flatnonzero(inside):
            shape, tint = cv2.convexHull(outline[row]), colours[row]
            fill(canvas.cover, shape, 255, 8, bits)
            fill(canvas.colour, shape, tint[:3], 8, bits)
            fill(canvas.colour, side[row], tint[3:6], 8, bits)
            fill(canvas.colour, top[row], tint[6:], 8, bits)

    def _paint_shadow(
        self, shadow: np.ndarray, start: np.ndarray, end: np.ndarray, width: np.ndarray, bed_z_mm: float
    ) -> None:
        cast = self._towards / self._towards[2]
        ends = np.stack([point - (point[:, 2:] - bed_z_mm) * cast for point in (start, end)], axis=1)
        self._lines(shadow, ends, width, np.full((len(start), 1), 255.0))

    def _paint_mirror(
        self, mirror: np.ndarray, start: np.ndarray, end: np.ndarray, width: np.ndarray, height: np.ndarray,
        bed_z_mm: float, side_bgr: np.ndarray,
    ) -> None:  # fmt: skip
        ends = np.stack([start, end], axis=1)
        ends[:, :, 2] = 2 * bed_z_mm - ends[:, :, 2] + height[:, None] / 2
        self._lines(mirror, ends, np.maximum(width, height), side_bgr)

    def _lines(self, image: np.ndarray, ends_mm: np.ndarray, width_mm: np.ndarray, colour: np.ndarray) -> None:
        pixels = np.nan_to_num(self._camera.project(ends_mm.reshape(-1, 3)), nan=-1e4).clip(-3e3, 3e3)
        distance = np.linalg.norm(ends_mm.mean(axis=1) - self._camera.centre_mm, axis=1)
        thick = np.maximum(np.round(width_mm * self._camera.K[0, 0] / distance), 1).astype(int).tolist()
        corners = np.round(pixels * 16).astype(np.int32).reshape(-1, 4).tolist()
        for (x0, y0, x1, y1), tint, across_px in zip(corners, colour.tolist(), thick):
            cv2.line(image, (x0, y0), (x1, y1), tint, across_px, cv2.LINE_8, 4)


class _Bars:
    """Where the corners of beads come to lie in the picture; start and end as `Painter._frames` has them."""

    def __init__(self, start: np.ndarray, end: np.ndarray) -> None:
        self._ends = (start, end)
        self._corners: list[np.ndarray] = []

    def add(self, end: int, along_mm: np.ndarray, across_mm: np.ndarray, up_mm: np.ndarray) -> None:
        """A corner so far from the start (0) or the end (1); `along_mm` counts away from the bead."""
        frame = self._ends[end]
        away = along_mm if end else -along_mm
        self._corners.append(
            frame[:, 0] + away[:, None] * frame[:, 1] + across_mm[:, None] * frame[:, 2] + up_mm[:, None] * frame[:, 3]
        )

    def take(self) -> np.ndarray:
        """(N, C, 2) int32: the corners added so far, in fixed-point pixels of the canvas; begins anew."""
        corners, self._corners = np.stack(self._corners, axis=1), []
        return np.round(corners.clip(-1e4, 1e4) * (1 << _SUBPIXEL_BITS)).astype(np.int32)


def _outline(bars: _Bars, width: np.ndarray, height: np.ndarray) -> np.ndarray:
    """(N, 32, 2): a bar with rounded sides and ends: a slicer's rectangle between two half circles."""
    radius = height / 2
    for inset, level in ((0.0, 0.414), (0.586, 1.0)):  # an octagon around the circle
        half = width / 2 - inset * radius
        for end in (0, 1):
            for reach, side in ((1.0, 0.414), (1.0, -0.414), (0.414, 1.0), (0.414, -1.0)):
                for rise in (level - 1, -level - 1):
                    bars.add(end, reach * half, side * half, rise * radius)
    return bars.take()


def _side(bars: _Bars, width: np.ndarray, height: np.ndarray) -> np.ndarray:
    """(N, 4, 2): the lit band on the side that the camera sees."""
    for end, rise in ((0, -0.1), (1, -0.1), (1, -0.78), (0, -0.78)):
        bars.add(end, 0 * width, width / 2, rise * height)
    return bars.take()


def _top(bars: _Bars, width: np.ndarray) -> np.ndarray:
    """(N, 4, 2): the lit back of the bead."""
    for end, side in ((0, 0.36), (1, 0.36), (1, -0.36), (0, -0.36)):
        bars.add(end, 0.25 * width, side * width, 0 * width)
    return bars.take()
