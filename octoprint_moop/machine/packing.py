"""A folder as a ZIP file that is made while it is sent: never whole in memory, and not a second time on the disk."""

from __future__ import annotations

import contextlib
import tempfile
import zipfile
from collections.abc import Generator, Iterator
from pathlib import Path

UNFINISHED = ".part"
_BLOCK_BYTES = 256 * 1024
_IN_MEMORY_BYTES = 4 * 1024 * 1024


def packed(folder: Path, pictures: bool = True) -> Generator[bytes, None, None]:
    """The pieces, in order, of a ZIP file of what a recording's folder holds just now, below the folder's own name.

    What is removed meanwhile is left out, and so is what is only half written.

    pictures : False to leave the frames out
    """
    with _Member(folder) as member, zipfile.ZipFile(member, "w", strict_timestamps=False) as target:  # type: ignore[call-overload]
        for path in sorted(folder.rglob("*")):
            if path.suffix == UNFINISHED or not path.is_file() or (path.suffix == ".jpg" and not pictures):
                continue
            with contextlib.suppress(FileNotFoundError):
                target.write(path, str(Path(folder.name) / path.relative_to(folder)))  # JPEG, gzip do not shrink again
                yield from member.taken()
        target.close()
        yield from member.taken()


class _Member:
    """What a ZipFile writes to: keeps what has not been taken yet, and can go back within that."""

    def __init__(self, folder: Path) -> None:
        # A large member waits on the disk on which recordings are, since /tmp may be memory.
        self._kept = tempfile.SpooledTemporaryFile(_IN_MEMORY_BYTES, dir=str(folder.parent))  # noqa: SIM115
        self._taken_bytes = 0

    def __enter__(self) -> _Member:
        return self

    def __exit__(self, *_: object) -> None:
        self._kept.close()

    def write(self, data: bytes) -> int:
        return self._kept.write(data)

    def tell(self) -> int:
        return self._taken_bytes + self._kept.tell()

    def seek(self, offset: int) -> int:
        self._kept.seek(offset - self._taken_bytes)
        return offset

    def flush(self) -> None:
        self._kept.flush()

    def seekable(self) -> bool:
        return True

    def taken(self) -> Iterator[bytes]:
        """All that has been written since this was last asked."""
        self._kept.seek(0, 2)
        size = self._kept.tell()
        self._kept.seek(0)
        while block := self._kept.read(_BLOCK_BYTES):
            yield block
        self._taken_bytes += size
        self._kept.seek(0)
        self._kept.truncate()
