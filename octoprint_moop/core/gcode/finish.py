"""The second half of reading: what was laid and what was said, put together into a Toolpath, block by block."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from ..toolpath import NO_OBJECT, Role, Toolpath
from .counting import counting
from .interpreter import Interpreter
from .labels import find_objects
from .layers import Held, layer_ends, layer_parks, layer_shapes, layer_starts, layer_steps, step_of, widths_and_heights
from .said import NOT_SAID
from .store import Column


def assemble(
    machine: Interpreter,
    beads: Column,
    end_pos: Column,
    size: int,
    nozzle_mm: float,
    filament_mm: float,
    folder: Path | None,
) -> Toolpath:
    """Layers, widths and objects of what the machine laid. The beads' last two columns are replaced in place.

    beads : as from Interpreter.take. filament_mm : diameter, where the file does not tell it
    """
    said, count = machine.said, len(beads)
    starts = layer_starts(beads, said)
    heights, low, high = layer_shapes(beads, starts)
    steps = layer_steps(heights, said.setting("layer_height_mm"), nozzle_mm)

    diameter = machine.filament_mm or said.setting("filament_mm") or filament_mm
    volumetric = said.setting("volumetric_e") == 1.0 and not machine.filament_mm
    filament_mm2 = math.pi / 4.0 * diameter**2
    mm3 = 1.0 if volumetric else filament_mm2

    widths, bead_heights, roles = (Held(changes, NOT_SAID) for changes in (said.width, said.height, said.role))
    objects = find_objects(said, count)
    first_mark = min((marks[0] for marks in said.layers.values()), default=0)
    role = Column("<u1", 1, folder and folder / "role.npy")
    object_id = Column("<i2", 1, folder and folder / "object_id.npy")
    for first, last in beads.blocks():
        block = beads.read(first, last)
        dx, dy, dz = (block[:, 3 + i] - block[:, i] for i in range(3))
        length = np.sqrt(dx * dx + dy * dy + dz * dz)
        area = block[:, 6] * mm3 / np.maximum(length, 1e-4)
        step = step_of(block[:, 5], first, starts, steps, nozzle_mm)
        block[:, 6], block[:, 7] = widths_and_heights(
            area, widths.of(first, last), bead_heights.of(first, last), step, nozzle_mm
        )
        beads.write(first, block)
        part = roles.of(first, last)
        # What is laid before the first layer comment and has no role yet is a prime line.
        part[(part < 0) & (np.arange(first, last) < first_mark)] = Role.TOWER
        role.append(np.where(part < 0, Role.OUTER, part))
        object_id.append(objects.ids.of(first, last) if objects.ids else np.full(last - first, NO_OBJECT))
    ends = layer_parks(layer_ends(end_pos, starts, machine.tails), starts, low, high, machine.travels)
    used_mm, own_mm = filament_used_mm(machine, filament_mm2 if volumetric else 1.0)
    return Toolpath(
        beads_mm=beads.done(),
        end_pos=end_pos.done(),
        layer_start=starts,
        layer_end_pos=ends,
        layer_z_mm=heights,
        role=role.done(),
        object_id=object_id.done(),
        objects=objects.names,
        cancelled=objects.cancelled,
        cancel_commands=objects.cancel_commands,
        slicer=said.slicer,
        filament_mm=used_mm,
        filament_own_mm=own_mm,
        bytes=size,
        notes=notes(machine),
    )


def filament_used_mm(machine: Interpreter, divisor: float) -> tuple[float, float]:
    """Filament used, net of retraction, counted as the file's slicer counts; and what the user's own G-code feeds."""
    used, own = sum(machine.most_fed.values()) / divisor, machine.fed_by_own_gcode_mm() / divisor
    way = counting(machine.said.slicer)
    compensation = (machine.said.setting("compensation_percent") or 100.0) / 100.0
    return (used if way.own_gcode else used - own) * compensation**way.compensations, own


def notes(machine: Interpreter) -> tuple[str, ...]:
    """Sentences for the user about what was not understood."""
    said = []
    if machine.skipped:
        said.append(f"{machine.skipped} moves make no sense (damaged numbers, or an arc without a centre).")
    if machine.coarse:
        said.append(f"{machine.coarse} arcs are drawn coarsely: the file has more of them than the memory should hold.")
    if machine.unknown:
        words = ", ".join(word for word, _ in machine.unknown.most_common(5))
        said.append(
            f"{sum(machine.unknown.values())} commands are not known here ({words}): "
            "whatever they move or extrude is missing from the expected picture."
        )
    return tuple(said)
