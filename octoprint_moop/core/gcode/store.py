"""Long columns that grow: in memory, or in files of NumPy's format from which they are mapped."""

from __future__ import annotations

import io
from pathlib import Path
from typing import BinaryIO, cast

import numpy as np

HEADER_BYTES = 128
BLOCK_ROWS = 1 << 15


class Column:
    """Rows of one dtype, appended in blocks; `done` gives them back as one array, mapped where there is a file.

    Memory stays at one block where there is a file, and at the column's own size where there is none.
    """

    def __init__(self, dtype: str, width: int = 1, path: Path | None = None) -> None:
        self._dtype, self._width, self._path = np.dtype(dtype), width, path
        self._file = cast(BinaryIO, io.BytesIO() if path is None else open(path, "w+b"))  # noqa: SIM115
        self._row_bytes = self._dtype.itemsize * width
        self._rows = 0
        if path is not None:
            self._file.write(bytes(HEADER_BYTES))

    def __len__(self) -> int:
        return self._rows

    @property
    def _head(self) -> int:
        return 0 if self._path is None else HEADER_BYTES

    def append(self, rows: np.ndarray) -> None:
        """rows : (n,) or (n, width)."""
        if len(rows):
            self._file.seek(self._head + self._rows * self._row_bytes)
            self._put(rows)
            self._rows += len(rows)

    def read(self, first: int, last: int) -> np.ndarray:
        """A copy of rows [first, last)."""
        self._file.seek(self._head + first * self._row_bytes)
        data = bytearray((last - first) * self._row_bytes)
        cast(io.BytesIO, self._file).readinto(data)
        return np.frombuffer(data, self._dtype).reshape(self._shape(last - first))

    def write(self, first: int, rows: np.ndarray) -> None:
        """Overwrite rows from `first` on."""
        self._file.seek(self._head + first * self._row_bytes)
        self._put(rows)

    def _put(self, rows: np.ndarray) -> None:
        self._file.write(np.ascontiguousarray(rows, self._dtype).data)

    def blocks(self) -> list[tuple[int, int]]:
        """The column cut into pieces that fit into memory: (first, last)."""
        return [(first, min(first + BLOCK_ROWS, self._rows)) for first in range(0, self._rows, BLOCK_ROWS)]

    def done(self) -> np.ndarray:
        """The whole column, read-only. Nothing may be appended afterwards."""
        shape = self._shape(self._rows)
        if self._path is None:
            array = np.frombuffer(cast(io.BytesIO, self._file).getbuffer(), self._dtype).reshape(shape)
            array.flags.writeable = False
            return array
        said = f"{{'descr': '{self._dtype.str}', 'fortran_order': False, 'shape': {shape!r}, }}".encode("ascii")
        self._file.seek(0)
        self._file.write(b"\x93NUMPY\x01\x00" + (HEADER_BYTES - 10).to_bytes(2, "little"))
        self._file.write(said.ljust(HEADER_BYTES - 11) + b"\n")
        self._file.close()
        return np.load(self._path, mmap_mode="r") if self._rows else np.load(self._path)

    def close(self) -> None:
        self._file.close()

    def _shape(self, rows: int) -> tuple[int, ...]:
        return (rows,) if self._width == 1 else (rows, self._width)
