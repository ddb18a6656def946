"""What the beginning of a file tells: whether it is G-code at all, and how it extrudes where it does not say so."""

from __future__ import annotations

import re

from ..errors import GcodeError

HEAD_BYTES = 1 << 18
LEAST_E_VALUES = 8  # fewer extruding moves do not tell absolute from relative E

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
