"""What else the camera sees: the bed, the room behind it, the head and its gantry, and now and then a hand."""

from __future__ import annotations

import cv2
import numpy as np

from ..core.camera import Camera

SURFACES = ("sheet", "steel", "glass")
_TEXEL_MM = 0.2
_MARGIN_MM = 4.0


class Room:
    """The room around one printer. The same for the same seed.

    bed_mm  : (width, depth) of the bed, whose lower left corner is the print's origin
    surface : one of SURFACES
    built   : the camera before it was turned, which saw the wall as it is
    """

    def __init__(
        self, camera: Camera, bed_mm: tuple[float, float], surface: str, seed: int, built: Camera | None = None
    ) -> None:
        self._camera, self._bed_mm = camera, bed_mm
        self._rng_seed = seed
        self._texture = _bed_texture(bed_mm, surface, np.random.default_rng([seed, 1]))
        self._wall = _seen_turned(_wall(built or camera, np.random.default_rng([seed, 2])), built or camera, camera)
        width, height = camera.image_size_px
        pixels = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).reshape(-1, 1, 2)
        rays = _rays(camera, pixels.astype(np.float64))
        rotation = cv2.Rodrigues(camera.rvec)[0]
        self._rays_room = (rays @ rotation).reshape(height, width, 3)

    def backdrop(self, shift_mm: np.ndarray) -> np.ndarray:
        """(H, W, 3) float32 BGR 0..255: the empty printer, its bed moved by `shift_mm`, without its head."""
        centre = self._camera.centre_mm
        down = self._rays_room[..., 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            along = np.where(down < -1e-6, (shift_mm[2] - centre[2]) / down, np.nan)
        x = centre[0] + along * self._rays_room[..., 0] - shift_mm[0]
        y = centre[1] + along * self._rays_room[..., 1] - shift_mm[1]
        on_bed = np.isfinite(along) & (x > -_MARGIN_MM) & (x < self._bed_mm[0] + _MARGIN_MM)
        on_bed &= (y > -_MARGIN_MM) & (y < self._bed_mm[1] + _MARGIN_MM)
        map_x = ((np.nan_to_num(x) + _MARGIN_MM) / _TEXEL_MM).astype(np.float32)
        map_y = ((np.nan_to_num(y) + _MARGIN_MM) / _TEXEL_MM).astype(np.float32)
        bed = cv2.remap(self._texture, map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        soft = cv2.GaussianBlur(on_bed.astype(np.float32), (0, 0), 0.6)[..., None]
        return bed * soft + self._wall * (1 - soft)

    def paint_machine(self, picture: np.ndarray, nozzle_mm: np.ndarray) -> np.ndarray:
        """Draws gantry and head into `picture` ((H, W, 3) float32), the nozzle's tip at `nozzle_mm` in the room.

        Returns (H, W) uint8, 255 where they hide what is behind.
        """
        x, y, z = nozzle_mm
        hidden = np.zeros(picture.shape[:2], np.uint8)
        boxes = [
            ((-60, 330), (y + 28, y + 48), (z + 38, z + 58), (52, 50, 50)),
            ((x - 22, x + 22), (y + 4, y + 30), (z + 14, z + 72), (44, 44, 46)),
            ((x - 19, x + 19), (y - 22, y + 4), (z + 12, z + 52), (34, 33, 35)),
            ((x - 9, x + 9), (y - 9, y + 9), (z + 5, z + 12), (70, 74, 78)),
        ]
        for xs, ys, zs, colour in boxes:
            self._paint_box(picture, hidden, xs, ys, zs, colour)
        self._paint_box(picture, hidden, (x - 2.5, x + 2.5), (y - 2.5, y + 2.5), (z + 1.5, z + 5), (88, 150, 170))
        self._paint_box(picture, hidden, (x - 0.8, x + 0.8), (y - 0.8, y + 0.8), (z, z + 1.5), (88, 150, 170))
        self._paint_fan(picture, hidden, np.array([x, y - 22.1, z + 32.0]), 15.0)
        return hidden

    def _paint_box(self, picture, hidden, xs, ys, zs, colour) -> None:  # type: ignore[no-untyped-def]
        """A box as its faces that look at the camera, each in one shade."""
        centre = self._camera.centre_mm
        faces = (
            (0, xs, 0.75, lambda u, a, b: (u, a, b), ys, zs),
            (1, ys, 1.0, lambda u, a, b: (a, u, b), xs, zs),
            (2, zs, 1.3, lambda u, a, b: (a, b, u), xs, ys),
        )
        for axis, (low, high), shade, place, firsts, seconds in faces:
            if low <= centre[axis] <= high:
                continue
            at = high if centre[axis] > high else low
            a, b = _edge(firsts, seconds)
            corners = np.array([place(at, p, q) for p, q in zip(a, b)], dtype=np.float64)
            self._paint_polygon(picture, hidden, corners, tuple(shade * c for c in colour))

    def _paint_fan(self, picture: np.ndarray, hidden: np.ndarray, hub_mm: np.ndarray, radius_mm: float) -> None:
        if self._camera.centre_mm[1] > hub_mm[1]:
            return
        turn = np.linspace(0, 2 * np.pi, 40, endpoint=False)
        ring = np.column_stack([np.cos(turn), np.zeros_like(turn), np.sin(turn)])
        self._paint_polygon(picture, hidden, hub_mm + radius_mm * ring, (22, 22, 23))
        for blade in range(7):
            lean = turn[0] + 2 * np.pi * blade / 7 + np.array([0.0, 0.25, 0.7, 0.45])
            reach = np.array([4.0, 14.0, 14.0, 4.0]) * radius_mm / 15
            points = np.column_stack([reach * np.cos(lean), np.full(4, -0.1), reach * np.sin(lean)])
            self._paint_polygon(picture, hidden, hub_mm + points, (40, 39, 41))
        self._paint_polygon(picture, hidden, hub_mm + 5.0 * radius_mm / 15 * ring, (60, 60, 62))

    def _paint_polygon(self, picture, hidden, corners_mm, colour) -> None:  # type: ignore[no-untyped-def]
        pixels = self._camera.project(corners_mm)
        if not np.isfinite(pixels).all() or np.abs(pixels).max() > 2e4:
            return
        points = np.round(pixels * 16).astype(np.int32)
        cv2.fillPoly(picture, [points], colour, cv2.LINE_AA, 4)
        cv2.fillPoly(hidden, [points], 255, cv2.LINE_8, 4)

    def paint_hand(self, picture: np.ndarray, number: int) -> np.ndarray:
        """Draws a hand that reaches into the picture. Returns (H, W) uint8, 255 where it hides what is behind."""
        height, width = picture.shape[:2]
        rng = np.random.default_rng([self._rng_seed, 3, number])
        scale = width / 640
        wrist = np.array([width * rng.uniform(0.75, 1.0), height * 1.05])
        palm = np.array([width * rng.uniform(0.45, 0.6), height * rng.uniform(0.55, 0.65)])
        reach = (palm - wrist) / np.linalg.norm(palm - wrist)
        across = np.array([-reach[1], reach[0]])
        shape = np.zeros((height, width), np.uint8)

        def limb(a: np.ndarray, b: np.ndarray, thick: float) -> None:
            cv2.line(shape, tuple(np.int32(a)), tuple(np.int32(b)), 255, int(thick * scale), cv2.LINE_AA)

        limb(wrist, palm, 95)
        for finger, spread in enumerate((-42, -15, 12, 38)):
            root = palm + across * spread * scale
            limb(root, root + (reach * (75 - 8 * abs(finger - 1.5)) + across * spread * 0.35) * scale, 25)
        limb(palm - across * 40 * scale, palm + (reach * 25 - across * 85) * scale, 27)
        soft = cv2.GaussianBlur(shape, (0, 0), 1.5 * scale).astype(np.float32)[..., None] / 255
        depth = cv2.distanceTransform(shape, cv2.DIST_L2, 5)[..., None]
        skin = np.array([118.0, 148.0, 205.0]) * (0.62 + 0.38 * np.tanh(depth / (22 * scale)))
        picture += soft * (skin - picture)
        return np.where(shape > 127, np.uint8(255), np.uint8(0))


def _edge(firsts: tuple[float, float], seconds: tuple[float, float]) -> tuple[list[float], list[float]]:
    """A rectangle's outline, each side cut in ten: the lens bends it."""
    (a0, a1), (b0, b1) = firsts, seconds
    share = np.linspace(0, 1, 10, endpoint=False)
    a = np.concatenate([a0 + (a1 - a0) * share, np.full(10, a1), a1 - (a1 - a0) * share, np.full(10, a0)])
    b = np.concatenate([np.full(10, b0), b0 + (b1 - b0) * share, np.full(10, b1), b1 - (b1 - b0) * share])
    return a.tolist(), b.tolist()


def _seen_turned(wall: np.ndarray, before: Camera, after: Camera) -> np.ndarray:
    """What is far away, as a camera sees it after it was turned."""
    turn = cv2.Rodrigues(after.rvec)[0] @ cv2.Rodrigues(before.rvec)[0].T
    if np.allclose(turn, np.eye(3), atol=1e-9):
        return wall
    matrix = after.K @ turn @ np.linalg.inv(before.K)
    return cv2.warpPerspective(wall, matrix, wall.shape[1::-1], borderMode=cv2.BORDER_REPLICATE)


def _rays(camera: Camera, pixels: np.ndarray) -> np.ndarray:
    """(N, 3) directions in the camera's own frame, z = 1."""
    if camera.model == "fisheye":
        flat = cv2.fisheye.undistortPoints(pixels, camera.K, camera.distortion)
    else:
        flat = cv2.undistortPoints(pixels, camera.K, camera.distortion)
    return np.column_stack([flat.reshape(-1, 2), np.ones(len(pixels))])


def _noise(shape: tuple[int, int], grain_px: float, rng: np.random.Generator) -> np.ndarray:
    """float32 of that shape, mean 0, standard deviation 1, smooth over `grain_px`."""
    small = (max(int(shape[0] / grain_px), 2), max(int(shape[1] / grain_px), 2))
    field = cv2.resize(rng.standard_normal(small).astype(np.float32), shape[::-1], interpolation=cv2.INTER_CUBIC)
    return (field - field.mean()) / max(float(field.std()), 1e-6)


def _bed_texture(bed_mm: tuple[float, float], surface: str, rng: np.random.Generator) -> np.ndarray:
    """(h, w, 3) float32 BGR, _TEXEL_MM a pixel, with _MARGIN_MM of the bed's edge around."""
    shape = (int((bed_mm[1] + 2 * _MARGIN_MM) / _TEXEL_MM), int((bed_mm[0] + 2 * _MARGIN_MM) / _TEXEL_MM))
    texture = np.empty((*shape, 3), np.float32)
    stains = _noise(shape, 160, rng)
    if surface == "steel":
        texture[:] = (86, 92, 95)
        texture += (7 * cv2.blur(_noise(shape, 1.5, rng), (81, 1)) * 3 + 3 * stains)[..., None]
    elif surface == "glass":
        texture[:] = (104, 100, 92)
        texture += (2 * _noise(shape, 3, rng) + 5 * stains)[..., None]
    else:
        texture[:] = (58, 55, 54)
        grain = _noise(shape, 1.3, rng)
        texture += (5 * grain + 14 * np.clip(grain - 1.8, 0, None) + 3 * stains)[..., None]
    _scribble(texture, bed_mm, surface, rng)
    return np.clip(texture, 0, 255)


def _scribble(texture: np.ndarray, bed_mm: tuple[float, float], surface: str, rng: np.random.Generator) -> None:
    """Grid, scale, and the scratches and glue marks of use."""

    def at(x_mm: float, y_mm: float) -> tuple[int, int]:
        return int((x_mm + _MARGIN_MM) / _TEXEL_MM), int((y_mm + _MARGIN_MM) / _TEXEL_MM)

    if surface == "sheet":
        for x in range(0, int(bed_mm[0]) + 1, 10):
            strong = x % 50 == 0
            cv2.line(texture, at(x, 0), at(x, bed_mm[1]), (96, 95, 94) if strong else (74, 72, 71), 3 if strong else 1)
        for y in range(0, int(bed_mm[1]) + 1, 10):
            strong = y % 50 == 0
            cv2.line(texture, at(0, y), at(bed_mm[0], y), (96, 95, 94) if strong else (74, 72, 71), 3 if strong else 1)
    for _ in range(90):
        left, low = rng.uniform(0, bed_mm[0]), rng.uniform(0, bed_mm[1])
        turn, length = rng.uniform(0, np.pi), rng.uniform(2, 18)
        far = at(left + length * np.cos(turn), low + length * np.sin(turn))
        cv2.line(texture, at(left, low), far, (float(rng.uniform(70, 110)),) * 3, 1, cv2.LINE_AA)
    for _ in range(6):  # where earlier prints stood
        left, low, side = rng.uniform(20, bed_mm[0] - 40), rng.uniform(20, bed_mm[1] - 40), rng.uniform(10, 35)
        (x0, y0), (x1, y1) = at(left, low), at(left + side, low + side)
        patch = texture[y0:y1, x0:x1]
        patch += float(rng.uniform(-5, 7))


def _wall(camera: Camera, rng: np.random.Generator) -> np.ndarray:
    """(H, W, 3) float32 BGR: a wooden desk and what stands on it, out of focus."""
    width, height = camera.image_size_px
    shape = (height, width)
    grain = cv2.GaussianBlur(_noise(shape, 3, rng), (0, 0), sigmaX=width / 20, sigmaY=1.0)
    wood = np.array([74.0, 104.0, 138.0]) * (1 + 0.09 * grain / grain.std())[..., None].clip(0.7, 1.3)
    picture = wood.astype(np.float32)
    cv2.rectangle(picture, (0, 0), (width, int(height * rng.uniform(0.02, 0.09))), (150, 158, 160), -1)
    for _ in range(5):
        x, w, h = rng.integers(0, width), rng.integers(30, 140), rng.integers(20, 90)
        tone = np.array([rng.uniform(25, 120)] * 3) * rng.uniform(0.85, 1.15, 3)
        cv2.rectangle(picture, (int(x), 0), (int(x + w), int(h)), tuple(tone.tolist()), -1)
    return cv2.GaussianBlur(picture, (0, 0), 2.5)
