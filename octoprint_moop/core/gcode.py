"""G-code to Toolpath."""

from __future__ import annotations

import gzip
import io
import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, Callable, cast

import numpy as np

from .errors import GcodeError
from .interpreter import NOT_SAID, Interpreter
from .layers import (
    HIGHEST_NOZZLES,
    LOWEST_MM,
    find_objects,
    held,
    layer_heights,
    layer_starts,
    layer_steps,
    said_or_first,
    widths_and_heights,
)
from .toolpath import Toolpath

CHUNK_BYTES = 1 << 20
HEAD_BYTES = 1 << 18
LEAST_E_VALUES = 8  # fewer extruding moves do not tell absolute from relative E
PARK_MM = 20.0  # a head this far beyond a layer does not stand before it
_E_MODE = re.compile(
    rb"^[ \t]*(?:(M0*8[23]\b|G0*92\b)|G0*[123][ \t][^;\r\n]*?[XY][^;\r\n]*?E[ \t]*(\d+\.?\d*|\.\d+))",
    re.MULTILINE | re.IGNORECASE,
)
BOM = b"\xef\xbb\xbf"

Progress = Callable[[float], None]


def read_gcode(
    path: str | Path,
    *,
    cache_dir: str | Path | None = None,
    nozzle_mm: float = 0.4,
    filament_mm: float = 1.75,
    progress: Progress | None = None,
) -> Toolpath:
    """What a G-code file lays down.

    path        : plain or gzipped; positions count in the unpacked file
    nozzle_mm   : bounds the widths that the extruded volume tells
    filament_mm : diameter, where the file itself does not tell it
    progress    : called with the ratio done, 0 to 1

    Raises GcodeError where the file is missing, empty, binary, or extrudes nothing.
    """
    path = Path(path)
    try:
        size = path.stat().st_size
        with open(path, "rb") as raw:
            packed = raw.read(2) == b"\x1f\x8b"
        with gzip.open(path, "rb") if packed else open(path, "rb") as file:
            return read_stream(cast(BinaryIO, file), path.name, nozzle_mm, filament_mm, size, progress)
    except FileNotFoundError:
        raise GcodeError(f"There is no file {path}. Check the name.") from None
    except (OSError, EOFError) as error:
        raise GcodeError(f"{path} cannot be read ({error}). Upload it again.") from None


def read_gcode_bytes(data: bytes, name: str = "the G-code", **settings: float) -> Toolpath:
    """The same for G-code in memory. Raises GcodeError."""
    return read_stream(io.BytesIO(data), name, settings.get("nozzle_mm", 0.4), settings.get("filament_mm", 1.75))


def lines_with_ends(file: BinaryIO) -> Iterator[tuple[str, int]]:
    """Each line, and its end as OctoPrint counts: in a lossy UTF-8 decoding, encoded again.

    A carriage return alone ends a line, too.
    """
    position, rest, first = 0, b"", True
    while True:
        data = file.read(CHUNK_BYTES)
        if first and data.startswith(BOM):
            data, position = data[3:], 3
        first = False
        block = rest + data
        lines = block.splitlines(keepends=True) if data else ([block] if block else [])
        rest = b""
        if data and lines and not lines[-1].endswith(b"\n"):
            rest = lines.pop()
        for raw in lines:
            try:
                line = raw.decode("utf-8")
                position += len(raw)
            except UnicodeDecodeError:
                line = raw.decode("utf-8", "replace")
                position += len(line.encode("utf-8"))
            yield line, position
        if not data:
            return


def read_stream(
    file: BinaryIO,
    name: str,
    nozzle_mm: float = 0.4,
    filament_mm: float = 1.75,
    size: int = 0,
    progress: Progress | None = None,
) -> Toolpath:
    """The Toolpath of an open binary file that can seek. `size` is its length, for the progress. Raises GcodeError."""
    head = file.read(HEAD_BYTES)
    refuse_what_is_no_gcode(head, name)
    file.seek(0)
    machine = Interpreter(relative_e=looks_relative(head))
    position = 0
    for number, (line, position) in enumerate(lines_with_ends(file)):
        machine.run(line, position)
        if progress is not None and size and number % 10000 == 0:
            progress(min(position / size, 1.0))
    return assemble(machine, name, position, nozzle_mm, filament_mm)


def refuse_what_is_no_gcode(head: bytes, name: str) -> None:
    """Raises GcodeError with a sentence that says what the file is instead."""
    if not head:
        raise GcodeError(f"{name} is empty. Slice or upload it again.")
    if head.startswith(b"GCDE"):
        raise GcodeError(
            f"{name} is binary G-code. Switch binary G-code off in the slicer's printer settings and export again."
        )
    if head.startswith(b"PK"):
        raise GcodeError(f"{name} is a zip archive (a project?). Export plain G-code from the slicer.")
    if b"\0" in head:
        raise GcodeError(f"{name} is not a text file, so it is no G-code. Choose the file that the slicer exported.")


def looks_relative(head: bytes) -> bool:
    """Whether a file that never says M82 or M83 before it extrudes means relative E (set by a start macro).

    In absolute mode E grows from one extruding move to the next; relative amounts go up and down.
    """
    previous: float | None = None
    smaller = total = 0
    for command, value in _E_MODE.findall(head):
        if command:
            if total < LEAST_E_VALUES and command.upper() != b"G92":
                return False
            previous = None
            continue
        e = float(value)
        if e <= 0.0:
            continue
        if previous is not None:
            total, smaller = total + 1, smaller + (e < previous)
        previous = e
    return total >= LEAST_E_VALUES and smaller > 0.2 * total


def assemble(machine: Interpreter, name: str, size: int, nozzle_mm: float, filament_mm: float) -> Toolpath:
    """Layers, widths and objects of what the machine laid. Raises GcodeError where that is nothing."""
    said, count = machine.said, len(machine.beads)
    if not count:
        raise GcodeError(f"{name} extrudes nothing, so there is nothing to compare with. Is it a printable file?")
    columns = np.frombuffer(machine.beads.path, dtype=np.float32).reshape(-1, 7)
    path, fed = columns[:, :6], columns[:, 6]
    end_pos = np.frombuffer(machine.beads.end_pos, dtype=np.int64)

    starts = layer_starts(path, said)
    heights = layer_heights(path, starts)
    steps = layer_steps(heights, said.declared.get("layer_height_mm"), nozzle_mm)
    layer = np.repeat(np.arange(len(heights)), np.diff(starts))

    diameter = machine.filament_mm or said.declared.get("filament_mm") or filament_mm
    always_volumetric = said.declared.get("volumetric_e") == 1.0 and not machine.filament_mm
    filament_mm2 = math.pi / 4.0 * diameter**2
    length = np.sqrt(((path[:, 3:] - path[:, :3]) ** 2).sum(axis=1))
    area = fed * (1.0 if always_volumetric else filament_mm2) / np.maximum(length, 1e-4)
    step = np.where(layer == 0, np.clip(path[:, 5], LOWEST_MM, HIGHEST_NOZZLES * nozzle_mm), steps[layer])
    width, height = widths_and_heights(
        path, area, held(said.width, count, NOT_SAID), held(said.height, count, NOT_SAID), step, nozzle_mm
    )
    marks = [marks[0] for marks in said.layers.values()]
    objects = find_objects(said, count)
    filament = sum(machine.most_fed.values())
    return Toolpath(
        beads_mm=np.column_stack([path, width, height]),
        end_pos=end_pos,
        layer_start=starts,
        layer_end_pos=layer_parks(path, starts, layer_ends(end_pos, starts, machine.tails), machine.travels),
        layer_z_mm=heights,
        role=said_or_first(held(said.role, count, NOT_SAID), said, min(marks, default=0)),
        object_id=objects.object_id,
        objects=objects.names,
        cancelled=objects.cancelled,
        cancel_commands=objects.cancel_commands,
        slicer=said.slicer,
        filament_mm=filament / filament_mm2 if always_volumetric else filament,
        bytes=size,
        notes=notes(machine),
    )


def layer_ends(end_pos: np.ndarray, starts: np.ndarray, tails: tuple) -> np.ndarray:
    """(L,) int64: end of each layer's last bead, or of the retraction that directly follows it."""
    last = starts[1:] - 1
    ends = end_pos[last].copy()
    if len(tails[0]):
        beads, positions = (np.frombuffer(tail, dtype=np.int64) for tail in tails)
        found = np.minimum(np.searchsorted(beads, last), len(beads) - 1)
        hit = beads[found] == last
        ends[hit] = positions[found[hit]]
    return ends


def layer_parks(path: np.ndarray, starts: np.ndarray, ends: np.ndarray, travels: tuple) -> np.ndarray:
    """(L,) int64: `ends`, moved on to where the file itself parks the head before the next layer.

    A park is a travel from one layer to the next that goes PARK_MM or more beyond both, in X or in Y: a slicer's
    layer change G-code, put there so that a camera sees the print. Of several the farthest counts.
    """
    bead, end_pos, x, y = (np.frombuffer(column, dtype=column.typecode) for column in travels)
    found = ends.copy()
    if not len(bead):
        return found
    corners = path[:, [0, 1, 3, 4]].reshape(-1, 4)
    low = np.minimum.reduceat(np.minimum(corners[:, :2], corners[:, 2:]), starts[:-1])
    high = np.maximum.reduceat(np.maximum(corners[:, :2], corners[:, 2:]), starts[:-1])
    place = np.column_stack([x, y])
    for layer in range(len(ends)):
        first, after = np.searchsorted(bead, [starts[layer + 1] - 1, starts[layer + 1]])
        if first == after:
            continue
        both = slice(layer, layer + 2)
        beyond = np.maximum(low[both].min(axis=0) - place[first:after], place[first:after] - high[both].max(axis=0))
        farthest = int(beyond.max(axis=1).argmax())
        if beyond[farthest].max() >= PARK_MM:
            found[layer] = max(found[layer], end_pos[first + farthest])
    return found


def notes(machine: Interpreter) -> tuple[str, ...]:
    """Sentences for the user about what was not understood."""
    said = []
    if machine.skipped:
        said.append(f"{machine.skipped} moves make no sense (damaged numbers, or an arc without a centre).")
    if machine.unknown:
        words = ", ".join(word for word, _ in machine.unknown.most_common(5))
        said.append(
            f"{sum(machine.unknown.values())} commands are not known here ({words}): "
            "whatever they move or extrude is missing from the expected picture."
        )
    return tuple(said)
