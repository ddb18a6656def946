"""Photorealistic pictures of a print, path traced with Mitsuba 3: printer, bed, lamps, head, hand and lens.

`pip install mitsuba` gives the renderer; its LLVM variant needs a libLLVM (set DRJIT_LIBLLVM_PATH where it isn't found).
Only this benchmark needs it. Room coordinates are print coordinates with the bed at its reference.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import cv2
import drjit as dr
import mitsuba as mi
import numpy as np

from benchmarks.traced_print import Matter
from benchmarks.traced_surfaces import FILAMENTS, Look, bed_surface, coated, filament_surface, linear, matt

T = mi.ScalarTransform4f


def smoothed(rgb: np.ndarray, level: float) -> np.ndarray:
    """Less of the tracer's own grain, edges kept: filtered where the eye is even, on a curve."""
    curve = np.sqrt(rgb / level).astype(np.float32)
    ring = np.ones((3, 3), np.uint8)
    ring[1, 1] = 0
    around = cv2.dilate(curve, ring)
    curve = np.where(
        curve > 1.15 * around + 0.02, around, curve
    )  # a lone bright pixel is the tracer's, not the scene's
    return level * cv2.bilateralFilter(curve, 5, 0.07, 1.3) ** 2


def undistorted(pixels: np.ndarray, K: np.ndarray, distortion: np.ndarray) -> np.ndarray:
    """(N, 2) x/z, y/z of the rays through these pixels, OpenCV's five-number lens inverted by fixed point."""
    k1, k2, p1, p2, k3 = distortion
    seen = (pixels - K[:2, 2]) / [K[0, 0], K[1, 1]]
    x, y = seen.T.copy()
    for _ in range(60):
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        x, y = (
            (seen[:, 0] - 2 * p1 * x * y - p2 * (r2 + 2 * x * x)) / radial,
            (seen[:, 1] - p1 * (r2 + 2 * y * y) - 2 * p2 * x * y) / radial,
        )
    return np.column_stack([x, y])


def box(low: tuple, high: tuple, bsdf: object) -> object:
    low, high = np.array(low, float), np.array(high, float)
    place = T().translate(((low + high) / 2).tolist()).scale(((high - low) / 2).tolist())
    return mi.load_dict({"type": "cube", "to_world": place, "bsdf": bsdf})


def rod(a: tuple, b: tuple, radius: float, bsdf: object) -> object:
    return mi.load_dict(
        {
            "type": "cylinder",
            "p0": list(map(float, a)),
            "p1": list(map(float, b)),
            "radius": float(radius),
            "bsdf": bsdf,
        }
    )


@dataclass(frozen=True, eq=False)
class Eye:
    """The true camera: K (3, 3), distortion, camera_from_room rotation (3, 3) and tvec (3,), size (width, height)."""

    size: tuple[int, int]
    K: np.ndarray
    distortion: np.ndarray
    rotation: np.ndarray
    tvec_mm: np.ndarray

    def turned(self, rvec: np.ndarray) -> Eye:
        """The camera turned about its own centre."""
        turn = cv2.Rodrigues(np.asarray(rvec, float))[0]
        return replace(self, rotation=turn @ self.rotation, tvec_mm=turn @ self.tvec_mm)

    @property
    def centre_mm(self) -> np.ndarray:
        return -self.rotation.T @ self.tvec_mm


@dataclass(eq=False)
class Studio:
    """The printer in its room. One kernel serves all pictures as long as the same things stand about."""

    look: Look
    eye: Eye
    samples: int = 6
    _fixed: dict = field(init=False, repr=False)

    def __post_init__(self) -> None:
        rng = self.rng = np.random.default_rng([self.look.seed, 31])
        look = self.look
        self._filament = mi.load_dict(filament_surface(look.filament))
        self._bed = mi.load_dict(bed_surface(look, rng))
        self._dark, self._steel = (
            mi.load_dict(matt((34, 34, 36))),
            mi.load_dict({"type": "roughconductor", "material": "Al", "alpha": 0.2}),
        )
        self._brass = mi.load_dict({"type": "roughconductor", "material": "Cu", "alpha": 0.25})
        shades = [(30, 30, 32), (214, 96, 26), (190, 190, 192), (40, 70, 130), (58, 60, 62), (150, 24, 24)]
        self._shroud = mi.load_dict(matt(shades[rng.integers(len(shades))]))
        self._sock = mi.load_dict(matt([(40, 42, 46), (60, 110, 170), (170, 170, 172)][rng.integers(3)]))
        self._skin = mi.load_dict(matt([(222, 176, 148), (150, 104, 78), (92, 62, 46)][rng.integers(3)]))
        self._head = rng.random(8)
        self._fixed = self._room(rng)
        self._lamps(rng)
        width, height = self.eye.size
        u, v = np.meshgrid(np.arange(width + 1) - 0.5, np.arange(height + 1) - 0.5)
        at = undistorted(np.stack([u, v], axis=-1).reshape(-1, 2), self.eye.K, self.eye.distortion)
        self._x, self._y = mi.Float(at[:, 0].astype(np.float32)), mi.Float(at[:, 1].astype(np.float32))

    def _room(self, rng: np.random.Generator) -> dict:
        """What never moves."""
        look = self.look
        (w, d, h), (x0, y0) = look.volume_mm, look.low_mm
        floor = -65.0 if look.motion != "z" else -h - 60
        wood = np.ones((512, 512, 3), np.float32) * linear(
            [(150, 108, 70), (205, 205, 202), (70, 52, 40), (96, 98, 100)][rng.integers(4)]
        )
        streak = cv2.GaussianBlur(rng.normal(0, 1, (512, 512)).astype(np.float32), (0, 0), sigmaX=40, sigmaY=1.2)
        desk = mi.load_dict(coated(wood * (1 + 0.15 * (streak / streak.std())[..., None]), 0.3))
        wall = mi.load_dict(matt([(180, 178, 170), (120, 128, 136), (206, 202, 190), (90, 86, 82)][rng.integers(4)]))
        middle = (x0 + w / 2, y0 + d / 2)
        things = {
            "desk": mi.load_dict({"type": "rectangle", "to_world": T().translate([*map(float, middle), floor]).scale([1400, 1400, 1]), "bsdf": desk}),
            "wall": box((x0 - 1500, y0 + d + 330, floor), (x0 + w + 1500, y0 + d + 340, 1600), wall),
        }  # fmt: skip
        frame = self._dark if rng.random() < 0.6 else self._steel
        if look.motion == "y":
            yref = look.reference_mm[1]
            things["left"] = box((x0 - 75, yref + 22, floor), (x0 - 40, yref + 62, h + 90), frame)
            things["right"] = box((x0 + w + 40, yref + 22, floor), (x0 + w + 75, yref + 62, h + 90), frame)
            for n, x in enumerate((x0 + 0.3 * w, x0 + 0.7 * w)):
                things[f"rail{n}"] = rod((x, y0 - 90, -38), (x, y0 + d + 150, -38), 5, self._steel)
        elif look.delta:
            for n, a in enumerate(np.radians((90, 210, 330))):
                x, y = middle[0] + 0.72 * w * np.cos(a), middle[1] + 0.72 * w * np.sin(a)
                things[f"post{n}"] = box((x - 12, y - 12, floor), (x + 12, y + 12, h + 300), frame)
        else:
            for n, x in enumerate((x0 - 55, x0 + w + 30)):
                things[f"post{n}"] = box((x, y0 + d + 40, floor), (x + 25, y0 + d + 65, h + 60), frame)
                things[f"low{n}"] = box((x, y0 - 60, -95), (x + 25, y0 + d + 40, -70), frame)
            if look.motion == "z":
                panel = mi.load_dict(matt([(28, 28, 30), (196, 198, 200), (88, 92, 96)][rng.integers(3)]))
                things["back"] = box((x0 - 60, y0 + d + 70, floor), (x0 + w + 60, y0 + d + 75, 260), panel)
                things["side"] = box((x0 - 66, y0 - 80, floor), (x0 - 60, y0 + d + 75, 260), panel)
                for n in range(2):
                    things[f"screw{n}"] = rod(
                        (x0 + w * (0.2 + 0.6 * n), y0 + d + 30, floor),
                        (x0 + w * (0.2 + 0.6 * n), y0 + d + 30, 60),
                        5,
                        self._steel,
                    )
        for n in range(3):  # clutter on the desk
            at = np.array([middle[0] + rng.normal(0, 260), y0 + d + 120 + rng.random() * 150])
            size = 20 + 50 * rng.random(3)
            things[f"thing{n}"] = box(
                (*at, floor),
                (*(at + size[:2]), floor + size[2] * 1.6),
                mi.load_dict(matt(tuple(0.6 * rng.integers(20, 230) + 0.4 * rng.integers(20, 230, 3)))),
            )
        return things

    def _lamps(self, rng: np.random.Generator) -> None:
        look = self.look
        (w, d, h), (x0, y0) = look.volume_mm, look.low_mm
        middle = np.array([x0 + w / 2, y0 + d / 2, 0.0])
        self._tint = np.array([1.0, 1.0, 1.0])
        ambient, self._key = 0.25, []

        def panel(at: np.ndarray, to: np.ndarray, half: tuple, power: float, tint: tuple) -> None:
            up = [0, 0, 1] if abs((to - at)[:2]).max() > 1 else [0, 1, 0]
            place = T().look_at(list(map(float, at)), list(map(float, to)), up).scale([*map(float, half), 1.0])
            # as bright at the middle of the bed whatever the size and distance
            strength = power * ((to - at) ** 2).sum() / (4 * half[0] * half[1])
            self._key.append((place, strength, np.array(tint)))

        side = 1 if rng.random() < 0.5 else -1
        around = rng.random(3)
        if look.light == "ring":
            panel(self.eye.centre_mm + [0, 0, 25], middle, (40, 40), 1.0, (1, 1, 1.02))
            ambient = 0.10
        elif look.light == "hard lamp":
            panel(
                middle + [side * (250 + 200 * around[0]), -150 + 400 * around[1], 320 + 250 * around[2]],
                middle,
                (12, 12),
                1.0,
                (1.0, 0.86, 0.66),
            )
            ambient = 0.08
        elif look.light == "led strip":
            panel(
                middle + [0, 40 if look.motion != "y" else look.reference_mm[1] - middle[1] - 10, h + 70],
                middle,
                (w * 0.45, 4),
                1.0,
                (0.92, 0.98, 1.1),
            )
            ambient = 0.07
        elif look.light == "window":
            panel(middle + [side * 1100, 250 - 600 * around[0], 500], middle, (350, 450), 1.0, (0.86, 0.95, 1.12))
            ambient = 0.2
        elif look.light == "dim":
            panel(middle + [side * 900, -700, 1100], middle, (90, 90), 0.6, (1.0, 0.78, 0.52))
            ambient = 0.15
        elif look.light == "ceiling":
            panel(middle + [150 * side, -200, 1700], middle + [10, 0, 0], (500, 500), 1.0, (1, 0.97, 0.9))
            ambient = 0.25
        else:
            panel(middle + [0, -d / 2 - 60, 150], middle, (w * 0.4, 5), 0.7, (1, 1, 1))
            panel(middle + [side * (w / 2 + 40), 0, 140], middle, (5, d * 0.4), 0.4, (1, 1, 1.05))
            ambient = 0.05
        self._ambient = ambient / np.pi

    def _lit(self, key: float, ambient: float) -> dict:
        things = {
            "sky": mi.load_dict(
                {"type": "constant", "radiance": {"type": "rgb", "value": [float(self._ambient * ambient)] * 3}}
            )
        }
        for n, (place, strength, tint) in enumerate(self._key):
            glow = {"type": "area", "radiance": {"type": "rgb", "value": [float(v) for v in strength * key * tint]}}
            things[f"lamp{n}"] = mi.load_dict({"type": "rectangle", "to_world": place, "emitter": glow})
        return things

    def _bed_parts(self, shift: np.ndarray) -> dict:
        look = self.look
        (w, d, _), (x0, y0) = look.volume_mm, look.low_mm
        x, y, z = x0 + w / 2 + shift[0], y0 + d / 2 + shift[1], shift[2]
        if look.delta:
            disc = T().translate([float(x), float(y), float(z)]).scale([w / 2, w / 2, 1])
            return {
                "bed": mi.load_dict({"type": "disk", "to_world": disc, "bsdf": self._bed}),
                "slab": rod((x, y, z - 4), (x, y, z - 0.05), w / 2, self._dark),
            }
        top = T().translate([float(x), float(y), float(z)]).scale([w / 2 + 4, d / 2 + 4, 1])
        parts = {
            "bed": mi.load_dict({"type": "rectangle", "to_world": top, "bsdf": self._bed}),
            "slab": box((x - w / 2 - 4, y - d / 2 - 4, z - 5), (x + w / 2 + 4, y + d / 2 + 4, z - 0.05), self._dark),
        }
        for n, (a, b) in enumerate(((-1, -1), (1, -1), (-1, 1), (1, 1))):  # clips
            cx, cy = x + a * (w / 2 - 18), y + b * (d / 2 + 1)
            parts[f"clip{n}"] = box(
                (cx - 9, cy - 5, z - 6), (cx + 9, cy + 5, z + 2.2), self._steel if look.bed == "glass" else self._dark
            )
        return parts

    def _head_parts(self, nozzle: np.ndarray) -> dict:
        look, r = self.look, self._head
        x, y, z = nozzle
        (w, d, _), (x0, _) = look.volume_mm, look.low_mm
        wide, deep, tall = 15 + 7 * r[0], 13 + 7 * r[1], 36 + 18 * r[2]
        parts = {
            "tip": rod((x, y, z + 0.2), (x, y, z + 3), 1.1, self._brass),
            "nut": rod((x, y, z + 2), (x, y, z + 6), 3.4, self._brass),
            "block": box((x - 9, y - 8, z + 5.5), (x + 11, y + 9, z + 17), self._sock),
            "shroud": box((x - wide, y - deep, z + 21), (x + wide, y + deep, z + 21 + tall), self._shroud),
            "duct": box(
                (x - wide * 0.5, y - deep - 7, z + 8 + 6 * r[3]),
                (x + wide * 0.5, y - deep, z + 34),
                self._shroud if r[4] < 0.6 else self._dark,
            ),
            "fan": rod(
                (x, y - deep - 0.6, z + 21 + tall * 0.6), (x, y - deep - 2.5, z + 21 + tall * 0.6), 14, self._dark
            ),
        }
        if look.delta:
            for n, a in enumerate(np.radians((90, 210, 330))):
                foot = (x + 24 * np.cos(a), y + 24 * np.sin(a), z + 24)
                parts[f"arm{n}"] = rod(
                    foot,
                    (x0 + w / 2 + 0.66 * w * np.cos(a), look.low_mm[1] + d / 2 + 0.66 * w * np.sin(a), z + 235),
                    4,
                    self._dark,
                )
        elif r[5] < 0.5:
            for n, dz in enumerate((30, 72)):
                parts[f"rod{n}"] = rod(
                    (x0 - 60, y + deep + 8, z + dz), (x0 + w + 60, y + deep + 8, z + dz), 4.2, self._steel
                )
        else:
            parts["beam"] = box((x0 - 60, y + deep + 2, z + 32), (x0 + w + 60, y + deep + 22, z + 56), self._dark)
        return parts

    def _hand_parts(self, at: np.ndarray, rng: np.random.Generator) -> dict:
        """A hand that reaches in from the camera's side."""
        toward = self.eye.centre_mm - at
        far = float(np.linalg.norm(toward))
        toward = toward / far
        aside = np.cross(toward, [0, 0, 1])
        palm = at + toward * min(35.0, 0.15 * far) + [0, 0, 28] + aside * rng.normal(0, 10)
        arm = palm + aside * rng.choice([-230, 230]) + [0, 0, 50]
        parts = {"arm": rod(palm, arm, 27, self._skin)}
        place = T().translate([float(v) for v in palm]).scale([38, 38, 17])
        parts["palm"] = mi.load_dict({"type": "sphere", "to_world": place, "bsdf": self._skin})
        for n in range(4):
            start = palm + aside * (n - 1.5) * 15 - toward * 18
            parts[f"finger{n}"] = rod(start, start - toward * (30 + 9 * rng.random()) - [0, 0, 14], 7.5, self._skin)
        return parts

    def mesh(self, matter: Matter, shift: np.ndarray) -> object:
        props = mi.Properties()
        props["mesh_bsdf"] = self._filament
        used = matter.triangles
        mesh = mi.Mesh("matter", len(matter.vertices_mm), max(len(used), 1), props=props)
        values = mi.traverse(mesh)
        values["vertex_positions"] = mi.Float((matter.vertices_mm + shift).astype(np.float32).reshape(-1))
        values["faces"] = mi.UInt32(used.astype(np.uint32).reshape(-1) if len(used) else np.zeros(3, np.uint32))
        values.update()
        return mesh

    def _rays(self, eye: Eye, u: object, v: object, pixel: object) -> object:
        """Rays through (u, v) in [0, 1] within each numbered pixel."""
        width = self.eye.size[0]
        row, column = pixel // width, pixel % width
        first = row * (width + 1) + column

        def between(grid: object) -> object:
            a, b = dr.gather(mi.Float, grid, first), dr.gather(mi.Float, grid, first + 1)
            c, d = dr.gather(mi.Float, grid, first + width + 1), dr.gather(mi.Float, grid, first + width + 2)
            return (a * (1 - u) + b * u) * (1 - v) + (c * (1 - u) + d * u) * v

        x, y = between(self._x), between(self._y)
        m = [[mi.Float(float(c)) for c in line] for line in eye.rotation.T]
        way = mi.Vector3f(*(line[0] * x + line[1] * y + line[2] for line in m))
        return mi.RayDifferential3f(mi.Point3f(*(mi.Float(float(c)) for c in eye.centre_mm)), dr.normalize(way))

    def picture(self, matter: Matter | None, position_mm: tuple, nozzle_mm: np.ndarray, seed: int, *, eye: Eye | None = None,
                key: float = 1.0, ambient: float = 1.0, hand_mm: np.ndarray | None = None,
        window: tuple[slice, slice] | None = None) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
        """(H, W, 3) float32 linear RGB, and (H, W) bool: where matter is seen, nothing standing before it.
        With a window only that part is traced, and the rest is the picture before."""
        eye = eye or self.eye
        shift = self.look.shift_mm(position_mm)
        things = {
            "type": "scene",
            **self._fixed,
            **self._lit(key, ambient),
            **self._bed_parts(shift),
            **self._head_parts(nozzle_mm),
        }
        if hand_mm is not None:
            things.update(self._hand_parts(hand_mm + shift, np.random.default_rng([self.look.seed, seed])))
        mesh = None
        if matter is not None and len(matter.triangles):
            mesh = things["matter"] = self.mesh(matter, shift)
        scene = mi.load_dict(things)
        width, height = eye.size
        clear = FILAMENTS[self.look.filament][1] == "clear"
        tracer = mi.load_dict({"type": "path", "max_depth": 8 if clear else 3, "rr_depth": 8})
        samples = self.samples if window is None else 3 * self.samples // 2
        sampler = mi.load_dict({"type": "multijitter", "sample_count": samples})
        numbers = np.arange(width * height, dtype=np.uint32).reshape(height, width)
        if window is not None:
            numbers = numbers[window]
        sampler.seed(seed, numbers.size * samples)
        ordinal = dr.arange(mi.UInt32, numbers.size * samples) // samples
        pixel = dr.gather(mi.UInt32, mi.UInt32(numbers.ravel()), ordinal)
        jitter = sampler.next_2d()
        spectrum, _, _ = tracer.sample(scene, sampler, self._rays(eye, jitter.x, jitter.y, pixel))
        linear_rgb = np.array(spectrum).reshape(3, *numbers.shape, samples)
        if window is None:
            self._level = np.percentile(linear_rgb[1, ::4, ::4], 98) * 1.7
        linear_rgb = smoothed(np.minimum(linear_rgb, self._level).mean(axis=3).transpose(1, 2, 0), self._level)
        if window is not None:
            whole = self._latest.copy()
            whole[window] = linear_rgb
            linear_rgb = whole
        self._latest = linear_rgb
        seen = np.zeros((height, width), bool)
        if mesh is not None:
            hit = scene.ray_intersect_preliminary(self._centres(eye))
            seen = np.array(hit.shape == mi.ShapePtr(mesh)).reshape(height, width)
        return linear_rgb.astype(np.float32), seen

    def window(self, matter: Matter, position_mm: tuple, eye: Eye, margin_px: int = 36) -> tuple[slice, slice]:
        """The part of the picture in which this matter and most of its shadow lie."""
        used = matter.vertices_mm[np.unique(matter.triangles)[::7]] + self.look.shift_mm(position_mm)
        at = (used @ eye.rotation.T + eye.tvec_mm).astype(np.float64)
        pixels = cv2.projectPoints(at[at[:, 2] > 1], np.zeros(3), np.zeros(3), eye.K, eye.distortion)[0][:, 0]
        (x0, y0), (x1, y1) = np.percentile(pixels, [0.3, 99.7], axis=0).astype(int)
        x, y = (
            np.clip([a - margin_px, b + margin_px], 0, n) for a, b, n in ((x0, x1, eye.size[0]), (y0, y1, eye.size[1]))
        )
        return slice(int(y[0]), int(y[1])), slice(int(x[0]), int(x[1]))

    def _centres(self, eye: Eye) -> object:
        pixel = dr.arange(mi.UInt32, eye.size[0] * eye.size[1])
        return self._rays(eye, mi.Float(0.5), mi.Float(0.5), pixel)

    def mask(self, matter: Matter, position_mm: tuple, eye: Eye | None = None) -> np.ndarray:
        """(H, W) bool: the ray through the pixel's centre meets matter, nothing else being there."""
        eye = eye or self.eye
        if not len(matter.triangles):
            return np.zeros(eye.size[::-1], bool)
        scene = mi.load_dict({"type": "scene", "matter": self.mesh(matter, self.look.shift_mm(position_mm))})
        return np.array(scene.ray_test(self._centres(eye))).reshape(eye.size[::-1])
