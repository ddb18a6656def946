"""Where a print stands that the printer reads from its own storage: it cannot be held, only asked on its way.

The printer is asked how many bytes it has read, then to finish its moves, then where it stands; pictures are taken; and it
is asked both once more. What it had read before it finished its moves has been executed, and what it has not read when
the pictures are there has not: between the two nothing is certain. That the file here is the one that it reads shows
in where it stands: at the end of a bead or of a move of just those bytes.
"""

from __future__ import annotations

import codecs
import gzip
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO, cast

import numpy as np

from ..core.toolpath import Toolpath
from .blindness import OtherFile
from .jobtext import Text, job_text

MATCH_MM = 0.06
"""Firmwares report two decimals, and slicers write three."""
HOP_MM = 2.0
"""So far above a bead's end the nozzle may stand on its way to the next one."""
READ_AHEAD_BYTES = 1024
"""Storage is read in blocks by some firmwares, and what they tell then is where the block ends."""
_BLOCK_BYTES = 1 << 20
_MOVE = re.compile(rb"G0*[0-3](?![\d.])")
_WORD = re.compile(rb"([XYZ])\s*([-+]?\d*\.?\d+)")


@dataclass(frozen=True)
class Reported:
    """What the printer said around a picture.

    done_bytes  : read before it was asked to finish its moves
    most_bytes  : read when the picture was there
    total_bytes : the file's size
    position_mm : where it stood in between
    """

    done_bytes: int
    most_bytes: int
    total_bytes: int
    position_mm: tuple[float, float, float]


@dataclass(frozen=True)
class Place:
    """file_pos, sure_pos, layer: as in a Moment. known: whether the nozzle stood where these bytes have it."""

    file_pos: int
    sure_pos: int
    layer: int
    known: bool


def place(toolpath: Toolpath, job: Path, reported: Reported) -> Place:
    """Raises OtherFile where the file has another size than the printer's."""
    done, most = reported.done_bytes, reported.most_bytes
    if toolpath.bytes != reported.total_bytes:  # bytes that are no UTF-8 are counted otherwise than a printer does
        done, most, size = _positions(job, done, most)
        if size != reported.total_bytes:
            raise OtherFile(
                f"The printer's file has {reported.total_bytes} bytes, the one of the same name here {size}. "
                "Upload the one that is printed, and it is watched from its next start on."
            )
    first, last = done - READ_AHEAD_BYTES, most + READ_AHEAD_BYTES
    stood = _bead_at(toolpath, first, last, reported.position_mm)
    if stood is None:
        z_mm = float(toolpath.beads_mm[max(toolpath.laid_at(first) - 1, 0), 5])
        with job_text(job) as text:
            stood = _move_at(text, first, last, reported.position_mm, z_mm)
    sure = done if stood is None else min(done, stood)
    return Place(most, min(sure, most), max(toolpath.layer_at(most), 0), stood is not None)


def _bead_at(toolpath: Toolpath, first_pos: int, last_pos: int, position_mm: tuple[float, float, float]) -> int | None:
    """The first file position in this stretch at which the nozzle stood so at a bead's end; None where it never did."""
    first = max(toolpath.laid_at(first_pos) - 1, 0)
    last = toolpath.laid_at(last_pos) + 1
    beads = np.asarray(toolpath.beads_mm[first:last], np.float64)
    ends = np.concatenate([beads[:, :3], beads[:, 3:6]])
    off = np.asarray(position_mm) - ends
    there = (np.abs(off[:, :2]).max(axis=1) < MATCH_MM) & (off[:, 2] > -MATCH_MM) & (off[:, 2] < HOP_MM)
    if not there.any():
        return None
    index = np.flatnonzero(there) % len(beads)
    at_end = np.flatnonzero(there) >= len(beads)
    laid = int((first + index + at_end).min())
    return int(toolpath.end_pos[laid - 1]) if laid else 0


def _move_at(
    text: Text, first_pos: int, last_pos: int, position_mm: tuple[float, float, float], z_mm: float
) -> int | None:
    """The same for moves that lay nothing, where the file says plainly where they end. z_mm : of the nozzle before"""
    at_mm: dict[bytes, float] = {b"Z": z_mm}
    for line, end in _lines(text, max(first_pos, 0), last_pos):
        command = line.split(b";")[0].strip()
        if not _MOVE.match(command):
            continue
        at_mm.update((axis, float(number)) for axis, number in _WORD.findall(command))
        x, y, z = (wanted - at_mm.get(axis, math.inf) for axis, wanted in zip((b"X", b"Y", b"Z"), position_mm))
        if max(abs(x), abs(y)) < MATCH_MM and -MATCH_MM < z < HOP_MM:
            return end
    return None


def _lines(text: Text, first_pos: int, last_pos: int) -> Iterator[tuple[bytes, int]]:
    """(line, position of its end) of the whole lines in a stretch."""
    at = text.rfind(b"\n", 0, first_pos) + 1
    while 0 <= at < last_pos:
        end = text.find(b"\n", at) + 1
        if not end:
            return
        yield text[at:end], end
        at = end


def _positions(job: Path, *raw_bytes: int) -> tuple[int, ...]:
    """File positions, as OctoPrint counts them, of these bytes of a job, and how many bytes it has."""
    decoder = codecs.getincrementaldecoder("utf-8")(errors="replace")
    found, position, at = [], 0, 0
    with cast("IO[bytes]", gzip.open(job) if job.suffix == ".gz" else open(job, "rb")) as file:
        for wanted in (*sorted(raw_bytes), None):
            while wanted is None or at < wanted:
                block = file.read(_BLOCK_BYTES if wanted is None else min(_BLOCK_BYTES, wanted - at))
                if not block:
                    break
                at += len(block)
                position += len(decoder.decode(block).encode())
            found.append(position)
    return (*found[:-1], at)
