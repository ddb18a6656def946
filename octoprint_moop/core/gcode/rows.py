"""From the bytes of G-code to columns of numbers, a whole chunk at once.

A *row* is a line of a shape that nearly all lines have: `G0`, `G1`, `G2` or `G3` followed by words like `X12.5`, each
after a blank; `G92 E…`; a bare `G10` or `G11`. Everything else (comments, settings, lower case, checksums, missing
blanks, anything damaged) is left to the line-by-line interpreter.

Numbers are not converted from text to floating point, which is dear: without their dots and signs they are read as
whole numbers, which is cheap, and scaled by their decimals. That equals float() of the text, see `_words`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

MOVE, ARC_CW, ARC_CCW, SET_E, RETRACT, UNRETRACT, OTHER = 0, 2, 3, 4, 5, 6, -1
MOST_DIGITS = 15  # of one number; more are left to the interpreter

_LETTER, _DOT, _MINUS, _LINE, _BAD = 1, 2, 3, 4, 5
_CLASS = np.full(256, _BAD, np.uint8)
_CLASS[ord("A") : ord("Z") + 1] = _LETTER
_CLASS[[ord("."), ord("-"), ord("\n")]] = _DOT, _MINUS, _LINE
_CLASS[[*range(ord("0"), ord("9") + 1), ord(" ")]] = 0
_CLASSES = _CLASS.tobytes()
_ONLY_DIGITS = bytes(i if ord("0") <= i <= ord("9") else ord(" ") for i in range(256))
_POWER = np.array([float(10**k) for k in range(MOST_DIGITS + 1)])
_PAD = b"\n" * 8
_BLANK = ord(" ")

AXES = tuple(ord(letter) for letter in "XYZE")
ARC_WORDS = tuple(ord(letter) for letter in "IJRP")


@dataclass(frozen=True, eq=False)
class Lines:
    """The lines of a chunk (n), and the words of those that are rows (m).

    start, end : (n,) int64, offsets within the chunk; end is the newline's
    kind       : (n,) int8, MOVE … UNRETRACT for rows, OTHER
    rows_before : (n + 1,) int64
    words      : letter -> ((m,) bool, (m,) float64): whether the row has it, and its number
    """

    start: np.ndarray
    end: np.ndarray
    kind: np.ndarray
    rows_before: np.ndarray
    words: dict[int, tuple[np.ndarray, np.ndarray]]


def split(chunk: bytes) -> Lines:
    """Lines and words of a chunk, which must end with a newline."""
    code = bytearray(chunk + _PAD)
    text = np.frombuffer(code, np.uint8)
    end = np.flatnonzero(text[: len(chunk)] == ord("\n"))
    start = np.empty_like(end)
    start[0], start[1:] = 0, end[:-1] + 1
    kind = _kinds(text, start)
    code_end = _blank_comments(code, text[: len(chunk)], start, end, kind)
    letter, line, values = _words(code, text, len(chunk), start, end, code_end, kind)

    rows_before = np.empty(len(end) + 1, np.int64)
    rows_before[0] = 0
    np.cumsum(kind != OTHER, out=rows_before[1:])
    at = rows_before.take(line)
    words = {}
    has_arcs = bool(((kind == ARC_CW) | (kind == ARC_CCW)).any())
    for wanted in AXES + ARC_WORDS if has_arcs else AXES:
        pick = np.flatnonzero(letter == wanted)
        said, column = np.zeros(rows_before[-1], bool), np.zeros(rows_before[-1])
        where = at.take(pick)
        said[where] = True
        column[where] = values.take(pick)
        words[wanted] = (said, column)
    return Lines(start, end, kind, rows_before, words)


def _kinds(text: np.ndarray, start: np.ndarray) -> np.ndarray:
    """(n,) int8: what each line looks like by its first five bytes."""
    b0, b1, b2 = text.take(start), text.take(start + 1), text.take(start + 2)
    g = b0 == ord("G")
    blank = g & (b2 == _BLANK)
    kind = np.where(blank & (b1 >= ord("0")) & (b1 <= ord("3")), b1.view(np.int8) - ord("0"), OTHER).astype(np.int8)
    kind[kind == 1] = MOVE
    rare = np.flatnonzero(g & ~blank)
    b1, b2, b3, b4 = (text.take(start[rare] + i) for i in range(1, 5))
    kind[rare[(b1 == ord("9")) & (b2 == ord("2")) & (b3 == _BLANK) & (b4 == ord("E"))]] = SET_E
    over = (b3 == ord("\n")) | (b3 == ord("\r")) | (b3 == ord(";")) | ((b3 == _BLANK) & (b4 == ord(";")))
    kind[rare[(b1 == ord("1")) & (b2 == ord("0")) & over]] = RETRACT
    kind[rare[(b1 == ord("1")) & (b2 == ord("1")) & over]] = UNRETRACT
    return kind


def _blank_comments(
    code: bytearray, body: np.ndarray, start: np.ndarray, end: np.ndarray, kind: np.ndarray
) -> np.ndarray:
    """Overwrite all but the code of rows with blanks; newlines stay.

    Returns (n,) int64, where each row's code ends, without its comment and up to three blanks or a carriage return.
    """
    code_end = end.copy()
    semicolons = np.flatnonzero(body == ord(";"))
    if len(semicolons):
        line = np.searchsorted(end, semicolons)
        first = np.ones(len(line), bool)
        first[1:] = line[1:] != line[:-1]
        code_end[line[first]] = semicolons[first]
    for _ in range(3):
        last = body.take(code_end - 1, mode="clip")
        trailing = np.flatnonzero(((last == _BLANK) | (last == ord("\r"))) & (code_end > start))
        if not len(trailing):
            break
        code_end[trailing] -= 1
    _blank(code, np.where(kind == OTHER, start, code_end), end)
    return code_end


def _blank(code: bytearray, start: np.ndarray, end: np.ndarray) -> None:
    """Overwrite [start, end) of each line with blanks."""
    lengths = np.maximum(end - start, 0)
    within = np.cumsum(lengths)
    if len(within) and within[-1]:
        at = np.arange(within[-1]) + np.repeat(start - within + lengths, lengths)
        np.frombuffer(code, np.uint8)[at] = _BLANK


def _words(
    code: bytearray,
    text: np.ndarray,
    length: int,
    start: np.ndarray,
    end: np.ndarray,
    code_end: np.ndarray,
    kind: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The words of rows: their letters (bytes), lines, and numbers. Lines of another shape than a row's become OTHER.

    Whole numbers below 10^15 and the powers of ten that scale them are exact in float64, so that one division rounds
    once: a number equals float() of its text.
    """
    body = text[:length]
    odd = _odd_blanks(body, end)
    row = start[kind != OTHER]
    text[row], text[row + 1] = _BLANK, _BLANK  # "G1"
    text[start[kind >= SET_E] + 2] = _BLANK  # "G92"
    # Events: all that is no digit and no blank. A word is a letter, perhaps a minus, perhaps a dot, then another word.
    class_ = np.frombuffer(code.translate(_CLASSES), np.uint8)[:length]
    position = np.flatnonzero(class_ != 0)
    event = class_.take(position)
    line = np.repeat(np.arange(len(end)), np.diff(np.flatnonzero(event == _LINE), prepend=-1))

    at = np.flatnonzero(event == _LETTER)
    letter_at, letter_line = position.take(at), line.take(at)
    letter = text.take(letter_at)
    minus = event.take(at + 1) == _MINUS
    maybe_dot = at + 1 + minus
    dot = event.take(maybe_dot) == _DOT
    over = maybe_dot + dot
    last = event.take(over, mode="clip") == _LINE
    # A number ends one blank before the next letter, or where the line's code ends.
    stop = position.take(over, mode="clip") - 1
    ending = np.flatnonzero(last)
    stop[ending] = code_end.take(letter_line.take(ending))
    decimals = np.where(dot, stop - position.take(maybe_dot) - 1, 0)
    digits = stop - letter_at - 1 - minus - dot

    wrong = (digits < 1) | (digits > MOST_DIGITS) | (decimals < 0) | (text.take(letter_at - 1) != _BLANK)
    wrong |= minus & (position.take(at + 1) != letter_at + 1)
    wrong |= (letter != ord("E")) & (kind.take(letter_line) >= SET_E)
    stray = (event == _MINUS) | (event == _DOT)
    stray[(at + 1)[minus]] = False
    stray[maybe_dot[dot]] = False
    stray |= event == _BAD
    bad = np.zeros(len(end), bool)
    bad[letter_line.take(np.flatnonzero(wrong))] = True
    bad[line.take(np.flatnonzero(stray))] = True
    bad[odd] = True
    if bad.any():
        kind[bad] = OTHER
        _blank(code, start[bad], end[bad])
        keep = ~bad.take(letter_line)
        letter, letter_line, minus, decimals = letter[keep], letter_line[keep], minus[keep], decimals[keep]

    figures = bytes(code.translate(_ONLY_DIGITS, b".-")) if len(letter) else b""
    whole = np.fromstring(figures, dtype=np.int64, sep=" ") if figures else np.zeros(0, np.int64)
    numbers = whole / _POWER.take(decimals)
    return letter, letter_line, np.negative(numbers, out=numbers, where=minus)


def _odd_blanks(body: np.ndarray, end: np.ndarray) -> np.ndarray:
    """The lines with a blank that is not just before a letter: `X1 2`, `X 1`, `X1  Y2`."""
    blank = body == _BLANK
    lost = blank[:-1] & (body[1:] >= ord("-")) & (body[1:] <= ord("9"))
    lost[:-1] |= blank[:-2] & blank[1:-1] & (body[2:] >= ord("A"))
    return np.searchsorted(end, np.flatnonzero(lost))
