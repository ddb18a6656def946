"""Models as meshes: what a CAD program or a slicer's project says is to be printed.

The G-code knows more (skirts, supports, placement), so a mesh serves where somebody wants the paper's road, or where no
G-code can be read.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import MeshError
from ..toolpath import Role, Toolpath
from .project3mf import read_3mf

SUFFIXES = (".stl", ".obj", ".3mf")
STL_HEADER_BYTES = 84
STL_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attributes", "<u2")])
MOST_TRIANGLES_CROSSED = 200_000  # beyond, looking for crossings would take longer than a layer
MICROMETRES = 1000.0  # in a millimetre: heights are kept as whole micrometres
SAME_PLACE_MM = 1.0
SAME_SIZE_MM = 2.0


@dataclass(frozen=True, eq=False)
class Solid:
    """A surface of triangles that bounds what is printed.

    triangles_mm : (N, 3, 3) float32, print coordinates
    notes        : sentences for the user about what is wrong with it or how it was placed
    """

    triangles_mm: np.ndarray
    notes: tuple[str, ...] = ()

    def bounds_mm(self) -> np.ndarray:
        """(2, 3) float64: lowest and highest corner."""
        corners = self.triangles_mm.reshape(-1, 3)
        return np.stack([corners.min(axis=0), corners.max(axis=0)]).astype(np.float64)

    def cut(self, longest_mm: float) -> np.ndarray:
        """(M, 3, 3) float32: the same surface in triangles of which no side is longer than `longest_mm`."""
        triangles = self.triangles_mm
        while np.isfinite(longest_mm):
            sides = triangles - np.roll(triangles, -1, axis=1)
            long = (np.einsum("nij,nij->ni", sides, sides) > longest_mm**2).any(axis=1)
            if not long.any():
                break
            a, b, c = (triangles[long, i] for i in range(3))
            ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
            quarters = [np.stack(q, axis=1) for q in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
            triangles = np.concatenate([triangles[~long], *quarters])
        return triangles

    def moved(self, by_mm: np.ndarray | Sequence[float]) -> Solid:
        return replace(self, triangles_mm=self.triangles_mm + np.asarray(by_mm, dtype=np.float32))

    def turned(self, by_deg: float) -> Solid:
        """Counter-clockwise seen from above, about the middle of its bounds."""
        if not by_deg:
            return self
        cos, sin = np.cos(np.radians(by_deg)), np.sin(np.radians(by_deg))
        middle = self.bounds_mm().mean(axis=0) * [1, 1, 0]
        turn = np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]])  # of row vectors
        return replace(self, triangles_mm=((self.triangles_mm - middle) @ turn + middle).astype(np.float32))

    def stl(self) -> bytes:
        """The surface as a binary STL file."""
        rows = np.zeros(len(self.triangles_mm), dtype=STL_TRIANGLE)
        rows["corners"] = self.triangles_mm
        return bytes(80) + len(rows).to_bytes(4, "little") + rows.tobytes()

    def placed_on(self, toolpath: Toolpath) -> Solid:
        """The same solid where the G-code prints it: as it is, where that is already so, else by the bounds.

        Skirts, supports and towers do not count towards the G-code's bounds. `notes` tells what was done and what
        does not fit.
        """
        low, high = printed_bounds_mm(toolpath)
        own_low, own_high = self.bounds_mm()
        by_mm = (low + high) / 2 - (own_low + own_high) / 2
        by_mm[2] = low[2] - own_low[2]
        notes = list(self.notes)
        differ = (own_high - own_low) - (high - low)
        if np.abs(differ).max() > SAME_SIZE_MM:
            own, wanted = (" x ".join(f"{side:.1f}" for side in size) for size in (own_high - own_low, high - low))
            notes.append(
                f"The model measures {own} mm, what is printed {wanted} mm. Was it scaled, rotated or copied in the "
                "slicer? Then export the plate from the slicer as STL or 3MF and use that."
            )
        if np.abs(by_mm).max() <= SAME_PLACE_MM:
            return replace(self, notes=tuple(notes))
        notes.append(
            f"The model was moved by {by_mm[0]:.1f}, {by_mm[1]:.1f}, {by_mm[2]:.1f} mm to where it is printed."
        )
        return replace(self.moved(by_mm), notes=tuple(notes))


def printed_bounds_mm(toolpath: Toolpath) -> np.ndarray:
    """(2, 3) float64: the bounds of what is printed apart from skirts, supports and towers, widths included."""
    besides = np.isin(toolpath.role, np.array([Role.BRIM, Role.SUPPORT, Role.TOWER], dtype=np.uint8))
    beads = toolpath.beads_mm[~besides] if not besides.all() else toolpath.beads_mm
    if not len(beads):
        raise MeshError("The G-code prints nothing, so the model cannot be placed by it.")
    half = beads[:, 6:7] / 2
    low = np.minimum(beads[:, :3], beads[:, 3:6]) - np.hstack([half, half, beads[:, 7:8]])
    high = np.maximum(beads[:, :3], beads[:, 3:6]) + np.hstack([half, half, 0 * half])
    return np.stack([low.min(axis=0), high.max(axis=0)]).astype(np.float64)


def read_solid(path: str | os.PathLike[str]) -> Solid:
    """The surface in an STL, OBJ or 3MF file, in its own coordinates, with what is wrong with it said in `notes`.

    Raises MeshError where the file is none of these, is broken, or holds no triangle.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise MeshError(f"{path.name}: models can be {', '.join(SUFFIXES)}. Export it from the slicer as STL.")
    try:
        if suffix == ".3mf":
            triangles = read_3mf(path)
        else:
            binary = _binary_stl(path) if suffix == ".stl" else None
            triangles = _by_trimesh(path) if binary is None else binary
    except OSError as error:
        raise MeshError(f"{path.name}: cannot be read ({error.strerror or error}).") from None
    if not np.isfinite(triangles).all():
        raise MeshError(f"{path.name}: some corners are not finite numbers. Export the model again.")
    triangles = triangles[_areas(triangles) > 0]
    if not len(triangles):
        raise MeshError(f"{path.name}: holds no surface. Export the model again.")
    return Solid(np.ascontiguousarray(triangles, dtype=np.float32), tuple(faults(triangles)))


def _binary_stl(path: Path) -> np.ndarray | None:
    """(N, 3, 3) float32; None where the length says that this is not a binary STL.

    trimesh takes a hundred times as long, since it merges vertices, which a mask does not need.
    """
    size = path.stat().st_size
    with open(path, "rb") as file:
        header = file.read(STL_HEADER_BYTES)
        count = int.from_bytes(header[80:84], "little")
        if len(header) < STL_HEADER_BYTES or size < STL_HEADER_BYTES + count * STL_TRIANGLE.itemsize or not count:
            return None
        return np.fromfile(file, dtype=STL_TRIANGLE, count=count)["corners"]


def _by_trimesh(path: Path) -> np.ndarray:
    """(N, 3, 3) float64."""
    import trimesh

    try:
        mesh: Any = trimesh.load(str(path), force="mesh", process=False)
        triangles = np.asarray(mesh.triangles)
    except Exception as error:  # trimesh raises whatever its parsers raise
        raise MeshError(f"{path.name}: is not a {path.suffix[1:].upper()} file that can be read ({error}).") from None
    if triangles.ndim != 3 or not len(triangles):
        raise MeshError(f"{path.name}: holds no surface. Export the model again.")
    return triangles


def _areas(triangles: np.ndarray) -> np.ndarray:
    a, b, c = (triangles[:, i].astype(np.float64) for i in range(3))
    return np.linalg.norm(np.cross(b - a, c - a), axis=1)


def faults(triangles: np.ndarray) -> list[str]:
    """Sentences about holes in the surface, and where it crosses itself. An empty list for a sound solid.

    triangles : (N, 3, 3)
    """
    found = []
    corner = _corner_numbers(triangles)
    edges = np.sort(np.stack([corner, np.roll(corner, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    _, uses = np.unique(edges[:, 0].astype(np.int64) << 32 | edges[:, 1], return_counts=True)
    open_edges = int((uses % 2).sum())
    if open_edges:
        found.append(
            f"The model is not closed: {open_edges} edges border a hole. Where a hole faces the camera, matter will be "
            "expected too late. Repair the model in the slicer, or use the G-code."
        )
    if len(triangles) > MOST_TRIANGLES_CROSSED:
        found.append(
            f"The model has {len(triangles)} triangles; it was not looked at whether its surface crosses itself."
        )
        return found
    crossings = count_crossings(triangles, corner)
    if crossings:
        found.append(
            f"The model's surface crosses itself in {crossings} places. Everything within any of its shells is "
            "expected, as most slicers print it."
        )
    return found


def _corner_numbers(triangles: np.ndarray) -> np.ndarray:
    """(N, 3) int64: equal numbers for corners at the same place, bit for bit."""
    places = np.ascontiguousarray(triangles, dtype=np.float32).reshape(-1, 3) + np.float32(0)  # -0 becomes 0
    rows = np.ascontiguousarray(places).view(np.dtype((np.void, 12))).ravel()
    _, number = np.unique(rows, return_inverse=True)
    return number.reshape(-1, 3).astype(np.int64)


def count_crossings(triangles: np.ndarray, corner: np.ndarray) -> int:
    """How many pairs of triangles that share no corner cut through one another.

    triangles : (N, 3, 3); corner : (N, 3) equal numbers for the same corner
    A tree of boxes over the triangles in Morton order is walked level by level, pairs of boxes that are apart dropped.
    """
    triangles = triangles.astype(np.float64)
    low, high = triangles.min(axis=1), triangles.max(axis=1)
    order = np.argsort(_morton((low + high) / 2), kind="stable")
    depth = int(np.ceil(np.log2(max(len(order), 2))))
    boxes_low, boxes_high = [np.full((1 << depth, 3), np.inf)], [np.full((1 << depth, 3), -np.inf)]
    boxes_low[0][: len(order)], boxes_high[0][: len(order)] = low[order], high[order]
    for _ in range(depth):
        boxes_low.append(boxes_low[-1].reshape(-1, 2, 3).min(axis=1))
        boxes_high.append(boxes_high[-1].reshape(-1, 2, 3).max(axis=1))
    first = second = np.zeros(1, dtype=np.int64)
    for level in range(depth - 1, -1, -1):
        first, second = (
            np.concatenate([2 * first + i for i in (0, 0, 1, 1)]),
            np.concatenate([2 * second + j for j in (0, 1, 0, 1)]),
        )
        keep = first <= second
        first, second = first[keep], second[keep]
        lows, highs = boxes_low[level], boxes_high[level]
        keep = np.all((lows[first] <= highs[second]) & (lows[second] <= highs[first]), axis=1)
        first, second = first[keep], second[keep]
    first, second = order[first[first != second]], order[second[first != second]]
    strangers = ~(corner[first][:, :, None] == corner[second][:, None, :]).any(axis=(1, 2))
    first, second = first[strangers], second[strangers]
    cut = np.zeros(len(first), dtype=bool)
    for one, other in ((first, second), (second, first)):
        for i in range(3):
            cut |= _cuts(triangles[one, i], triangles[one, (i + 1) % 3], triangles[other])
    return int(cut.sum())


def _morton(points: np.ndarray) -> np.ndarray:
    """(N,) int64: the points' places along a curve on which neighbours are near."""
    span = np.maximum(points.max(axis=0) - points.min(axis=0), 1e-9)
    cell = ((points - points.min(axis=0)) / span * 1023).astype(np.int64)
    code = np.zeros(len(points), dtype=np.int64)
    for bit in range(10):
        for axis in range(3):
            code |= ((cell[:, axis] >> bit) & 1) << (3 * bit + axis)
    return code


def _cuts(begin: np.ndarray, end: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(N,) bool: the line from begin to end passes through the inside of its triangle (Möller and Trumbore 1997)."""
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    along, side, other = end - begin, b - a, c - a
    p = np.cross(along, other)
    determinant = np.einsum("ij,ij->i", side, p)
    flat = np.abs(determinant) < 1e-12
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = 1 / np.where(flat, np.nan, determinant)
        s = begin - a
        u = np.einsum("ij,ij->i", s, p) * scale
        q = np.cross(s, side)
        v = np.einsum("ij,ij->i", along, q) * scale
        t = np.einsum("ij,ij->i", other, q) * scale
        inside = 1e-7
        return (u > inside) & (v > inside) & (u + v < 1 - inside) & (t > inside) & (t < 1 - inside)
