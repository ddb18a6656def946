"""G-code to Toolpath: the road from bytes to beads.

    bytes ── rows (numpy) ── walk (numpy) ──┬── layers, widths, objects ── Toolpath
           └─ any other line ── interpreter ┘

Nearly all lines of a sliced file are plain moves; a run of them is executed at once. Everything else, and short runs
between two changes of mode, go through the interpreter line by line, which is the reference for what they mean.
"""

from __future__ import annotations

import gzip
import io
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import BinaryIO, Callable, Union, cast

import numpy as np

from ..errors import GcodeError
from ..toolpath import Toolpath
from .cache import Cache
from .finish import assemble
from .head import HEAD_BYTES, feeds_by_a, looks_relative, refuse_what_is_no_gcode
from .interpreter import Interpreter
from .remarks import Remark, remark_of, told_widths
from .rows import OTHER, Lines, split
from .store import Column
from .walk import Walk

CHUNK_BYTES = 1 << 19
LONGEST_LINE_BYTES = 1 << 20
SHORT_RUN = 24  # rows; for fewer the interpreter is quicker than numpy
BOM = b"\xef\xbb\xbf"

Progress = Callable[[float], None]
PathLike = Union[str, Path]


def read_gcode(
    path: PathLike,
    *,
    cache_dir: PathLike | None = None,
    nozzle_mm: float = 0.4,
    filament_mm: float = 1.75,
    progress: Progress | None = None,
) -> Toolpath:
    """What a G-code file lays down.

    path        : plain or gzipped; positions count in the unpacked file
    cache_dir   : what was read is kept there, under the hash of the content, and the arrays are mapped from it
    nozzle_mm   : bounds the widths that the extruded volume tells
    filament_mm : diameter, where the file itself does not tell it
    progress    : called with the ratio done, 0 to 1

    Raises GcodeError where the file is missing, empty, binary, or extrudes nothing.
    """
    path = Path(path)
    try:
        with _opened(path) as file:
            if cache_dir is None:
                return read_stream(file, path.name, nozzle_mm, filament_mm, path.stat().st_size, progress)
            cache = Cache(Path(cache_dir), file, (nozzle_mm, filament_mm))
            found = cache.load()
            if found is not None:
                return found
            with cache.building() as folder:
                toolpath = read_stream(file, path.name, nozzle_mm, filament_mm, path.stat().st_size, progress, folder)
                cache.keep(folder, toolpath)
            return cache.load() or toolpath
    except FileNotFoundError:
        raise GcodeError(f"There is no file {path}. Check the name.") from None
    except IsADirectoryError:
        raise GcodeError(f"{path} is a folder. Name the G-code file in it.") from None
    except (gzip.BadGzipFile, EOFError) as error:
        raise GcodeError(f"{path} cannot be unpacked ({error}). Upload it again.") from None
    except OSError as error:
        raise GcodeError(f"{path} cannot be read ({error.strerror or error}). Upload it again.") from None


def read_gcode_bytes(
    data: bytes, name: str = "the G-code", *, nozzle_mm: float = 0.4, filament_mm: float = 1.75
) -> Toolpath:
    """The same for G-code in memory. Raises GcodeError."""
    return read_stream(io.BytesIO(data), name, nozzle_mm, filament_mm)


def _opened(path: Path) -> BinaryIO:
    if path.is_fifo():  # which would be waited for, and can be read only once
        raise GcodeError(f"{path} is a pipe. Save the G-code as a file first.")
    with open(path, "rb") as raw:
        packed = raw.read(2) == b"\x1f\x8b"
    return cast(BinaryIO, gzip.open(path, "rb") if packed else open(path, "rb"))


def read_stream(
    file: BinaryIO,
    name: str,
    nozzle_mm: float = 0.4,
    filament_mm: float = 1.75,
    size: int = 0,
    progress: Progress | None = None,
    folder: Path | None = None,
) -> Toolpath:
    """The Toolpath of an open binary file that can seek; its columns are files in `folder`, if given.

    size : of the file, for the progress. Raises GcodeError.
    """
    file.seek(0)
    head = file.read(HEAD_BYTES)
    refuse_what_is_no_gcode(head, name)
    file.seek(0)
    extruder = "A" if feeds_by_a(head) else "E"
    reader = _Reader(
        Interpreter(looks_relative(head, extruder), extruder), len(BOM) if head.startswith(BOM) else 0, folder
    )
    for chunk, length in chunks(file, name):
        reader.read(chunk, length)
        if progress is not None and size:
            progress(min(reader.position / size, 1.0))
    if not reader.beads:
        raise GcodeError(f"{name} extrudes nothing, so there is nothing to compare with. Is it a printable file?")
    return assemble(reader.machine, reader.beads, reader.end_pos, reader.position, nozzle_mm, filament_mm, folder)


def chunks(file: BinaryIO, name: str) -> Iterator[tuple[bytes, int]]:
    """The file without its byte order mark, in pieces that end with a line: bytes, and how many of them it has.

    The last piece has a newline more where the file lacks it. Raises GcodeError where a line is too long to be one.
    """
    if file.read(len(BOM)) != BOM:
        file.seek(0)
    rest = b""
    while True:
        data = file.read(CHUNK_BYTES)
        if not data:
            break
        block = rest + data + file.readline(LONGEST_LINE_BYTES)
        cut = block.rfind(b"\n") + 1 or block.rfind(b"\r", 0, len(block) - 1) + 1
        rest = block[cut:]
        if len(rest) > LONGEST_LINE_BYTES:
            raise GcodeError(f"{name} has a line of more than {LONGEST_LINE_BYTES} bytes, so it is no G-code.")
        if cut:
            yield block[:cut], cut
    if rest:
        yield rest + b"\n", len(rest)


class _Reader:
    """Reads chunk after chunk. `position` is the file position reached, `beads` and `end_pos` grow."""

    def __init__(self, machine: Interpreter, position: int, folder: Path | None) -> None:
        self.machine, self.position = machine, position
        self.beads = Column("<f4", 8, folder and folder / "beads_mm.npy")
        self.end_pos = Column("<i8", 1, folder and folder / "end_pos.npy")

    def read(self, chunk: bytes, length: int) -> None:
        if b"\r" in chunk and b"\r\n" not in chunk:
            chunk = chunk.replace(b"\r", b"\n")
        if chunk.count(b"\r") != chunk.count(b"\r\n"):
            self._read_by_line(chunk, length)
        else:
            self._read_by_rows(chunk, length)
        self._keep_interpreted()

    def _read_by_line(self, chunk: bytes, length: int) -> None:
        """Some lines end in a carriage return alone, and some do not."""
        end, self.machine.read_bytes = 0, self.position + length
        for raw in chunk.splitlines(keepends=True):
            end += len(raw)
            self.position += len(raw) + _lengthened(raw) - max(0, end - length)
            self.machine.run(raw.decode("utf-8", "replace"), self.position)

    def _read_by_rows(self, chunk: bytes, length: int) -> None:
        run = _Chunk(chunk, length, self.position, self.machine.extruder)
        self.position = self.machine.read_bytes = run.end(-1)
        begin, heard, machine = 0, 0, self.machine
        own, (lines, remarks) = machine.own_gcode, run.remarks()
        for k, remark in enumerate(remarks):
            if remark.breaks_own if own else remark.breaks:
                self._run(run, begin, lines[k], lines[heard:k], remarks[heard:k])
                machine.run(run.text(lines[k]), run.end(lines[k]))
                begin, heard, own = lines[k] + 1, k + 1, machine.own_gcode
        self._run(run, begin, run.count, lines[heard:], remarks[heard:])

    def _run(self, run: _Chunk, begin: int, end: int, lines: list[int], remarks: list[Remark]) -> None:
        """Execute lines [begin, end), of which some `lines` are no rows but change no mode either: their `remarks`."""
        machine, first, last = self.machine, *run.rows(begin, end)
        width_lines, widths_mm = run.widths(begin, end)
        if last == first:
            run.interpret(machine, sorted(lines + width_lines.tolist()))
            return
        walk = None
        if last - first >= SHORT_RUN:
            walk = Walk(machine, run.lines, run.row_kind, first, last)
        if walk is None or not walk.sane:
            run.interpret(machine, range(begin, end))
            return
        self._keep_interpreted()
        laid, tail_open, stops, take = machine.laid, machine.tail_open, [], machine.said.take
        if len(width_lines):
            machine.said.width.extend(laid + walk.beads_upto[run.lines.rows_before[width_lines] - first], widths_mm)
        rows = run.lines.rows_before[np.array(lines, np.int64)] - first
        beads = laid + walk.beads_upto[rows]
        for i, remark, row, bead in zip(lines, remarks, rows.tolist(), beads.tolist()):
            if remark.meanings:
                take(remark.meanings, bead)
                continue
            if not remark.idle:
                machine.laid, machine.tail_open = bead, True
                machine.run(run.text(i), run.end(i))
            if remark.idle or not machine.tail_open:
                stops.append(row)
        machine.laid, machine.tail_open = laid, tail_open
        self.end_pos.append(walk.apply(run.row_ends[first:last], np.array(stops, np.int64)))
        self.beads.append(walk.path)

    def _keep_interpreted(self) -> None:
        path, end_pos = self.machine.take()
        self.beads.append(path)
        self.end_pos.append(end_pos)


class _Chunk:
    """A chunk's lines with their file positions."""

    def __init__(self, chunk: bytes, length: int, position: int, extruder: str) -> None:
        """length : how many bytes of the chunk the file has. position : where it begins, as OctoPrint counts"""
        self._chunk = chunk
        self.lines = split(chunk if extruder == "E" else chunk.upper().replace(extruder.encode(), b"E"))
        self.count = len(self.lines.end)
        self._ends = position + np.minimum(self.lines.end + 1, length) + _drift(chunk, self.lines)
        row = self.lines.kind != OTHER
        self.row_kind, self.row_ends = self.lines.kind[row], self._ends[row]
        others = np.flatnonzero(~row & (self.lines.end > self.lines.start))
        told, self._widths_mm = told_widths(chunk, self.lines, others)
        self._width_lines, self._others = others[told], others[~told]

    def remarks(self) -> tuple[list[int], list[Remark]]:
        """The lines that are no rows, tell no width, and do something: their numbers, and what they do."""
        starts, ends = self.lines.start[self._others].tolist(), self.lines.end[self._others].tolist()
        asked = map(remark_of, [self._chunk[start:end] for start, end in zip(starts, ends)])
        lines, found = [], []
        for i, remark in zip(self._others.tolist(), asked):
            if remark is not None:
                lines.append(i)
                found.append(remark)
        return lines, found

    def widths(self, begin: int, end: int) -> tuple[np.ndarray, np.ndarray]:
        """Of lines [begin, end): those that tell a width, and it; (n,) int64, (n,) float64, mm."""
        among = slice(*np.searchsorted(self._width_lines, (begin, end)))
        return self._width_lines[among], self._widths_mm[among]

    def text(self, line: int) -> str:
        return self._chunk[self.lines.start[line] : self.lines.end[line]].decode("utf-8", "replace")

    def end(self, line: int) -> int:
        return int(self._ends[line])

    def rows(self, begin: int, end: int) -> tuple[int, int]:
        return int(self.lines.rows_before[begin]), int(self.lines.rows_before[end])

    def interpret(self, machine: Interpreter, lines: Iterable[int]) -> None:
        for i in lines:
            machine.run(self.text(i), self.end(i))


def _lengthened(raw: bytes) -> int:
    """How many bytes longer a line is when OctoPrint has read it: what is no UTF-8 becomes U+FFFD, three bytes."""
    return len(raw.decode("utf-8", "replace").encode("utf-8")) - len(raw)


def _drift(chunk: bytes, lines: Lines) -> np.ndarray | int:
    """(n,) int64: by how much each line's end has moved, see `_lengthened`; 0 where all is UTF-8."""
    try:
        chunk.decode("utf-8")
    except UnicodeDecodeError:
        drift = np.zeros(len(lines.end), np.int64)
        strange = np.flatnonzero(np.frombuffer(chunk, np.uint8) > 127)
        for i in np.unique(np.searchsorted(lines.end, strange)).tolist():
            drift[i] = _lengthened(chunk[lines.start[i] : lines.end[i]])
        return np.cumsum(drift)
    return 0
