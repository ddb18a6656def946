"""A sliced print as matter: a plain reader of G-code, beads as tubes, and what a fault does to them.

None of this is the product's own reader or drawing, so that the truth comes by another road.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

WORD = re.compile(rb"([A-Z])\s*([-+]?\d*\.?\d+)")
LAYER = re.compile(rb";\s*(LAYER_CHANGE|LAYER:\s*-?\d+|layer \d+)")
BEGIN = re.compile(rb";\s*(?:printing object |PRINTING: |MESH:)(.+?)\s*$")
SIDES = 8


@dataclass(frozen=True, eq=False)
class Beads:
    """Extruding moves in the file's order. ends_mm: (N, 2, 3), z at the nozzle; size_mm: (N, 2) width, height; layer,
    object_id (N,), -1 where no label; file_pos (N,) byte after the move; objects: labels as the file spells them."""

    ends_mm: np.ndarray
    size_mm: np.ndarray
    layer: np.ndarray
    object_id: np.ndarray
    file_pos: np.ndarray
    objects: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.layer)

    @property
    def layers(self) -> int:
        return int(self.layer[-1]) + 1

    def layer_end(self, layer: int) -> int:
        return int(np.flatnonzero(self.layer == layer)[-1])


def read_beads(path: Path, filament_mm: float = 1.75) -> Beads:
    """Millimetres, G0 to G3, G90/G91, M82/M83, G92; layers by comment, or by height where there is none."""
    text = path.read_bytes()
    at, e, relative, relative_e = np.zeros(3), 0.0, False, False
    rows, objects, current, layer, pending, prefix = [], [], -1, 0, False, True
    by_comment = len(LAYER.findall(text)) > 3
    top, below, offset, hop = 0.0, 0.0, 0, re.compile(rb"^;(HEIGHT|Z):\s*([\d.]+)")
    height = None
    for line in text.splitlines(keepends=True):
        offset += len(line)
        code, _, comment = line.partition(b";")
        if comment:
            note = b";" + comment.strip()
            said = BEGIN.match(note)
            if by_comment and LAYER.match(note):
                pending, prefix = True, False
                height = None
            elif said and b"INIT" not in note:
                name = said[1].decode(errors="replace")
                if name.startswith("NON"):
                    current = -1
                else:
                    if name not in objects:
                        objects.append(name)
                    current = objects.index(name)
            elif note.startswith((b"; stop printing", b";stop printing")):
                current = -1
            elif hop.match(note) and note.startswith(b";HEIGHT"):
                height = float(hop.match(note)[2])
        words = {key: float(value) for key, value in WORD.findall(code.upper())}
        if b"G" in words:
            g = words[b"G"]
            if g in (90, 91):
                relative, relative_e = g == 91, relative_e if g == 90 else True
            elif g == 92:
                e = words.get(b"E", e)
            elif g in (0, 1, 2, 3):
                to = at.copy()
                for axis, key in enumerate((b"X", b"Y", b"Z")):
                    if key in words:
                        to[axis] = words[key] + (at[axis] if relative else 0.0)
                fed = 0.0
                if b"E" in words:
                    fed = words[b"E"] if relative_e else words[b"E"] - e
                    e = e + fed
                if fed > 0 and np.hypot(*(to - at)[:2]) > 1e-4:
                    if not by_comment and to[2] > top + 0.02 and rows:
                        pending = True
                    if pending and rows and not (prefix is False and rows[-1][-2] == -2):
                        layer += 1
                    pending = False
                    if to[2] > top + 0.02 or to[2] < top - 1:
                        below = top if to[2] > top else 0.0
                        top = to[2]
                    thick = height or (to[2] - below if 0.04 < to[2] - below < 1.2 else 0.25)
                    path_mm = [at, *arc(at, to, words, g == 2)] if g > 1 else [at, to]
                    length = sum(float(np.linalg.norm(b - a)) for a, b in zip(path_mm, path_mm[1:]))
                    area = fed * np.pi * filament_mm**2 / 4 / length
                    width = float(np.clip(area / thick + thick * (1 - np.pi / 4), 0.15, 1.6))
                    for a, b in zip(path_mm, path_mm[1:]):
                        rows.append((*a, *b, width, thick, layer, -2 if by_comment and prefix else current, offset))
                at = to
        elif words.get(b"M") in (82, 83):
            relative_e = words[b"M"] == 83
    table = np.array(rows)
    return Beads(
        table[:, :6].reshape(-1, 2, 3), table[:, 6:8], table[:, 8].astype(int),
        np.maximum(table[:, 9].astype(int), -1), table[:, 10].astype(int), tuple(objects),
    )  # fmt: skip


def arc(start: np.ndarray, end: np.ndarray, words: dict, clockwise: bool) -> list[np.ndarray]:
    """Points along G2/G3 with I and J, about half a millimetre apart."""
    centre = start[:2] + (words.get(b"I", 0.0), words.get(b"J", 0.0))
    a, b = start[:2] - centre, end[:2] - centre
    turn = np.arctan2(b[1], b[0]) - np.arctan2(a[1], a[0])
    if clockwise:
        turn -= 2 * np.pi * (turn >= -1e-9)
    else:
        turn += 2 * np.pi * (turn <= 1e-9)
    count = max(2, int(abs(turn) * np.hypot(*a) / 0.5))
    angles = np.arctan2(a[1], a[0]) + turn * np.arange(1, count) / count
    between = centre + np.hypot(*a) * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return [np.append(p, start[2]) for p in between] + [end]


@dataclass(frozen=True, eq=False)
class Tubes:
    """Rings of SIDES vertices. vertices_mm: (R, SIDES, 3); linked: (R,) bool, ring joined with the next one;
    bead: (R,) which bead of the print the ring (and the link after it) belongs to, -1 for stray matter."""

    vertices_mm: np.ndarray
    linked: np.ndarray
    bead: np.ndarray

    def triangles(self, keep: np.ndarray) -> np.ndarray:
        """(T, 3) int indices into the flattened vertices, for links whose ring is kept."""
        first = (np.flatnonzero(self.linked & keep) * SIDES)[:, None]
        k, n = np.arange(SIDES), (np.arange(SIDES) + 1) % SIDES
        quads = np.stack([first + k, first + n, first + SIDES + n, first + SIDES + k], axis=2).reshape(-1, 4)
        tube = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
        ends = keep & (self.linked != np.concatenate([[False], self.linked[:-1]]))
        cap = (np.flatnonzero(ends) * SIDES)[:, None, None] + np.array([[0, i, i + 1] for i in range(1, SIDES - 1)])
        return np.concatenate([tube, cap.reshape(-1, 3)])


def tubes(points_mm: np.ndarray, size_mm: np.ndarray, starts: np.ndarray, bead: np.ndarray, hang: bool = True) -> Tubes:
    """Polylines as tubes. points_mm: (P, 3) centre line tops; size_mm: (P, 2); starts: (P,) bool, first of a polyline;
    bead: (P,). With `hang` the points are the nozzle's height and the bead lies below it."""
    starts = starts.copy()
    starts[0] = True
    last = np.append(starts[1:], True)
    step = np.diff(points_mm, axis=0, append=points_mm[-1:])
    step[last] = 0
    length = np.linalg.norm(step, axis=1, keepdims=True)
    ahead = step / np.maximum(length, 1e-9)
    behind = np.roll(ahead, 1, axis=0)
    behind[starts] = 0
    tangent = ahead + behind
    norm = np.linalg.norm(tangent, axis=1, keepdims=True)
    cosine = np.where((starts | last)[:, None], 1.0, norm / 2)
    tangent = tangent / np.maximum(norm, 1e-9)
    side = np.stack([-tangent[:, 1], tangent[:, 0], np.zeros(len(tangent))], axis=1)
    flat = np.linalg.norm(side, axis=1, keepdims=True)
    side = np.where(flat > 0.05, side / np.maximum(flat, 1e-9), [1.0, 0.0, 0.0])
    up = np.cross(tangent, side)
    angles = (np.arange(SIDES) + 0.5) * 2 * np.pi / SIDES
    x, y = (
        np.sign(np.cos(angles)) * np.abs(np.cos(angles)) ** 0.6,
        np.sign(np.sin(angles)) * np.abs(np.sin(angles)) ** 0.8,
    )
    wide, thick = size_mm[:, :1] / np.clip(cosine, 0.6, 1), size_mm[:, 1:]
    centre = points_mm - np.array([0, 0, 0.5]) * thick if hang else points_mm

    def ring(rows: np.ndarray, along: float, scale: float) -> np.ndarray:
        middle = centre[rows] + tangent[rows] * wide[rows] * along
        offset = side[rows, None] * (wide[rows] / 2 * scale * x)[..., None]
        return middle[:, None] + offset + up[rows, None] * (thick[rows] / 2 * scale * y)[..., None]

    body = np.arange(len(points_mm))
    first, final = np.flatnonzero(starts), np.flatnonzero(last)
    order = np.concatenate([body * 3 + 1, first * 3, final * 3 + 2])
    vertices = np.concatenate([ring(body, 0.0, 1.0), ring(first, -0.4, 0.6), ring(final, 0.4, 0.6)])
    owner = np.concatenate([bead, bead[first], bead[final]])
    linked = np.concatenate([np.ones(len(body) + len(first), bool), np.zeros(len(final), bool)])
    sort = np.argsort(order, kind="stable")
    return Tubes(vertices[sort].astype(np.float32), linked[sort], owner[sort])


def print_tubes(beads: Beads, rng: np.random.Generator) -> Tubes:
    """The whole print as tubes; each layer is laid a little off, each bead a little wider or thinner."""
    a, b = beads.ends_mm[:, 0], beads.ends_mm[:, 1]
    ahead = (b - a) / np.maximum(np.linalg.norm(b - a, axis=1, keepdims=True), 1e-9)
    joined = np.zeros(len(beads), bool)
    joined[1:] = (
        (np.abs(a[1:] - b[:-1]).max(axis=1) < 1e-3) & (beads.layer[1:] == beads.layer[:-1])
        & (beads.object_id[1:] == beads.object_id[:-1]) & ((ahead[1:] * ahead[:-1]).sum(axis=1) > -0.3)
    )  # fmt: skip
    starts = np.flatnonzero(~joined)
    count = len(beads) + len(starts)
    at = np.arange(len(beads)) + np.cumsum(~joined)  # the row of a bead's end
    points, size, bead, first = np.zeros((count, 3)), np.zeros((count, 2)), np.zeros(count, int), np.zeros(count, bool)
    points[at], size[at], bead[at] = b, beads.size_mm, np.arange(len(beads))
    opening = at[starts] - 1
    points[opening], size[opening], bead[opening], first[opening] = a[starts], beads.size_mm[starts], starts, True
    # a ring's link goes to the NEXT ring, so it belongs to the bead that ends there
    following = np.append(bead[1:], bead[-1])
    bead = np.where(np.append(first[1:], True), bead, following)
    offsets = rng.normal(0, 0.02, (beads.layers, 2))
    points[:, :2] += offsets[beads.layer[bead]]
    size[:, 0] *= 1 + np.repeat(rng.normal(0, 0.03, count // 8 + 1), 8)[:count]
    return tubes(points, size, first, bead)


def tangle(
    rng: np.random.Generator, from_mm: np.ndarray, spread_mm: float, metres: float, floor_mm: float
) -> np.ndarray:
    """(P, 3): a thread that wanders about where it fell, loop over loop."""
    count = max(12, int(metres * 1000 / 1.2))
    heading = np.cumsum(rng.normal(0, 0.35, count) + rng.choice([-1, 1]) * 0.12)
    path = np.cumsum(1.2 * np.stack([np.cos(heading), np.sin(heading)], axis=1), axis=0)
    path -= path.mean(axis=0)
    pull = np.abs(path).max()
    path *= spread_mm / max(pull, 1e-6) if pull > spread_mm else 1.0
    lift = np.abs(np.convolve(rng.normal(0, 1, count + 40), np.ones(41) / 41, "valid")) * spread_mm * 1.2
    lift *= np.clip(1.2 - np.hypot(*path.T) / (spread_mm + 1e-6), 0.1, 1)
    return np.column_stack([path + from_mm[:2], floor_mm + 0.25 + lift])


@dataclass(eq=False)
class Fault:
    """What goes wrong, with which object (None: all), from which layer on, how strongly. All else is drawn from the seed."""

    kind: str
    onset: int
    object_id: int | None = None
    size: float = 1.0
    seed: int = 0
    draws: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        self.draws = np.random.default_rng([self.seed, 77]).random(12)

    def rng(self, *more: int) -> np.random.Generator:
        return np.random.default_rng([self.seed, 78, *more])


def affected(beads: Beads, fault: Fault) -> np.ndarray:
    """(N,) bool: beads of the object in question. Skirts and prime lines are nobody's."""
    if fault.object_id is not None:
        return beads.object_id == fault.object_id
    if (beads.object_id >= 0).any() and fault.kind != "layer_shift":
        return beads.object_id >= 0
    body = np.isin(beads.layer, np.unique(beads.layer)[2:])
    low, high = (f(axis=(0, 1)) for f in (beads.ends_mm[body].min, beads.ends_mm[body].max))
    middle = beads.ends_mm.mean(axis=1)
    inside = ((middle[:, :2] >= low[:2] - 0.6) & (middle[:, :2] <= high[:2] + 0.6)).all(axis=1)
    return inside | (beads.layer >= 2)


@dataclass(frozen=True, eq=False)
class Matter:
    """What stands on the bed at one moment: vertices (V, 3), triangles (T, 3)."""

    vertices_mm: np.ndarray
    triangles: np.ndarray


def turned(points: np.ndarray, axis: np.ndarray, angle: float, about: np.ndarray) -> np.ndarray:
    x, y, z = axis / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    turn = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    return (points - about) @ turn.T + about


@dataclass(eq=False)
class Growth:
    """A print that grows, with what goes wrong. `hairs` says how many fine strings are drawn between parts."""

    beads: Beads
    fault: Fault | None
    hairs: int = 0
    seed: int = 0

    def __post_init__(self) -> None:
        self._tubes = print_tubes(self.beads, np.random.default_rng([self.seed, 5]))
        self._layer = self.beads.layer[self._tubes.bead]
        self._mine = affected(self.beads, self.fault)[self._tubes.bead] if self.fault else None

    def clean(self, layer: int | None) -> Matter:
        """The print as it ought to stand after `layer`; None: complete."""
        keep = np.ones(len(self._layer), bool) if layer is None else self._layer <= layer
        return Matter(self._tubes.vertices_mm.reshape(-1, 3), self._tubes.triangles(keep))

    def actual(self, layer: int) -> Matter:
        """The print as it stands after `layer`."""
        fault = self.fault
        keep = self._layer <= layer
        vertices, strays = self._tubes.vertices_mm, []
        if self.hairs:
            strays += self._strings(layer)
        if fault and layer >= fault.onset:
            vertices, keep, more = self._after(layer, vertices.copy(), keep)
            strays += more
        parts = [Matter(vertices.reshape(-1, 3), self._tubes.triangles(keep))]
        for path, width in strays:
            starts = np.zeros(len(path), bool)
            one = tubes(path, np.full((len(path), 2), width), starts, np.zeros(len(path), int), hang=False)
            parts.append(Matter(one.vertices_mm.reshape(-1, 3), one.triangles(np.ones(len(one.linked), bool))))
        offsets = np.cumsum([0] + [len(p.vertices_mm) for p in parts])
        return Matter(
            np.concatenate([p.vertices_mm for p in parts]).astype(np.float32),
            np.concatenate([p.triangles + o for p, o in zip(parts, offsets)]).astype(np.uint32),
        )

    def _strings(self, layer: int) -> list:
        rng, out = np.random.default_rng([self.seed, 6]), []
        a, b = self.beads.ends_mm[1:, 0], self.beads.ends_mm[:-1, 1]
        jumps = np.flatnonzero((np.linalg.norm(a - b, axis=1) > 8) & (self.beads.layer[1:] > 1) & (a[:, 2] == b[:, 2]))
        if not len(jumps):
            return out
        for jump in sorted(rng.choice(jumps, min(self.hairs, len(jumps)), replace=False)):
            droop = rng.random() * 2
            if self.beads.layer[jump + 1] <= layer:
                t = np.linspace(0, 1, 12)[:, None]
                path = b[jump] * (1 - t) + a[jump] * t
                path[:, 2] -= 4 * droop * (t * (1 - t))[:, 0]
                path[:, 2] = np.maximum(path[:, 2], 0.1)
                out.append((path, 0.06 + 0.06 * rng.random()))
        return out

    def _after(self, layer: int, vertices: np.ndarray, keep: np.ndarray) -> tuple[np.ndarray, np.ndarray, list]:
        fault, mine, born = self.fault, self._mine, self._layer
        old, new = mine & (born < fault.onset), mine & (born >= fault.onset)
        low, high = vertices[old if old.any() else mine].reshape(-1, 3).min(0), vertices[mine].reshape(-1, 3).max(0)
        middle, age, d = (low + high) / 2, layer - fault.onset, fault.draws
        kind, strays = fault.kind, []
        if kind == "extrusion_stop":
            keep = keep & ~(born >= fault.onset)
        elif kind == "under_extrusion":
            chance = fault.rng(1).random(len(self.beads) // 4 + 1).repeat(4)[self._tubes.bead]
            keep = keep & ~((born >= fault.onset) & (chance < 0.35 + 0.3 * d[0]))
        elif kind.startswith("layer_shift"):
            step = (1.2 + 1.8 * d[0] if kind.endswith("small") else 6 + 12 * d[0]) * fault.size
            axis = int(d[1] < 0.5)
            vertices[born >= fault.onset, :, axis] += step * (1 if d[2] < 0.5 else -1)
        elif kind == "warping":
            vertices[mine] = self._lifted(vertices[mine], born[mine], layer, low, high)
        elif kind in ("detachment", "tip_over"):
            rigid = vertices[old].reshape(-1, 3).astype(float)
            way = 2 * np.pi * d[0]
            drag = np.array([np.cos(way), np.sin(way), 0.0])
            if kind == "tip_over":
                edge = middle + drag * np.abs((high - low) / 2 @ np.abs(drag))
                edge[2] = 0.0
                rigid = turned(rigid, np.array([-drag[1], drag[0], 0.0]), np.radians(80 + 10 * d[1]), edge)
            else:
                rigid = turned(
                    rigid, np.array([0, 0, 1.0]), np.radians((12 + 40 * d[1]) * (1 if d[2] < 0.5 else -1)), middle
                )
            step = (9 + 14 * d[3]) * fault.size * min(1.0, 0.5 + 0.25 * age)
            if d[4] < 0.5:
                step = step * (1 + 0.06 * age)
            rigid += drag * step
            rigid[:, 2] -= min(rigid[:, 2].min(), 0.0)
            vertices[old] = rigid.reshape(-1, *vertices.shape[1:])
            keep = keep & ~new
            strays = self._fallen(layer, middle, (high - low)[:2], 0.0)
        elif kind == "spaghetti":
            top = float(self.beads.ends_mm[self.beads.layer == fault.onset, 0, 2].max())
            beside = middle + np.array(
                [*(np.array([np.cos(6.3 * d[0]), np.sin(6.3 * d[0])]) * (high - low)[:2] * 0.5), 0]
            )
            lost = mine & (born >= fault.onset)
            chance = fault.rng(2).random(len(self.beads) // 30 + 1).repeat(30)[self._tubes.bead]
            keep = keep & ~(lost & (chance < 0.3 + 0.6 * d[1]))
            strays = self._fallen(layer, beside, (high - low)[:2] * 0.7, 0.0 if d[2] < 0.5 else top * 0.5)
        elif kind == "spaghetti_first_layer":
            lost = mine & (
                fault.rng(2).random(len(self.beads) // 12 + 1).repeat(12)[self._tubes.bead] < 0.5 + 0.45 * d[1]
            )
            keep = keep & ~lost
            strays = self._fallen(layer, middle, (high - low)[:2] * 0.8, 0.0)
        elif kind == "blob":
            at = vertices[born == fault.onset].reshape(-1, 3)
            at = at[fault.rng(3).integers(len(at))].astype(float)
            for n in range(min(age + 1, 7)):
                rng = fault.rng(4, n)
                at = at + rng.normal(0, 1.3, 3) * fault.size + (0, 0, 0.3)
                way, thick = rng.normal(0, 1, 3), (1.6 + 2.2 * rng.random()) * fault.size
                path = at + np.linspace(-1, 1, 9)[:, None] * way / np.linalg.norm(way) * thick
                path += rng.normal(0, 0.15, path.shape)
                path[:, 2] = np.maximum(path[:, 2], thick * 0.5)
                strays.append((path, thick * 1.4))
        else:
            raise ValueError(f"no such fault: {kind}")
        return vertices, keep, strays

    def _lifted(
        self, vertices: np.ndarray, born: np.ndarray, layer: int, low: np.ndarray, high: np.ndarray
    ) -> np.ndarray:
        """A corner that rises: what is laid later is pressed flat by the nozzle, so only older matter is lifted."""
        fault, d = self.fault, self.fault.draws
        corner = np.where(d[:2] < 0.5, low[:2], high[:2])
        reach = 0.75 * np.hypot(*(high - low)[:2])

        def lift(at: np.ndarray) -> np.ndarray:
            return fault.size * (2.0 + 4.0 * d[2]) * (1 - np.exp(-np.maximum(at - fault.onset + 1, 0) / 5.0))

        rise = lift(np.array(float(layer))) - lift(born.astype(float))
        near = np.clip(1 - np.hypot(*(vertices[..., :2] - corner).transpose(2, 0, 1)) / reach, 0, 1) ** 1.7
        vertices = vertices.copy()
        vertices[..., 2] += near * rise[:, None]
        return vertices

    def _fallen(self, layer: int, middle: np.ndarray, spread: np.ndarray, floor_mm: float) -> list:
        fault, out = self.fault, []
        radius = float(np.clip(np.mean(spread) * 0.45, 4, 22))
        for number in range(min(layer - fault.onset + 1, 14)):
            rng = fault.rng(5, number)
            at = middle + np.array([*rng.normal(0, radius * 0.35, 2), 0.0])
            metres = (0.25 + 0.5 * rng.random()) * fault.size
            out.append((tangle(rng, at, radius * (0.6 + 0.5 * rng.random()), metres, floor_mm + 0.4 * number), 0.4))
        return out
