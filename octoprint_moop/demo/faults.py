"""What becomes of the beads of a print when something goes wrong: where they really lie."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from ..core.toolpath import NO_OBJECT, Toolpath

KINDS = ("extrusion_stop", "detachment", "warping", "layer_shift", "spaghetti")
STRAND_WIDTH_MM = 0.45


@dataclass(frozen=True)
class Fault:
    """Something that goes wrong in the course of `layer` (0-based).

    kind      : one of KINDS
    object_id : index into the tool-path's objects; None for everything that is printed
    strength  : 1.0 is as on real machines: a detached part 9 mm off, corners that lift by 3 mm, 4 mm of shift
    """

    kind: str
    layer: int
    object_id: int | None = None
    strength: float = 1.0

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise ValueError(f"Unknown fault {self.kind!r}; known are {', '.join(KINDS)}.")


@dataclass(frozen=True, eq=False)
class Matter:
    """Everything that lies at one moment, in print coordinates (M strokes, in the order in which they were laid).

    ends_mm   : (M, 6) float64: x0 y0 z0 x1 y1 z1, z is the stroke's top
    size_mm   : (M, 2) float64: width, height
    bead      : (M,) int64: the bead of the tool-path that the stroke is made of
    unchanged : True where each stroke up to here lies, and will lie, where the G-code says
    """

    ends_mm: np.ndarray
    size_mm: np.ndarray
    bead: np.ndarray
    unchanged: bool

    def __len__(self) -> int:
        return len(self.bead)


def matter_at(toolpath: Toolpath, faults: tuple[Fault, ...], laid: int, seed: int) -> Matter:
    """What lies after the first `laid` beads of the tool-path, with these faults. The same for the same seed."""
    beads = np.asarray(toolpath.beads_mm[:laid], dtype=np.float64)
    index = np.arange(laid)
    matter = Matter(beads[:, :6].copy(), beads[:, 6:8].copy(), index, unchanged=True)
    for number, fault in enumerate(faults):
        onset = _onset(toolpath, fault)
        if laid <= onset:
            continue
        rng = np.random.default_rng([seed, number, KINDS.index(fault.kind)])
        mine = np.ones(laid, bool) if fault.object_id is None else toolpath.object_id[:laid] == fault.object_id
        if fault.kind in ("detachment", "warping") and fault.object_id is None:
            mine &= ~_skirt(toolpath, laid)  # a skirt is no part of what comes off
        matter = _APPLY[fault.kind](toolpath, matter, fault, onset, mine, rng)
    return matter


def _onset(toolpath: Toolpath, fault: Fault) -> int:
    """The first bead that the fault spoils: a fifth into its layer."""
    layer = min(max(fault.layer, 0), toolpath.layers - 1)
    start, end = int(toolpath.layer_start[layer]), int(toolpath.layer_start[layer + 1])
    return start + (end - start) // 5


def _skirt(toolpath: Toolpath, laid: int) -> np.ndarray:
    labelled = toolpath.object_id[:laid] != NO_OBJECT
    return ~labelled if labelled.any() else np.zeros(laid, bool)


def _keep(matter: Matter, keep: np.ndarray) -> Matter:
    return Matter(matter.ends_mm[keep], matter.size_mm[keep], matter.bead[keep], unchanged=False)


def _extrusion_stop(
    toolpath: Toolpath, matter: Matter, fault: Fault, onset: int, mine: np.ndarray, rng: np.random.Generator
) -> Matter:
    # The last filament comes thin and in pieces before nothing comes at all.
    dying = mine[matter.bead] & (matter.bead >= onset) & (matter.bead < onset + 30) & (rng.random(len(matter)) < 0.4)
    matter.size_mm[dying] *= 0.6
    return _keep(matter, ~(mine[matter.bead] & (matter.bead >= onset)) | dying)


def _layer_shift(
    toolpath: Toolpath, matter: Matter, fault: Fault, onset: int, mine: np.ndarray, rng: np.random.Generator
) -> Matter:
    angle = rng.choice([0.0, np.pi / 2, np.pi, 1.5 * np.pi])  # one motor loses its steps
    shift = 4.0 * fault.strength * rng.uniform(0.8, 1.2) * np.array([np.cos(angle), np.sin(angle), 0.0])
    after = mine[matter.bead] & (matter.bead >= onset)
    matter.ends_mm[after] += np.tile(shift, 2)
    return replace(matter, unchanged=False)


def _warping(
    toolpath: Toolpath, matter: Matter, fault: Fault, onset: int, mine: np.ndarray, rng: np.random.Generator
) -> Matter:
    """Corners rise with every layer; what is laid on them later is squashed to where the nozzle passes."""
    laid = int(matter.bead[-1]) + 1
    here = mine[matter.bead]
    for object_id in np.unique(toolpath.object_id[matter.bead[here]]):
        part = here & (toolpath.object_id[matter.bead] == object_id)
        ends = matter.ends_mm[part]
        xy = np.concatenate([ends[:, :2], ends[:, 3:5]])
        low, high = xy.min(axis=0), xy.max(axis=0)
        centre, half = (low + high) / 2, np.maximum((high - low) / 2, 1.0)
        sides = rng.permutation(np.array([[-1, -1], [1, -1], [-1, 1], [1, 1]]))[:2]
        growth = [_ramp(toolpath, fault, bead) for bead in (laid - 1, *matter.bead[part])]
        lift_mm = 3.0 * fault.strength * (growth[0] - np.array(growth[1:]))
        # Only what lay low when the corner came up has room to rise: the nozzle keeps the top where it belongs.
        for column in (0, 3):
            reach = np.zeros(len(ends))
            for side in sides:
                along = (ends[:, column : column + 2] - centre) / half * side / 2
                reach = np.maximum(reach, np.clip(along.sum(axis=1), 0, 1))
            ends[:, column + 2] += lift_mm * reach**2
            ends[:, column : column + 2] -= (
                0.25 * (lift_mm * reach**2)[:, None] * np.sign(ends[:, column : column + 2] - centre)
            )
        matter.ends_mm[part] = ends
    return replace(matter, unchanged=False)


def _ramp(toolpath: Toolpath, fault: Fault, bead: int) -> float:
    """How far the corner has come up when `bead` is laid: 0 at the onset, 1 in the end.

    The bond to the bed breaks at once, and what pulls at the corner gets less as it gives way.
    """
    layer = int(np.searchsorted(toolpath.layer_start, bead, side="right")) - 1
    start, end = toolpath.layer_start[layer : layer + 2]
    layers = max(layer + (bead - start) / max(end - start, 1) - fault.layer, 0.0)
    return 1.0 - math.exp(-layers / 4)


def _detachment(
    toolpath: Toolpath, matter: Matter, fault: Fault, onset: int, mine: np.ndarray, rng: np.random.Generator
) -> Matter:
    loose = mine[matter.bead] & (matter.bead < onset)
    ends = matter.ends_mm
    if loose.any():
        centre = ends[loose][:, [0, 1, 3, 4]].reshape(-1, 2).mean(axis=0)
        direction = rng.uniform(0, 2 * np.pi)
        move = 9.0 * fault.strength * rng.uniform(0.7, 1.3) * np.array([np.cos(direction), np.sin(direction)])
        turn = np.radians(rng.choice([-1, 1]) * rng.uniform(8, 30)) * fault.strength
        rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        for column in (0, 3):
            ends[loose, column : column + 2] = (ends[loose, column : column + 2] - centre) @ rotation.T + centre + move
    return _with_strands(toolpath, matter, mine, onset, rng, foot_z_mm=0.0)


def _spaghetti(
    toolpath: Toolpath, matter: Matter, fault: Fault, onset: int, mine: np.ndarray, rng: np.random.Generator
) -> Matter:
    return _with_strands(toolpath, matter, mine, onset, rng, foot_z_mm=float(toolpath.beads_mm[onset, 2]))


def _with_strands(
    toolpath: Toolpath, matter: Matter, mine: np.ndarray, onset: int, rng: np.random.Generator, foot_z_mm: float
) -> Matter:
    """What is laid from `onset` on finds nothing to stick to: it curls and piles up where the nozzle passes.

    foot_z_mm : the height of what the strands fall on under the nozzle; beside it they hang down to the bed
    """
    lost = mine[matter.bead] & (matter.bead >= onset)
    kept = _keep(matter, ~lost)
    if not lost.any():
        return kept
    ends = matter.ends_mm[lost]
    length_mm = np.linalg.norm(ends[:, 3:5] - ends[:, :2], axis=1)
    step_mm = 0.8
    travelled = np.concatenate([[0.0], np.cumsum(length_mm)])
    # One random curve for the whole print, read up to where it has come: it grows at its end and never moves.
    rest = toolpath.beads_mm[onset:]
    whole = float(np.hypot(rest[:, 3] - rest[:, 0], rest[:, 4] - rest[:, 1]).sum())
    count = min(int(whole / step_mm) + 2, 20000)
    radius = np.clip(3.0 + np.cumsum(rng.normal(0, 0.25, count)) % 5.0, 1.2, 8.0)
    angle = np.cumsum(rng.choice([-1, 1], count // 60 + 1).repeat(60)[:count] * step_mm / radius)
    wander = np.stack([np.cumsum(rng.normal(0, 0.12, count)) for _ in range(3)], axis=1)
    wander[:, :2] = 4.0 * np.tanh(wander[:, :2] / 4.0)
    now = min(int(travelled[-1] / step_mm) + 1, count - 1)
    at = np.minimum(np.arange(now + 1) * step_mm, travelled[-1])
    bead = np.minimum(np.searchsorted(travelled, at, side="right") - 1, len(ends) - 1)
    nozzle = ends[bead, :2] + (ends[bead, 3:5] - ends[bead, :2]) * (
        (at - travelled[bead]) / np.maximum(length_mm[bead], 1e-6)
    )[:, None].clip(0, 1)
    smooth = _low_pass(nozzle, 0.04)
    curl = radius[: now + 1, None] * np.stack([np.cos(angle[: now + 1]), np.sin(angle[: now + 1])], axis=1)
    xy = smooth + curl + wander[: now + 1, :2]
    pile_mm = 7.0 * (1 - np.exp(-at / 2500.0)) + 0.4
    z = STRAND_WIDTH_MM + pile_mm * (0.5 + 0.5 * np.sin(wander[: now + 1, 2]))
    beside = np.linalg.norm(xy - smooth, axis=1) > 5.0
    z = np.where(beside, z + 0.3 * foot_z_mm, z + foot_z_mm)
    points = np.column_stack([xy, _low_pass(z[:, None], 0.25)])
    strands = np.hstack([points[:-1], points[1:]])
    return Matter(
        np.vstack([kept.ends_mm, strands]),
        np.vstack([kept.size_mm, np.full((len(strands), 2), STRAND_WIDTH_MM)]),
        np.concatenate([kept.bead, matter.bead[lost][bead[1:]]]),
        unchanged=False,
    )


def _low_pass(values: np.ndarray, share: float) -> np.ndarray:
    """(N, D): each row moves by `share` of the way towards its value."""
    out = np.empty_like(values)
    state = values[0]
    for row, value in enumerate(values):
        state = state + share * (value - state)
        out[row] = state
    return out


_APPLY = {
    "extrusion_stop": _extrusion_stop,
    "detachment": _detachment,
    "warping": _warping,
    "layer_shift": _layer_shift,
    "spaghetti": _spaghetti,
}
