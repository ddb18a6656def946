"""Messages between the server and the eye: a JSON head and any number of byte strings, over a pair of pipes."""

from __future__ import annotations

import json
import struct
from collections.abc import Sequence
from typing import IO, Any

_LENGTH = struct.Struct(">I")
MAX_BYTES = 256 * 1024 * 1024


def send(stream: IO[bytes], head: dict[str, Any], blobs: Sequence[bytes] = ()) -> None:
    """Write one message whole. Raises OSError where nobody reads any more, ValueError on numbers JSON does not have."""
    text = json.dumps({**head, "blobs": [len(blob) for blob in blobs]}, allow_nan=False).encode()
    stream.write(_LENGTH.pack(len(text)) + text)
    for blob in blobs:
        stream.write(blob)
    stream.flush()


def receive(stream: IO[bytes]) -> tuple[dict[str, Any], list[bytes]]:
    """The next message. Raises EOFError where the other side has gone, or sent what is not a message."""
    (length,) = _LENGTH.unpack(_exactly(stream, _LENGTH.size))
    try:
        head = json.loads(_exactly(stream, length))
        sizes = [int(size) for size in head.pop("blobs")]
    except (ValueError, KeyError, TypeError, AttributeError):
        raise EOFError("not a message") from None
    return head, [_exactly(stream, size) for size in sizes]


def _exactly(stream: IO[bytes], count: int) -> bytes:
    if not 0 <= count <= MAX_BYTES:
        raise EOFError(f"a message of {count} bytes")
    parts, missing = [], count
    while missing:
        part = stream.read(missing)
        if not part:
            raise EOFError("the other side has gone")
        parts.append(part)
        missing -= len(part)
    return b"".join(parts)
