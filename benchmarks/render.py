"""How long drawing takes: birth maps of 10 thousand to 3 million beads, the mask at a position, a pose that changes.

    python benchmarks/render.py [--most 3000000] [--repeat 5] [--plot render.svg] > render.json

Times are medians, on the clock and, since a busy machine stretches that, of the processors (all threads together);
ratios are taken between things measured in this run. The print is made here: a wavy vase full
of infill, beads of 0.5 mm, a ninth of them outward. So are the frames, with the detail of a real JPEG.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Callable

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.tables import ROOT, put, save, table
from octoprint_moop.core.camera import BedMotion, Camera
from octoprint_moop.core.expected.raster import CvRenderer
from octoprint_moop.core.expected.views import ExpectedViews, MaskRenderer
from octoprint_moop.core.toolpath import NO_OBJECT, Role, Toolpath
from octoprint_moop.machine.renderers import open_renderer

SIZES_PX = {"640x480": (640, 480), "1920x1080": (1920, 1080)}
COUNTS = (10_000, 30_000, 100_000, 300_000, 1_000_000, 3_000_000)
BEAD_MM, WIDTH_MM, LAYER_MM = 0.5, 0.45, 0.1


def made_print(count: int) -> Toolpath:
    """A wavy vase full of infill, cut off after `count` beads and taller the more there are.

    Three walls and sparse rings of infill; the first four layers and every two hundredth are closed surfaces.
    """
    walls_mm = [30.0 - 0.45 * wall for wall in range(3)]
    sparse_mm, closed_mm = np.arange(28.4, 1, -2.0), np.arange(28.6, 0.4, -0.45)
    open_layer = _rings([*walls_mm, *sparse_mm]), _roles(walls_mm, sparse_mm, Role.INFILL)
    closed_layer = _rings([*walls_mm, *closed_mm]), _roles(walls_mm, closed_mm, Role.SURFACE)
    beads, roles, start = [], [], [0]
    while start[-1] < count:
        layer = len(start) - 1
        rings, role = closed_layer if layer < 4 or layer % 200 == 0 else open_layer
        rings = rings[: count - start[-1]].copy()
        rings[:, [2, 5]] = LAYER_MM * (layer + 1)
        beads.append(rings)
        roles.append(role[: len(rings)])
        start.append(start[-1] + len(rings))
    laid = np.concatenate(beads)
    begins = np.array(start)
    end_pos = 35 * np.arange(1, count + 1)
    return Toolpath(
        laid, end_pos, begins, end_pos[begins[1:] - 1], laid[begins[1:] - 1, 5], np.concatenate(roles),
        np.full(count, NO_OBJECT, np.int16), bytes=35 * count,
    )  # fmt: skip


def _rings(radii_mm: Sequence[float]) -> np.ndarray:
    parts = []
    for radius in radii_mm:
        steps = _steps(radius)
        angle = np.linspace(0, 2 * np.pi, steps + 1)
        wavy = radius * (1 + 0.07 * np.sin(6 * angle))
        x, y = 100 + wavy * np.cos(angle), 100 + wavy * np.sin(angle)
        ring = np.stack([x, y, np.zeros(steps + 1)], axis=1)
        parts.append(np.hstack([ring[:-1], ring[1:], np.tile([WIDTH_MM, LAYER_MM], (steps, 1))]))
    return np.concatenate(parts).astype(np.float32)


def _roles(walls_mm: Sequence[float], within_mm: Sequence[float], within: Role) -> np.ndarray:
    roles = [Role.OUTER, *[Role.INNER] * (len(walls_mm) - 1), *[within] * len(within_mm)]
    return np.repeat(roles, [_steps(radius) for radius in [*walls_mm, *within_mm]]).astype(np.uint8)


def _steps(radius_mm: float) -> int:
    return max(int(2 * np.pi * radius_mm / BEAD_MM), 6)


def camera_of(size_px: tuple[int, int], toolpath: Toolpath) -> Camera:
    """390 mm away, looking down 26 degrees at the middle of the print, through a webcam's lens."""
    middle = np.array([100.0, 100.0, float(toolpath.beads_mm[-1, 5]) / 2])
    forward = np.array([0.0, np.cos(np.radians(26)), -np.sin(np.radians(26))])
    right = np.array([1.0, 0.0, 0.0])
    rotation = np.stack([right, np.cross(forward, right), forward])
    width, height = size_px
    focal = 1.1 * width
    K = [[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1]]
    rvec = cv2.Rodrigues(rotation)[0].ravel()
    return Camera(size_px, K, [-0.2, 0.055, 0.0008, -0.0006, -0.004], rvec, -rotation @ (middle - 390 * forward))


def median_s(work: Callable[[], object], repeat: int) -> tuple[float, float]:
    """Seconds on the clock and of processor time, after one turn that does not count."""
    work()
    clock, processor = [], []
    for _ in range(repeat):
        began, worked = time.perf_counter(), time.process_time()
        work()
        clock.append(time.perf_counter() - began)
        processor.append(time.process_time() - worked)
    return statistics.median(clock), statistics.median(processor)


def frame_jpeg(size_px: tuple[int, int]) -> np.ndarray:
    """A picture with the detail of a webcam's, as JPEG of quality 85."""
    rng = np.random.default_rng(0)
    width, height = size_px
    coarse = cv2.resize(rng.integers(0, 255, (height // 16, width // 16, 3), np.uint8), size_px)
    noisy = np.clip(coarse.astype(np.int16) + rng.normal(0, 6, coarse.shape), 0, 255).astype(np.uint8)
    return cv2.imencode(".jpg", noisy, [cv2.IMWRITE_JPEG_QUALITY, 85])[1]


def growth(renderers: list[MaskRenderer], most: int, repeat: int) -> list[dict[str, object]]:
    rows = []
    for count in (count for count in COUNTS if count <= most):
        toolpath = made_print(count)
        for size, size_px in SIZES_PX.items():
            camera = camera_of(size_px, toolpath)
            row: dict[str, object] = {"beads": count, "size": size}
            for renderer in renderers:
                turns = repeat if count <= 300_000 else max(1, repeat // 2)
                clock, processor = median_s(lambda: renderer.birth_map(toolpath, camera, np.zeros(3)), turns)  # noqa: B023
                row[renderer.name] = {
                    "ms": round(1e3 * clock, 1), "processor_ms": round(1e3 * processor, 1),
                    "us_per_bead": round(1e6 * clock / count, 3),
                    "processor_us_per_bead": round(1e6 * processor / count, 3),
                }  # fmt: skip
            rows.append(row)
    return rows


def at_a_position(renderer: MaskRenderer, repeat: int) -> list[dict[str, object]]:
    toolpath = made_print(100_000)
    rows = []
    for size, size_px in SIZES_PX.items():
        views = ExpectedViews(toolpath, camera_of(size_px, toolpath), BedMotion(), renderer)
        jpeg = frame_jpeg(size_px)
        pos = toolpath.bytes // 2
        mask, _ = median_s(lambda: views.at(pos, (0, 0, 0)).mask, 20 * repeat)  # noqa: B023
        both, _ = median_s(lambda: [(e.mask, e.complete) for e in [views.at(pos, (0, 0, 0))]], 20 * repeat)  # noqa: B023
        decode, _ = median_s(lambda: cv2.imdecode(jpeg, cv2.IMREAD_COLOR), 20 * repeat)  # noqa: B023
        rows.append(
            {
                "size": size, "mask_ms": round(1e3 * mask, 3), "mask_and_complete_ms": round(1e3 * both, 3),
                "imdecode_ms": round(1e3 * decode, 3), "mask_over_imdecode": round(mask / decode, 3),
                "both_over_imdecode": round(both / decode, 3),
            }
        )  # fmt: skip
    return rows


def passing_pose(renderer: MaskRenderer, most: int, repeat: int) -> list[dict[str, object]]:
    """Each check at a pose of its own, as on a bed that drops: what is drawn then, and what is wrong with it."""
    rows = []
    for count in (count for count in (1_000_000, 3_000_000) if count <= most):
        toolpath = made_print(count)
        for size, size_px in SIZES_PX.items():
            camera = camera_of(size_px, toolpath)
            views = ExpectedViews(toolpath, camera, BedMotion("z"), renderer)
            layers = iter(range(toolpath.layers // 2, toolpath.layers))

            def check() -> np.ndarray:
                layer = next(layers)  # noqa: B023
                z = float(toolpath.layer_z_mm[layer])  # noqa: B023
                return views.at(int(toolpath.layer_end_pos[layer]), (0, 0, z)).mask  # noqa: B023

            clock, processor = median_s(check, repeat)
            layer = toolpath.layers - 2
            z, pos = float(toolpath.layer_z_mm[layer]), int(toolpath.layer_end_pos[layer])
            outward = views.at(pos, (0, 0, z)).mask
            births = renderer.birth_map(toolpath, camera, np.array([0, 0, -z]))
            whole = (births > 0) & (births <= toolpath.laid_at(pos))
            rows.append(
                {
                    "beads": count, "size": size, "check_ms": round(1e3 * clock, 1),
                    "processor_ms": round(1e3 * processor, 1),
                    "wrong_px": int(((outward > 0) ^ whole).sum()), "mask_px": int(whole.sum()),
                }
            )  # fmt: skip
    return rows


def plot(names: list[str], rows: list[dict[str, Any]]) -> str:
    """An SVG: processor time over beads, both axes logarithmic; a line for each renderer and size."""
    width, height, left, top = 720, 420, 70, 20
    low, high = 3.9, 6.6  # decades of beads
    least, most = 0.7, 4.7  # decades of milliseconds

    def place(beads: float, ms: float) -> tuple[float, float]:
        x = left + (np.log10(beads) - low) / (high - low) * (width - left - 20)
        y = top + (most - np.log10(max(ms, 1e-3))) / (most - least) * (height - top - 50)
        return round(float(x), 1), round(float(y), 1)

    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" font-family="sans-serif" '
        'font-size="13">',
        f'<rect width="{width}" height="{height}" fill="white"/>',
    ]
    for ms in (10, 100, 1000, 10_000):
        (x, y), (end, _) = place(10**low, ms), place(10**high, ms)
        label = f"{ms} ms" if ms < 1000 else f"{ms // 1000} s"
        parts.append(
            f'<path d="M{x} {y}H{end}" stroke="#ddd"/><text x="{x - 6}" y="{y + 4}" text-anchor="end">{label}</text>'
        )
    for beads in COUNTS:
        (x, y), (_, end) = place(beads, 10**least), place(beads, 10**most)
        parts.append(
            f'<path d="M{x} {y}V{end}" stroke="#eee"/><text x="{x}" y="{y + 20}" text-anchor="middle">{beads:,}</text>'
        )
    parts.append(
        f'<text x="{width / 2}" y="{height - 8}" text-anchor="middle">beads in the print; processor time</text>'
    )
    for number, name in enumerate(names):
        for dashes, size in zip(("none", "6 4"), SIZES_PX):
            line = [place(row["beads"], row[name]["processor_ms"]) for row in rows if row["size"] == size]
            colour = ("#1b6ca8", "#c1553b")[number % 2]
            path = "L".join(f"{x} {y}" for x, y in line)
            parts.append(
                f'<path d="M{path}" fill="none" stroke="{colour}" stroke-width="2" stroke-dasharray="{dashes}"/>'
            )
            row_y = top + 18 + 18 * (2 * number + (dashes != "none"))
            parts.append(
                f'<path d="M{left + 12} {row_y - 4}h30" stroke="{colour}" stroke-width="2" '
                f'stroke-dasharray="{dashes}"/>'
                f'<text x="{left + 50}" y="{row_y}">{name.split(" (")[0]}, {size}</text>'
            )
    return "\n".join([*parts, "</svg>", ""])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--most", type=int, default=3_000_000, help="largest print")
    parser.add_argument("--repeat", type=int, default=5, help="turns of each measurement")
    parser.add_argument("--write", action="store_true", help="keep the figures, and put table and plot into docs")
    parser.add_argument("--plot", type=Path, help="also draw how cost grows, as SVG")
    options = parser.parse_args()
    with open_renderer() as renderer:
        renderers: list[MaskRenderer] = [renderer]
        if not isinstance(renderer, CvRenderer):
            renderers.append(CvRenderer())
        result: dict[str, Any] = {
            "load_average": os.getloadavg()[0],
            "renderers": [one.name for one in renderers],
            "birth_map": growth(renderers, options.most, options.repeat),
            "mask_at_a_position": at_a_position(renderer, options.repeat),
            "passing_pose": passing_pose(renderer, options.most, options.repeat),
        }  # fmt: skip
    json.dump(result, sys.stdout, indent=1)
    print()
    if options.plot:
        options.plot.write_text(plot(result["renderers"], result["birth_map"]), encoding="utf-8")
    if options.write:
        save("render", f"python benchmarks/render.py --repeat {options.repeat} --write", "none", result)
        put(ROOT / "docs" / "rendering.md", "render", as_table(result))
        put(ROOT / "docs" / "rendering.md", "render-at-a-position", at_a_position_told(result))
        (ROOT / "docs" / "images" / "render-cost.svg").write_text(
            plot(result["renderers"], result["birth_map"]), encoding="utf-8"
        )


def as_table(result: dict[str, Any]) -> str:
    """Time on the clock of one birth map, and in brackets for a bead."""
    sizes = list(SIZES_PX)
    names = [(name, size) for name in result["renderers"] for size in sizes]
    rows = []
    for count in sorted({row["beads"] for row in result["birth_map"]}):
        found = {row["size"]: row for row in result["birth_map"] if row["beads"] == count}
        cells = [found[size][name] for name, size in names]
        rows.append([f"{count:,}", *(f"{c['ms']:.0f} ms ({c['us_per_bead']:.2f} µs)" for c in cells)])
    return table(["beads", *(f"{name.split(' (')[0]}, {size}" for name, size in names)], rows)


def at_a_position_told(result: dict[str, Any]) -> str:
    masks = " and ".join(f"{row['mask_over_imdecode']:.2f} at {row['size']}" for row in result["mask_at_a_position"])
    most = max(row["beads"] for row in result["passing_pose"])
    poses = ", ".join(
        f"{row['check_ms'] / 1000:.2f} s at {row['size']} ({row['wrong_px']} of {row['mask_px']:,} pixels wrong)"
        for row in result["passing_pose"] if row["beads"] == most
    )  # fmt: skip
    return (
        f"The mask at a position takes, in times of decoding the frame, {masks}. A check at a pose of its own takes, with "
        f"{most:,} beads, {poses}."
    )


if __name__ == "__main__":
    main()
