"""Things to print for the path-traced recordings: simple solids, sliced with PrusaSlicer into thick layers."""

from __future__ import annotations

import subprocess
import tempfile
from pathlib import Path

import numpy as np
import trimesh


def prism(
    outline: np.ndarray, height_mm: float, *, twist: float = 0.0, top: float = 1.0, steps: int = 1
) -> trimesh.Trimesh:
    """A star-shaped outline (n, 2) drawn upwards, turned by `twist` radians and scaled to `top` on the way."""
    rings, n = [], len(outline)
    for t in np.linspace(0, 1, steps + 1):
        c, s = np.cos(twist * t), np.sin(twist * t)
        rings.append(np.column_stack([outline @ [[c, s], [-s, c]] * (1 + (top - 1) * t), np.full(n, height_mm * t)]))
    points = np.concatenate([*rings, [[0, 0, 0], [0, 0, height_mm]]])
    k, faces = np.arange(n), []
    m = (k + 1) % n
    for step in range(steps):
        a = step * n
        faces += [np.column_stack([a + k, a + m, a + n + m]), np.column_stack([a + k, a + n + m, a + n + k])]
    low, high = len(points) - 2, len(points) - 1
    faces += [
        np.column_stack([m, k, np.full(n, low)]),
        np.column_stack([steps * n + k, steps * n + m, np.full(n, high)]),
    ]
    return trimesh.Trimesh(points, np.concatenate(faces), process=True)


def polygon(n: int, radius: float, *, star: float = 1.0) -> np.ndarray:
    a = np.arange(n) * 2 * np.pi / n
    r = np.where(np.arange(n) % 2, radius * star, radius)
    return np.column_stack([r * np.cos(a), r * np.sin(a)])


def block(low: tuple, high: tuple) -> trimesh.Trimesh:
    mesh = trimesh.creation.box(np.subtract(high, low))
    mesh.apply_translation(np.add(low, high) / 2)
    return mesh


def shape(kind: str, rng: np.random.Generator) -> trimesh.Trimesh:
    """A solid, or several that overlap, standing on z = 0 about the origin; 8 to 60 mm across."""
    s = 0.8 + 0.5 * rng.random()
    if kind == "star":
        return prism(polygon(16, 14 * s, star=0.7), 12 * s, twist=rng.normal(0, 0.6), top=0.8, steps=8)
    if kind == "tower":
        return prism(polygon(int(rng.choice([4, 6, 24])), 7 * s), 26 * s)
    if kind == "plate":
        return block((-42 * s, -26 * s, 0), (42 * s, 26 * s, 4.5)) + block((-38 * s, -3, 0), (38 * s, 3, 8.5))
    if kind == "bracket":
        return block((-18 * s, -10, 0), (18 * s, 10, 4)) + block((-18 * s, -10, 0), (-13 * s, 10, 17 * s))
    if kind == "arch":
        return (
            block((-16 * s, -6, 0), (-10 * s, 6, 13))
            + block((10 * s, -6, 0), (16 * s, 6, 13))
            + block((-16 * s, -6, 9.5), (16 * s, 6, 13))
        )
    if kind == "tee":
        return (
            block((-4, -5, 0), (4, 5, 14 * s))
            + block((-10 * s, -5, 10 * s), (10 * s, 5, 14 * s))
            + block((-9, -9, 0), (9, 9, 2))
        )
    if kind == "dome":
        return prism(polygon(40, 12 * s), 11 * s, top=0.45, steps=6)
    if kind == "cross":
        return (
            block((-17 * s, -5, 0), (17 * s, 5, 9 * s))
            + block((-5, -17 * s, 0), (5, 17 * s, 6 * s))
            + block((-3, -3, 0), (3, 3, 15 * s))
        )
    if kind == "stairs":
        return sum(
            (block((-15 * s + 6 * n * s, -9, 0), (-9 * s + 6 * n * s, 9, 3.2 * (n + 1))) for n in range(1, 5)),
            block((-15 * s, -9, 0), (-9 * s, 9, 3.2)),
        )
    return prism(polygon(48, 10 * s), 10 * s)


def sliced(
    out: Path, kinds: list[str], centre_mm: tuple[float, float], layer_mm: float, rng: np.random.Generator
) -> Path:
    """G-code of these shapes side by side about a place. Raises CalledProcessError where the slicer fails."""
    columns = int(np.ceil(np.sqrt(len(kinds))))
    with tempfile.TemporaryDirectory() as folder:
        files = []
        for n, kind in enumerate(kinds):
            mesh = shape(kind, rng)
            mesh.apply_transform(
                trimesh.transformations.rotation_matrix(rng.random() * 6.28 * (kind != "plate"), [0, 0, 1])
            )
            spot = np.array([n % columns - (columns - 1) / 2, n // columns - (len(kinds) - 1) // columns / 2]) * 44
            mesh.apply_translation([*(spot + centre_mm), 0])
            files.append(str(Path(folder) / f"{kind}_{n}.stl"))
            mesh.export(files[-1])
        supports = ["--support-material"] if rng.random() < 0.15 else []
        command = [
            "prusa-slicer", "--export-gcode", *files, "--merge", "--dont-arrange", "--center", f"{centre_mm[0]},{centre_mm[1]}",
            "--output", str(out), "--layer-height", str(layer_mm), "--first-layer-height", str(layer_mm), "--nozzle-diameter",
            "0.6" if layer_mm > 0.33 else "0.4", "--max-layer-height", "0.5", "--fill-density", f"{int(rng.choice([8, 15, 25]))}%", "--perimeters", "2",
            "--skirts", str(int(rng.choice([0, 1, 2]))), "--brim-width", str(int(rng.choice([0, 0, 4]))), "--gcode-comments",
            "--gcode-label-objects", "--use-relative-e-distances", "--bed-shape", "-500x-500,500x-500,500x500,-500x500",
            "--seam-position", "aligned", "--fill-pattern", str(rng.choice(["rectilinear", "grid", "gyroid"])), *supports,
        ]  # fmt: skip
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode or not out.is_file():
            raise RuntimeError(f"The slicer failed: {(done.stderr or done.stdout).strip().splitlines()[-3:]}")
    return out
