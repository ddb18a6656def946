"""Pictures of marker plates and checkerboards, drawn with OpenCV's projection alone, by random cameras."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from octoprint_moop.core.calibration.calibrate import Lens
from octoprint_moop.core.calibration.markers import MarkerPlate
from octoprint_moop.core.calibration.plate import PlateSettings, bed_middle_mm, place_markers
from octoprint_moop.core.camera import Camera
from octoprint_moop.core.expected.lens import outermost_ray
from octoprint_moop.core.header import Printer
from octoprint_moop.core.segmentation.segment import HsvThresholds

SIZES = ((640, 480), (1280, 720), (1920, 1080))
CONDITIONS = ("plain", "out of hue", "clutter", "print between", "one hidden", "noisy")
_OVER = 3  # samples for a pixel, each way


@dataclass(frozen=True, eq=False)
class Scene:
    """A plate seen by a known camera. colour: what a careful user would have picked."""

    camera: Camera
    plate: MarkerPlate
    printer: Printer
    image: np.ndarray
    colour: HsvThresholds
    hidden: int | None = None


def random_camera(rng: np.random.Generator, plate: MarkerPlate, printer: Printer, size_px: tuple[int, int]) -> Camera:
    """From any side, 18 to 75 degrees up, of any roll in one of three, all markers well within the picture."""
    width, height = size_px
    middle = np.append(bed_middle_mm(printer), 0.0)
    while True:
        azimuth, elevation = rng.uniform(0, 2 * np.pi), np.radians(rng.uniform(18, 75))
        distance_mm = rng.uniform(0.9, 2.2) * max(printer.width_mm, printer.depth_mm)
        eye = middle + distance_mm * np.array(
            [np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)]
        )
        target = middle + np.append(rng.normal(0, 0.06, 2) * printer.width_mm, 0.0)
        forward = (target - eye) / np.linalg.norm(target - eye)
        right = np.cross(forward, [0, 0, 1.0])
        right /= np.linalg.norm(right)
        rotation = np.stack([right, np.cross(forward, right), forward])
        roll = rng.uniform(-np.pi, np.pi) if rng.random() < 1 / 3 else rng.normal(0, 0.08)
        rotation = cv2.Rodrigues(np.array([0, 0, roll]))[0] @ rotation
        focal_px = rng.uniform(0.75, 1.4) * width
        middle_px = np.array(size_px) / 2 + rng.normal(0, 0.01, 2) * width
        K = [[focal_px, 0, middle_px[0]], [0, focal_px * rng.uniform(0.998, 1.002), middle_px[1]], [0, 0, 1]]
        distortion = [rng.uniform(-0.3, 0.08), rng.uniform(0, 0.08), *rng.normal(0, 6e-4, 2), 0]
        camera = Camera(size_px, K, distortion, cv2.Rodrigues(rotation)[0].ravel(), -rotation @ eye)
        seen = camera.project(plate.tops_mm())
        size = focal_px * plate.outer_diameter_mm / np.linalg.norm(plate.tops_mm() - eye, axis=1)
        margin = size[:, None] / 2 + 8
        smallest_px = size.min() * np.sin(elevation)
        if ((seen > margin) & (seen < np.array(size_px) - margin)).all() and smallest_px > 10:
            return camera


def random_scene(rng: np.random.Generator, condition: str = "plain") -> Scene:
    side_mm = float(rng.choice([120, 180, 220, 250, 300]))
    printer = Printer(side_mm, side_mm * float(rng.uniform(0.8, 1.0)), 200)
    settings = PlateSettings(diameter_mm=round(max(12.0, 0.07 * side_mm), 1))
    plate = place_markers(printer, settings)
    size_px = SIZES[rng.integers(len(SIZES))]
    camera = random_camera(rng, plate, printer, size_px)
    hidden = int(rng.integers(4)) if condition == "one hidden" else None
    hue_deg = float(rng.uniform(0, 360))
    image = draw_plate(rng, camera, plate, printer, hue_deg, condition, hidden)
    colour = HsvThresholds((hue_deg - 20) % 360, (hue_deg + 20) % 360, 0.35, 0.2)
    return Scene(camera, plate, printer, image, colour, hidden)


def draw_plate(
    rng: np.random.Generator,
    camera: Camera,
    plate: MarkerPlate,
    printer: Printer,
    hue_deg: float,
    condition: str = "plain",
    hidden: int | None = None,
) -> np.ndarray:
    """(H, W, 3) uint8: painted in linear light, three samples a pixel each way, then blurred, noisy, and JPEG."""
    width, height = camera.image_size_px
    canvas = np.empty((height * _OVER, width * _OVER, 3), np.float32)
    ground = rng.uniform(0.01, 0.12) * rng.uniform(0.8, 1.2, 3)
    canvas[:] = ground
    _bed_lines(canvas, camera, printer, ground * rng.uniform(1.5, 3))
    top = _linear_bgr(hue_deg, rng.uniform(0.75, 0.98), rng.uniform(0.5, 0.95))
    if condition == "clutter":
        for _ in range(12):
            _clutter(rng, canvas, camera, plate, printer, top)
    light = cv2.resize(canvas, (width, height), interpolation=cv2.INTER_AREA)
    for marker in range(len(plate.centres_mm)):
        if marker != hidden:
            _cast_marker(light, camera, plate, marker, ground, top, top * rng.uniform(0.5, 0.9))
    if condition == "print between":
        _box(light, camera, np.append(bed_middle_mm(printer), 0), 0.2 * printer.width_mm, top)
    if condition == "out of hue":
        _spoil(rng, light, camera, plate)
    light = cv2.GaussianBlur(light, (0, 0), rng.uniform(0.4, 0.9) * width / 640)
    noise = 0.03 if condition == "noisy" else rng.uniform(0.005, 0.015)
    shown = np.clip(light, 0, 1) ** (1 / 2.2) + rng.normal(0, noise, light.shape)
    image = (np.clip(shown, 0, 1) * 255).astype(np.uint8)
    quality = 60 if condition == "noisy" else int(rng.integers(75, 96))
    return cv2.imdecode(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1], cv2.IMREAD_COLOR)


def volume_error_px(
    found: Camera,
    true: Camera,
    bed_mm: tuple[float, float] = (250, 210),
    nearest_mm: float = 60.0,
    corner_mm: tuple[float, float] = (0, 0),
) -> np.ndarray:
    """Distances in px over the bed and up to 100 mm above it, of points that the true camera sees.

    nearest_mm : points nearer to the lens than this are left out; there a hair's breadth is many pixels
    """
    axes = [corner + np.linspace(0, side, 11) for corner, side in zip(corner_mm, bed_mm)] + [np.linspace(0, 100, 6)]
    points = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 3)
    in_camera = points @ true.camera_from_room[:3, :3].T + true.tvec_mm
    slope = np.hypot(in_camera[:, 0], in_camera[:, 1]) / np.maximum(in_camera[:, 2], 1e-9)
    # Beyond the outermost ray the lens's polynomial folds back into the picture.
    ahead = (in_camera[:, 2] > 0) & (slope < outermost_ray(true))
    ahead &= np.linalg.norm(in_camera, axis=1) > nearest_mm
    seen = true.project(points[ahead])
    inside = ((seen >= 0) & (seen < true.image_size_px)).all(axis=1)
    return np.linalg.norm(found.project(points[ahead][inside]) - seen[inside], axis=1)


def _linear_bgr(hue_deg: float, saturation: float, value: float) -> np.ndarray:
    pixel = np.array([[[hue_deg, saturation, value]]], np.float32)
    return cv2.cvtColor(pixel, cv2.COLOR_HSV2BGR)[0, 0].astype(np.float64) ** 2.2


def _circle_px(camera: Camera, x: float, y: float, radius_mm: float, z: float) -> np.ndarray:
    turn = np.linspace(0, 2 * np.pi, 360, endpoint=False)
    rim = np.column_stack([x + radius_mm * np.cos(turn), y + radius_mm * np.sin(turn), np.full(360, z)])
    return cv2.projectPoints(rim, camera.rvec, camera.tvec_mm, camera.K, camera.distortion)[0].reshape(-1, 2)


def _cast_marker(
    light: np.ndarray,
    camera: Camera,
    plate: MarkerPlate,
    marker: int,
    ground: np.ndarray,
    top: np.ndarray,
    side: np.ndarray,
) -> None:
    """Rays through 4 x 4 points of each pixel near the marker, against the disc and its hole."""
    x, y = plate.centres_mm[marker]
    around = np.vstack([_circle_px(camera, x, y, 0.5 * plate.outer_diameter_mm, z) for z in (plate.height_mm, 0.0)])
    low, high = np.floor(around.min(axis=0)).astype(int) - 2, np.ceil(around.max(axis=0)).astype(int) + 3
    low, high = np.maximum(low, 0), np.minimum(high, camera.image_size_px)
    steps = [np.arange((b - a) * 4) / 4 + a - 0.375 for a, b in zip(low, high)]
    px = np.stack(np.meshgrid(*steps), axis=-1)
    rays = Lens.of(camera).rays(px.reshape(-1, 2))
    direction = np.column_stack([rays, np.ones(len(rays))]) @ camera.camera_from_room[:3, :3]
    hits = [
        (camera.centre_mm + direction * ((z - camera.centre_mm[2]) / direction[:, 2])[:, None])[:, :2] - [x, y]
        for z in (plate.height_mm, 0.0)
    ]
    run = hits[1] - hits[0]
    nearest = hits[0] + run * np.clip(-(hits[0] * run).sum(axis=1) / (run**2).sum(axis=1), 0, 1)[:, None]
    radius, hole = plate.outer_diameter_mm / 2, (plate.hole_diameter_mm or 0) / 2
    on_top = np.linalg.norm(hits[0], axis=1) < radius
    in_hole = np.linalg.norm(hits[0], axis=1) < hole
    through = in_hole & (np.linalg.norm(hits[1], axis=1) < hole)
    kinds = np.select([through, in_hole, on_top, np.linalg.norm(nearest, axis=1) < radius], [1, 2, 3, 4], 0)
    shape = px.shape[:2]
    part = light[low[1] : high[1], low[0] : high[0]]
    fine = np.repeat(np.repeat(part, 4, axis=0), 4, axis=1).reshape(-1, 3)
    for kind, colour in ((1, ground), (2, 0.6 * top), (3, top), (4, side)):
        fine[kinds == kind] = colour
    part[:] = cv2.resize(fine.reshape(*shape, 3), part.shape[1::-1], interpolation=cv2.INTER_AREA)


def _fill(canvas: np.ndarray, polygon_px: np.ndarray, colour: np.ndarray, over: int = _OVER) -> None:
    # A picture's pixel k spans the finer pixels 3k to 3k+2, so its centre is at 3k+1.
    fine = np.round((np.asarray(polygon_px) * over + (over - 1) / 2) * 16)
    cv2.fillPoly(canvas, [fine.astype(np.int32)], colour.tolist(), shift=4)


def _bed_lines(canvas: np.ndarray, camera: Camera, printer: Printer, colour: np.ndarray) -> None:
    low = bed_middle_mm(printer) - [printer.width_mm / 2, printer.depth_mm / 2]
    for step in np.linspace(0, 1, 8):
        for start, end in (((step, 0), (step, 1)), ((0, step), (1, step))):
            ends = [np.append(low + np.array(p) * [printer.width_mm, printer.depth_mm], 0) for p in (start, end)]
            line = camera.project(np.linspace(*ends, 40))
            fine = np.round((line * _OVER + 1) * 16)
            if np.isfinite(fine).all() and np.abs(fine).max() < 1e6:
                cv2.polylines(canvas, [fine.astype(np.int32)], False, colour.tolist(), 3, shift=4)


def _clutter(
    rng: np.random.Generator,
    canvas: np.ndarray,
    camera: Camera,
    plate: MarkerPlate,
    printer: Printer,
    colour: np.ndarray,
) -> None:
    """A blob, a disc of another size or a strip of the same colour, not on a marker."""
    low = bed_middle_mm(printer) - [printer.width_mm / 2, printer.depth_mm / 2]
    size_mm = float(rng.uniform(0.15, 0.45)) * plate.outer_diameter_mm
    place = low + rng.uniform(0, 1, 2) * [printer.width_mm, printer.depth_mm]
    if np.linalg.norm(plate.centres_mm - place, axis=1).min() < plate.outer_diameter_mm / 2 + 2.2 * size_mm:
        return
    turn = np.sort(rng.uniform(0, 2 * np.pi, 9)) if rng.random() < 0.6 else np.linspace(0, 2 * np.pi, 60)
    stretch = rng.uniform(0.5, 2, 2)
    rim = place + size_mm * stretch * np.column_stack([np.cos(turn), np.sin(turn)])
    outline = camera.project(np.column_stack([rim, np.zeros(len(turn))]))
    if np.isfinite(outline).all():
        _fill(canvas, outline, colour)


def _box(light: np.ndarray, camera: Camera, middle: np.ndarray, side_mm: float, colour: np.ndarray) -> None:
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (0, 0.4)]) * side_mm + middle
    outline = camera.project(corners)
    _fill(light, cv2.convexHull(outline.astype(np.float32)).reshape(-1, 2), colour * 0.8, over=1)


def _spoil(rng: np.random.Generator, light: np.ndarray, camera: Camera, plate: MarkerPlate) -> None:
    """A highlight or a deep shadow over a part of two markers."""
    radius_mm = plate.outer_diameter_mm / 2
    for marker in rng.choice(len(plate.centres_mm), 2, replace=False):
        x, y = plate.centres_mm[marker] + rng.uniform(-0.8, 0.8, 2) * radius_mm
        mask = np.zeros(light.shape[:2], np.uint8)
        outline = _circle_px(camera, x, y, rng.uniform(0.3, 0.6) * radius_mm, plate.height_mm)
        cv2.fillPoly(mask, [np.round(outline).astype(np.int32)], 255)
        if rng.random() < 0.5:
            light[mask > 0] *= 0.15
        else:
            light[mask > 0] = light[mask > 0] * 0.5 + 0.4
