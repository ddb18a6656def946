"""From beads and what was said about them to layers, widths, heights, roles and objects: the second half of reading."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from .dialects import LABEL_SYSTEMS
from .interpreter import Changes, Labels, Said
from .toolpath import NO_OBJECT, Role

SAME_HEIGHT_MM = 0.02  # heights nearer than this are one print height
STEEPEST_SPIRAL = 0.5  # rise over run: a bead that climbs more steeply moves to another height, it is no vase
WIDEST_NOZZLES, NARROWEST_NOZZLES = 3.0, 0.5  # a bead's width, in nozzles
HIGHEST_NOZZLES, LOWEST_MM = 1.25, 0.04  # a bead's height


def held(changes: Changes, count: int, unsaid: float) -> np.ndarray:
    """(count,) float32: the value that holds for each bead, `unsaid` before the first change."""
    at = np.frombuffer(changes.bead, dtype=np.int64) if changes.bead else np.zeros(0, np.int64)
    values = np.frombuffer(changes.value, dtype=np.float64) if changes.value else np.zeros(0)
    lengths = np.diff(np.concatenate([[0], np.minimum(at, count), [count]]))
    return np.repeat(np.concatenate([[unsaid], values]).astype(np.float32), lengths)


def layer_starts(path: np.ndarray, said: Said) -> np.ndarray:
    """(L + 1,) int64: index of each layer's first bead, then the number of beads.

    The kind of layer comment that divides the print most finely decides; without any, the print's heights do.
    What is laid before the first comment belongs to the first layer.
    """
    count = len(path)
    best = np.zeros(0, np.int64)
    for marks in said.layers.values():
        starts = np.unique(np.frombuffer(marks, dtype=np.int64))
        starts = starts[starts < count]
        if len(starts) > len(best):
            best = starts
    if len(best):
        best[0] = 0
        return np.append(best, count)
    return np.append(starts_by_height(path), count)


def starts_by_height(path: np.ndarray) -> np.ndarray:
    """Index of the first bead at each new print height; in a spiral, of the first bead of each turn.

    path : (N, 6) x0 y0 z0 x1 y1 z1. Heights that are only travelled through (z-hops) are none.

    The turns of a spiral are told by its tangent, which turns by 2π in one round of any simple closed curve.
    """
    if not len(path):
        return np.zeros(0, np.int64)
    z0, z1 = path[:, 2].astype(np.float64), path[:, 5].astype(np.float64)
    run = np.hypot(path[:, 3] - path[:, 0], path[:, 4] - path[:, 1])
    rise = z1 - z0
    steep = np.abs(rise) > np.maximum(run * STEEPEST_SPIRAL, SAME_HEIGHT_MM)
    jump = np.empty(len(path), bool)
    jump[0] = True
    jump[1:] = (np.abs(z0[1:] - z1[:-1]) > SAME_HEIGHT_MM) | steep[1:]
    runs = np.flatnonzero(jump)
    ends = np.append(runs[1:], len(path))
    starts: list[np.ndarray] = []
    level: float | None = None
    for first, end in zip(runs.tolist(), ends.tolist()):
        if abs(z1[end - 1] - z0[first]) > SAME_HEIGHT_MM and not steep[first] and end - first > 2:
            starts.append(first + _turns(path[first:end]))
            level = float(z1[end - 1])
        elif level is None or abs(z1[first] - level) > SAME_HEIGHT_MM:
            starts.append(np.array([first]))
            level = float(z1[first])
    return np.concatenate(starts).astype(np.int64)


def _turns(path: np.ndarray) -> np.ndarray:
    """Index of the first bead of each round of a spiral."""
    heading = np.arctan2(path[:, 4] - path[:, 1], path[:, 3] - path[:, 0]).astype(np.float64)
    turned = np.diff(heading)
    turned = np.abs(np.cumsum((turned + math.pi) % (2.0 * math.pi) - math.pi))
    rounds = np.floor(np.maximum.accumulate(turned) / (2.0 * math.pi) + 1e-6).astype(np.int64)
    return np.concatenate([[0], 1 + np.flatnonzero(np.diff(rounds, prepend=0))])


def layer_heights(path: np.ndarray, starts: np.ndarray) -> np.ndarray:
    """(L,) float32: the height at which most of a layer is laid; in a spiral the highest."""
    z = path[:, 5]
    low, high = np.minimum.reduceat(z, starts[:-1]), np.maximum.reduceat(z, starts[:-1])
    heights = high.astype(np.float32)
    for i in np.flatnonzero(high - low > 1e-4):
        part = path[starts[i] : starts[i + 1]]
        length = np.hypot(part[:, 3] - part[:, 0], part[:, 4] - part[:, 1])
        levels, which = np.unique(np.round(part[:, 5], 3), return_inverse=True)
        shares = np.bincount(which.ravel(), weights=length)
        if shares.max() >= 0.25 * shares.sum():
            heights[i] = levels[shares.argmax()]
    return heights


def layer_steps(heights_mm: np.ndarray, usual_mm: float | None, nozzle_mm: float) -> np.ndarray:
    """(L,) float32: how far each layer lies above what is under it, for beads whose height no comment tells."""
    tallest = HIGHEST_NOZZLES * nozzle_mm
    below = np.concatenate([[0.0], heights_mm[:-1]])
    steps = heights_mm - below
    for i in np.flatnonzero(steps < -SAME_HEIGHT_MM):  # the next object of a sequential print starts on the bed
        under = heights_mm[:i][heights_mm[:i] < heights_mm[i] - SAME_HEIGHT_MM]
        steps[i] = heights_mm[i] - under.max() if len(under) else heights_mm[i]
    sane = (steps > SAME_HEIGHT_MM) & (steps <= tallest)
    if usual_mm is None or not LOWEST_MM <= usual_mm <= tallest:
        usual_mm = float(np.median(steps[sane])) if sane.any() else 0.5 * nozzle_mm
    return np.where(sane, steps, min(max(usual_mm, LOWEST_MM), tallest)).astype(np.float32)


def widths_and_heights(
    path: np.ndarray,
    area_mm2: np.ndarray,
    width_mm: np.ndarray,
    height_mm: np.ndarray,
    step_mm: np.ndarray,
    nozzle_mm: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Width and height of each bead, (N,) float32: as said, where it was said; else from the extruded volume.

    The cross-section is a rectangle with round sides, A = h (w - h) + π h²/4, so w = A/h + h (1 - π/4).

    area_mm2 : (N,) volume over length. step_mm : (N,) height where none was said
    """
    height = np.where(height_mm > 0.0, height_mm, step_mm)
    height = np.clip(height, LOWEST_MM, 2.0 * HIGHEST_NOZZLES * nozzle_mm)
    by_volume = area_mm2 / height + height * (1.0 - math.pi / 4.0)
    by_volume = np.clip(by_volume, NARROWEST_NOZZLES * nozzle_mm, WIDEST_NOZZLES * nozzle_mm)
    width = np.where(width_mm > 0.0, np.clip(width_mm, 0.05, 4.0 * WIDEST_NOZZLES * nozzle_mm), by_volume)
    return width.astype(np.float32), height.astype(np.float32)


@dataclass(frozen=True, eq=False)
class Objects:
    """Which bead belongs to which object.

    object_id       : (N,) int16
    names           : in order of appearance, only of objects that print something
    cancelled       : see Toolpath
    cancel_commands : see Toolpath
    """

    object_id: np.ndarray
    names: tuple[str, ...]
    cancelled: tuple[tuple[int, int], ...]
    cancel_commands: tuple[str, ...]


def find_objects(said: Said, count: int) -> Objects:
    """The objects as one of the file's systems of labels tells them, see LABEL_SYSTEMS."""
    labels = dict(said.labels)
    if said.m486_names and "m486" in labels:
        labels["m486_named"] = labels["m486"]
    for system in LABEL_SYSTEMS:
        if system in labels:
            ids, kept = _printed(labels[system], count)
            if kept:
                break
    else:
        return Objects(np.full(count, NO_OBJECT, np.int16), (), (), ())
    original = list(labels[system].names)
    names = [_object_name(system, original[k], said) for k in kept]
    commands = tuple(_cancel_commands(system, [original[k] for k in kept], ids, labels))
    cancelled: dict[int, int] = {}
    for spoken_by, name, position in said.cancelled:
        command = _cancel_command(spoken_by, name or "")
        if command in commands:
            cancelled.setdefault(commands.index(command), position)
    return Objects(ids, tuple(names), tuple(sorted(cancelled.items())), commands)


def _printed(labels: Labels, count: int) -> tuple[np.ndarray, list[int]]:
    """Object of each bead, renumbered over the objects that have beads; and which those are."""
    ids = held(labels.changes, count, NO_OBJECT).astype(np.int64)
    seen = np.bincount(ids + 1, minlength=len(labels.names) + 1)[1:]
    kept = np.flatnonzero(seen).tolist()
    renumbered = np.full(len(labels.names) + 1, NO_OBJECT, np.int16)
    renumbered[kept] = np.arange(len(kept))
    return renumbered[ids], kept  # index -1 is the last entry: NO_OBJECT


def _object_name(system: str, name: str, said: Said) -> str:
    if system in ("m486", "m486_named"):
        return said.m486_names.get(int(name), f"object {name}")
    return name


def _cancel_command(system: str, name: str) -> str:
    if system == "exclude_object":
        return f"EXCLUDE_OBJECT NAME={name}"
    if system in ("m486", "m486_named"):
        return f"M486 P{name}"
    return ""


def _cancel_commands(system: str, names: list[str], ids: np.ndarray, labels: dict[str, Labels]) -> list[str]:
    """What the firmware must be told to skip each object; "" where the file holds no labels that it understands."""
    if system in ("exclude_object", "m486_named", "m486"):
        return [_cancel_command(system, name) for name in names]
    for spoken in ("exclude_object", "m486"):
        if spoken in labels:
            other = held(labels[spoken].changes, len(ids), NO_OBJECT).astype(np.int64)
            known = list(labels[spoken].names)
            commands = []
            for k in range(len(names)):
                shared = other[(ids == k) & (other >= 0)]
                commands.append(
                    _cancel_command(spoken, known[int(np.bincount(shared).argmax())]) if len(shared) else ""
                )
            return commands
    return [""] * len(names)


def said_or_first(role: np.ndarray, said: Said, first_mark: int) -> np.ndarray:
    """(N,) uint8. What is laid before the first layer comment and has no role yet is a prime line."""
    role = role.copy()
    role[:first_mark][role[:first_mark] < 0] = Role.TOWER
    role[role < 0] = Role.OUTER
    return role.astype(np.uint8)
