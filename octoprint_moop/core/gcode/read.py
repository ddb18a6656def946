"""G-code to Toolpath: the road from bytes to beads.

    bytes ── rows (numpy) ── walk (numpy) ──┬── layers, widths, objects ── Toolpath
           └─ any other line ── interpreter ┘

Nearly all lines of a sliced file are plain moves; a run of them is executed at once. Everything else, and short runs
between two changes of mode, go through the interpreter line by line, which is the reference for what they mean.
"""

from __future__ import annotations

import gzip
import io
import re
from collections.abc import Iterable, Iterator
from functools import lru_cache
from pathlib import Path
from typing import BinaryIO, Callable, NamedTuple, Union, cast

import numpy as np

from ..errors import GcodeError
from ..toolpath import Toolpath
from .cache import Cache
from .dialects import Meaning, meaning_of
from .finish import assemble
from .interpreter import Interpreter, idle_command
from .rows import OTHER, Lines, split
from .store import Column
from .walk import Walk

CHUNK_BYTES = 1 << 19
HEAD_BYTES = 1 << 18
LONGEST_LINE_BYTES = 1 << 20
SHORT_RUN = 24  # rows; for fewer the interpreter is quicker than numpy
_SEMICOLON, _WIDTH, MOST_WIDTH_MM = ord(";"), b";WIDTH:", 100.0
_FIGURES = b"0123456789.\r\n"
LEAST_E_VALUES = 8  # fewer extruding moves do not tell absolute from relative E
BOM = b"\xef\xbb\xbf"

_E_MODE = re.compile(  # of bounded width: an unbounded one takes quadratic time on a long line of rubbish
    rb"^[ \t]{0,8}(?:(M0*8[23]\b|G0*92\b)"
    rb"|G0{0,8}[123][ \t][^;\r\n]{0,60}?[XY][^;\r\n]{0,60}?E[ \t]?(\d{1,12}\.?\d{0,12}|\.\d{1,12}))",
    re.MULTILINE | re.IGNORECASE,
)
_FEEDS = {
    letter: re.compile(
        rb"^[ \t]{0,8}G0{0,8}[123][ \t][^;\r\n]{0,60}?[ \t]" + letter + rb"-?\.?\d", re.MULTILINE | re.IGNORECASE
    )
    for letter in (b"A", b"E")
}
# Lines that cannot change how moves are read: comments, object labels, macros, and M codes other than these.
_STATELESS = re.compile(rb"[;@]|[A-FH-LO-QU-Z]|[RS](?!ESTORE_GCODE|AVE_GCODE)|M(?!\s*0*(?:82|83|200|221)(?!\d))\s*\d")

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
        block = rest + data
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
        if self.machine.extruder != "E" or (b"\r" in chunk and chunk.count(b"\r") != chunk.count(b"\r\n")):
            self._read_by_line(chunk, length)
        else:
            self._read_by_rows(chunk, length)
        self._keep_interpreted()

    def _read_by_line(self, chunk: bytes, length: int) -> None:
        """Lines may end in a carriage return alone."""
        end, self.machine.read_bytes = 0, self.position + length
        for raw in chunk.splitlines(keepends=True):
            end += len(raw)
            self.position += len(raw) + _lengthened(raw) - max(0, end - length)
            self.machine.run(raw.decode("utf-8", "replace"), self.position)

    def _read_by_rows(self, chunk: bytes, length: int) -> None:
        lines = split(chunk)
        ends = self.position + np.minimum(lines.end + 1, length)
        if not chunk.isascii():
            ends += _drift(chunk, lines)
        self.position = self.machine.read_bytes = int(ends[-1])
        run = _Chunk(chunk, lines, ends)
        begin, waiting, machine = 0, _Waiting([], []), self.machine
        own = machine.own_gcode
        others = run.others
        for i, start, end in zip(others.tolist(), lines.start[others].tolist(), lines.end[others].tolist()):
            raw = chunk[start:end]
            if raw[0] == _SEMICOLON:
                heard: tuple[Meaning, ...] | bytes = meaning_of(raw)
                if not heard:
                    continue
                # After some comments filament is fed by another than before, see `Interpreter.own_gcode`.
                stateless = not (_may_begin(raw) if own else b"ustom" in raw)
            else:
                heard, stateless = raw, _is_stateless(raw)
            if stateless:
                waiting.lines.append(i)
                waiting.heard.append(heard)
                continue
            self._run(run, begin, i, waiting)
            machine.run(run.text(i), run.end(i))
            begin, waiting, own = i + 1, _Waiting([], []), machine.own_gcode
        self._run(run, begin, len(ends), waiting)

    def _run(self, run: _Chunk, begin: int, end: int, waiting: _Waiting) -> None:
        """Execute lines [begin, end), of which those `waiting` are no rows but change no mode either."""
        machine, first, last = self.machine, *run.rows(begin, end)
        width_lines, widths_mm = run.widths(begin, end)
        if last == first:
            run.interpret(machine, sorted(waiting.lines + width_lines.tolist()))
            return
        walk = None
        if last - first >= SHORT_RUN:
            walk = Walk(machine, run.lines, run.row_kind, first, last)
        if walk is None or not walk.sane:
            run.interpret(machine, range(begin, end))
            return
        self._keep_interpreted()
        laid, tail_open, stops = machine.laid, machine.tail_open, []
        if len(width_lines):
            machine.said.width.extend(laid + walk.beads_upto[run.lines.rows_before[width_lines] - first], widths_mm)
        rows = run.lines.rows_before[np.array(waiting.lines, np.int64)] - first
        beads = (laid + walk.beads_upto[rows]).tolist()
        for i, heard, row, bead in zip(waiting.lines, waiting.heard, rows.tolist(), beads):
            if isinstance(heard, tuple):
                machine.said.take(heard, bead)
            else:
                tail_stays = idle_command(heard)
                if tail_stays is None:
                    machine.laid, machine.tail_open = bead, True
                    machine.run(run.text(i), run.end(i))
                    tail_stays = machine.tail_open
                if not tail_stays:
                    stops.append(row)
        machine.laid, machine.tail_open = laid, tail_open
        self.end_pos.append(walk.apply(run.row_ends[first:last], np.array(stops, np.int64)))
        self.beads.append(walk.path)

    def _keep_interpreted(self) -> None:
        path, end_pos = self.machine.take()
        self.beads.append(path)
        self.end_pos.append(end_pos)


class _Waiting(NamedTuple):
    """Lines that are no rows but change no mode either: their numbers, and what they say.

    heard : of a comment what it means; of a command its bytes
    """

    lines: list[int]
    heard: list[tuple[Meaning, ...] | bytes]


class _Chunk:
    """A chunk's lines with their file positions.

    others : numbers of the lines that are no rows, not empty, and tell no width
    """

    def __init__(self, chunk: bytes, lines: Lines, ends: np.ndarray) -> None:
        self._chunk, self.lines, self._ends = chunk, lines, ends
        row = lines.kind != OTHER
        self.row_kind, self.row_ends = lines.kind[row], ends[row]
        others = np.flatnonzero(~row & (lines.end > lines.start))
        self._width_lines, self._widths_mm = self._find_widths(others)
        self.others = np.setdiff1d(others, self._width_lines, assume_unique=True)

    def _find_widths(self, others: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The lines `;WIDTH:0.45`, a quarter of all lines of some slicers, and the widths; () where one is damaged."""
        text, tell = np.frombuffer(self._chunk, np.uint8), others
        for i, letter in enumerate(_WIDTH):
            tell = tell[text.take(self.lines.start[tell] + i, mode="clip") == letter]
        begin, end = self.lines.start[tell] + len(_WIDTH), self.lines.end[tell]
        try:
            widths_mm = _plain_numbers(text, begin, end + 1)
            if widths_mm is None:
                widths_mm = np.array(
                    [float(self._chunk[one:other]) for one, other in zip(begin.tolist(), end.tolist())]
                )
        except ValueError:
            return np.empty(0, np.int64), np.empty(0)
        if not ((widths_mm >= 0) & (widths_mm < MOST_WIDTH_MM)).all():
            return np.empty(0, np.int64), np.empty(0)
        return tell, widths_mm

    def widths(self, begin: int, end: int) -> tuple[np.ndarray, np.ndarray]:
        """Of lines [begin, end): those that tell a width, and it; (n,) int64, (n,) float64, mm."""
        among = slice(*np.searchsorted(self._width_lines, (begin, end)))
        return self._width_lines[among], self._widths_mm[among]

    def raw(self, line: int) -> bytes:
        return self._chunk[self.lines.start[line] : self.lines.end[line]]

    def text(self, line: int) -> str:
        return self.raw(line).decode("utf-8", "replace")

    def end(self, line: int) -> int:
        return int(self._ends[line])

    def rows(self, begin: int, end: int) -> tuple[int, int]:
        return int(self.lines.rows_before[begin]), int(self.lines.rows_before[end])

    def interpret(self, machine: Interpreter, lines: Iterable[int]) -> None:
        for i in lines:
            machine.run(self.text(i), self.end(i))


def _plain_numbers(text: np.ndarray, begin: np.ndarray, end: np.ndarray) -> np.ndarray | None:
    """(n,) float64: the numbers in [begin, end) of the bytes, each with its newline; None where one is no digits and dot."""
    lengths = end - begin
    first = np.cumsum(lengths) - lengths
    told = text.take(np.arange(int(lengths.sum())) + np.repeat(begin - first, lengths))
    if not len(told) or told.tobytes().translate(None, _FIGURES):
        return None
    starts_right = (told[first] >= ord("0")).all()
    if not starts_right or np.add.reduceat(told == ord("."), first).max() > 1:
        return None
    return np.fromstring(told.tobytes(), dtype=np.float64, sep="\n")


@lru_cache(maxsize=4096)
def _is_stateless(raw: bytes) -> bool:
    return _STATELESS.match(raw) is not None


def _may_begin(raw: bytes) -> bool:
    """A comment that may name the first layer or feature, with which the slicer's own moves begin."""
    return b"layer" in raw.lower() or raw.startswith((b";TYPE:", b"; FEATURE:", b"; feature"))


def _lengthened(raw: bytes) -> int:
    """How many bytes longer a line is when OctoPrint has read it: what is no UTF-8 becomes U+FFFD, three bytes."""
    return len(raw.decode("utf-8", "replace").encode("utf-8")) - len(raw)


def _drift(chunk: bytes, lines: Lines) -> np.ndarray:
    """(n,) int64: by how much each line's end has moved, see `_lengthened`."""
    drift = np.zeros(len(lines.end), np.int64)
    strange = np.flatnonzero(np.frombuffer(chunk, np.uint8) > 127)
    for i in np.unique(np.searchsorted(lines.end, strange)).tolist():
        drift[i] = _lengthened(chunk[lines.start[i] : lines.end[i]])
    return np.cumsum(drift)


def refuse_what_is_no_gcode(head: bytes, name: str) -> None:
    """Raises GcodeError with a sentence that says what the file is instead."""
    if not head:
        raise GcodeError(f"{name} is empty. Slice or upload it again.")
    if head.startswith(b"GCDE"):
        raise GcodeError(
            f"{name} is binary G-code. Switch binary G-code off in the slicer's printer settings and export again."
        )
    if head.startswith(b"PK\x03\x04"):
        raise GcodeError(f"{name} is a zip archive (a project?). Export plain G-code from the slicer.")
    if b"\0" in head:
        raise GcodeError(f"{name} is not a text file, so it is no G-code. Choose the file that the slicer exported.")


def feeds_by_a(head: bytes) -> bool:
    """Whether a file moves its extruder by A instead of E, as for Mach3, MakerWare and Sailfish."""
    return _FEEDS[b"E"].search(head) is None and _FEEDS[b"A"].search(head) is not None


def looks_relative(head: bytes, extruder: str = "E") -> bool:
    """Whether a file that never says M82 or M83 before it extrudes means relative E (set by a start macro).

    In absolute mode E grows from one extruding move to the next; relative amounts go up and down.
    """
    previous: float | None = None
    smaller = total = 0
    if extruder != "E":
        head = head.replace(b" " + extruder.encode(), b" E")
    for found in _E_MODE.finditer(head):
        command, value = found.groups()
        if command:
            if total < LEAST_E_VALUES and not command.upper().startswith(b"G"):
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
