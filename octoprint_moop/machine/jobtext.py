"""A job's text as OctoPrint counts file positions in it, without holding it in memory."""

from __future__ import annotations

import codecs
import contextlib
import gzip
import mmap
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Union

Text = Union[bytes, mmap.mmap]
_BLOCK_BYTES = 1 << 20
_STRETCH_BYTES = 16 << 20


@contextlib.contextmanager
def job_text(job: Path) -> Iterator[Text]:
    """The file's bytes, mapped; unpacked where it is packed, and with what is no UTF-8 as long as OctoPrint takes it to be."""
    with contextlib.ExitStack() as stack:
        file: IO[bytes] = stack.enter_context(open(job, "rb"))
        if job.suffix == ".gz":
            packed, file = file, stack.enter_context(tempfile.TemporaryFile())
            with gzip.open(packed) as unpacked:
                shutil.copyfileobj(unpacked, file, _BLOCK_BYTES)
        if not _is_utf8(file):
            strange, file = file, stack.enter_context(tempfile.TemporaryFile())
            _replaced(strange, file)
        file.flush()
        if not file.seek(0, 2):
            yield b""
            return
        yield stack.enter_context(contextlib.closing(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)))


def stretches(text: Text) -> Iterator[tuple[int, int]]:
    """(begin, end) of one stretch after the other, each from a line's end to another; what is mapped of it is let go then."""
    begin = 0
    while 0 <= begin < len(text):
        end = text.find(b"\n", begin + _STRETCH_BYTES)
        yield begin, len(text) if end < 0 else end
        if isinstance(text, mmap.mmap) and hasattr(mmap, "MADV_DONTNEED"):
            text.madvise(mmap.MADV_DONTNEED)
        begin = end


def _is_utf8(file: IO[bytes]) -> bool:
    decoder = codecs.getincrementaldecoder("utf-8")()
    file.seek(0)
    try:
        while block := file.read(_BLOCK_BYTES):
            decoder.decode(block)
        decoder.decode(b"", final=True)
    except UnicodeDecodeError:
        return False
    return True


def _replaced(source: IO[bytes], target: IO[bytes]) -> None:
    decoder = codecs.getincrementaldecoder("utf-8")(errors="replace")
    source.seek(0)
    while block := source.read(_BLOCK_BYTES):
        target.write(decoder.decode(block).encode("utf-8"))
    target.write(decoder.decode(b"", final=True).encode("utf-8"))
