"""Frames from the webcam, through OctoPrint's webcam providers, as the bytes that the camera sent."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterable
from typing import Any, Callable

from ..core.errors import FrameError

MAX_JPEG_BYTES = 24 * 1024 * 1024


class Webcam:
    """One webcam. A provider may hang for longer than anybody wants to wait, so each picture is fetched by a thread of
    its own; while one hangs, no second one is started.

    find : of a name, "" for the one that is set, returns (name, take) where take() gives the picture in pieces; raises
    FrameError where there is no such webcam
    """

    def __init__(self, find: Callable[[str], tuple[str, Callable[[], Iterable[bytes]]]]) -> None:
        self._find = find
        self._busy = threading.Lock()
        self._sizes_px: dict[str, list[int] | None] = {}

    def size_px(self, name: str) -> list[int] | None:
        """[width, height] of the last picture of the webcam of that name; None where there was none."""
        return self._sizes_px.get(name)

    def grab(self, timeout_s: float, interrupted: threading.Event | None = None, name: str = "") -> bytes:
        """A JPEG, begun after the call. Raises FrameError within about `timeout_s`, or soon after `interrupted`."""
        waited_s = 0.0
        # The page and the watch may want a picture at the same time: the second waits for its turn.
        while not self._busy.acquire(timeout=0.05):
            waited_s += 0.05
            if waited_s >= timeout_s or (interrupted is not None and interrupted.is_set()):
                raise FrameError("The webcam has not answered the last request yet. Look at the stream, or restart it.")
        fetched: list[bytes | Exception] = []
        done = threading.Event()

        def fetch() -> None:
            try:
                fetched.append(self._fetch(name, done))
            except Exception as error:  # whatever a provider raises is the same to the print: no picture
                fetched.append(error)
            finally:
                self._busy.release()
                done.set()

        threading.Thread(target=fetch, name="moop.webcam", daemon=True).start()
        while not done.wait(0.05):
            waited_s += 0.05
            if interrupted is not None and interrupted.is_set():
                raise FrameError("The picture is not wanted any more.")
            if waited_s >= timeout_s:
                done.set()  # tells the thread to stop collecting
                raise FrameError(f"The webcam gave no picture within {timeout_s:.0f} s. Look at its stream.")
        (result,) = fetched
        if isinstance(result, FrameError):
            raise result
        if isinstance(result, Exception):
            raise FrameError(f"The webcam gave no picture ({_in_short(result)}). Look at its snapshot address.")
        return result

    def _fetch(self, name: str, given_up: threading.Event) -> bytes:
        name, take = self._find(name)
        pieces, size = [], 0
        for piece in take():
            pieces.append(piece)
            size += len(piece)
            if given_up.is_set():
                raise FrameError("The picture came too late.")
            if size > MAX_JPEG_BYTES:
                raise FrameError(f"The webcam sent more than {MAX_JPEG_BYTES >> 20} MB. Is this a stream's address?")
        picture = b"".join(pieces)
        check_jpeg(picture)
        self._sizes_px[name] = jpeg_size_px(picture)
        return picture


def check_jpeg(data: bytes) -> None:
    """Raises FrameError where this is not a whole JPEG. A torn one would decode, with grey where the rest should be."""
    if not data:
        raise FrameError("The webcam's answer is empty. Look at its snapshot address.")
    if data[:2] != b"\xff\xd8":
        begins = bytes(byte if 32 <= byte < 127 else 46 for byte in data[:20]).decode()
        raise FrameError(f"The webcam's answer is not a JPEG; it begins with {begins!r}. Look at its snapshot address.")
    if data.rfind(b"\xff\xd9", max(2, len(data) - 4096)) < 0:
        raise FrameError(f"The webcam's picture breaks off after {len(data)} bytes. Look at its stream.")


def jpeg_size_px(data: bytes) -> list[int] | None:
    """[width, height] as a JPEG's frame header has them, without unpacking the picture; None where it has none."""
    at = 2
    while at + 9 <= len(data) and data[at] == 0xFF:
        kind, length = data[at + 1], int.from_bytes(data[at + 2 : at + 4], "big")
        if 0xC0 <= kind <= 0xCF and kind not in (0xC4, 0xC8, 0xCC):
            return [int.from_bytes(data[at + 7 : at + 9], "big"), int.from_bytes(data[at + 5 : at + 7], "big")]
        at += 1 if kind == 0xFF else 2 + length
    return None


def octoprint_webcam(name: str) -> tuple[str, Callable[[], Iterable[bytes]]]:
    """The webcam of that name, or OctoPrint's snapshot webcam where it is empty: (name, take).

    Raises FrameError where there is none, or it can take no snapshots.
    """
    from octoprint.webcams import get_snapshot_webcam, get_webcams

    webcam: Any = get_webcams().get(name) if name else get_snapshot_webcam()
    if webcam is None:
        wanted = f"no webcam named {name!r}" if name else "no webcam"
        raise FrameError(f"OctoPrint has {wanted}. Choose one in the settings.")
    if not webcam.config.canSnapshot:
        raise FrameError(f"{webcam.config.displayName} can take no snapshots. Set its snapshot address in OctoPrint.")
    return webcam.config.name, lambda: webcam.providerPlugin.take_webcam_snapshot(webcam.config.name)


def webcam_name(name: str) -> str:
    """The name of the webcam that would be used; `name` itself where there is none."""
    with contextlib.suppress(FrameError):
        return octoprint_webcam(name)[0]
    return name


def octoprint_turns(name: str) -> dict[str, bool]:
    """How OctoPrint turns that webcam's picture in its pages: flip_h, flip_v, rotate_90; nothing where there is none.

    Snapshots are never turned: not by OctoPrint, and not here.
    """
    from octoprint.webcams import get_snapshot_webcam, get_webcams

    webcam: Any = get_webcams().get(name) if name else get_snapshot_webcam()
    config = None if webcam is None else webcam.config
    wanted = {"flip_h": "flipH", "flip_v": "flipV", "rotate_90": "rotate90"}
    return {ours: bool(getattr(config, theirs, False)) for ours, theirs in wanted.items()}


def _in_short(error: Exception) -> str:
    return f"{type(error).__name__}: {str(error)[:200]}"
