"""From the bytes of G-code to columns of numbers, a whole chunk at once.

A *row* is a line of a shape that nearly all lines have: `G0`, `G1`, `G2` or `G3` followed by words like `X12.5`, each
after a blank; `G92 E…`; a bare `G10` or `G11`. Everything else (comments, settings, lower case, checksums, missing
blanks, anything damaged) is left to the line-by-line interpreter.

No text is converted to floating point: a number's digits are gathered as an integer and scaled by its decimals, which
is exact to the last bit but one and several times faster.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

MOVE, ARC_CW, ARC_CCW, SET_E, RETRACT, UNRETRACT, OTHER = 0, 2, 3, 4, 5, 6, -1
MOST_DIGITS = 15  # of one number; more are left to the interpreter

_DIGIT, _LETTER, _DOT, _MINUS, _BLANK, _LINE, _BAD = 0, 1, 2, 3, 4, 5, 9
_CLASS = np.full(256, _BAD, np.uint8)
_CLASS[ord("0") : ord("9") + 1] = _DIGIT
_CLASS[ord("A") : ord("Z") + 1] = _LETTER
_CLASS[[ord("."), ord("-"), ord("\n")]] = _DOT, _MINUS, _LINE
_CLASS[[ord(" "), ord("\r"), ord(";")]] = _BLANK
_POWER = 10.0 ** np.arange(MOST_DIGITS + 1)
_PAD = b"\n" * 24

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
    bytes_ = np.frombuffer(chunk + _PAD, dtype=np.uint8)
    body = bytes_[: len(chunk)]
    end = np.flatnonzero(body == ord("\n"))
    start = np.concatenate([[0], end[:-1] + 1])
    kind = _kinds(bytes_, start)
    position, event, line = _events(body, start, end, kind)
    number = _Numbers(bytes_, position, event, line)
    letter = bytes_[position[number.at]]

    bad = np.zeros(len(end), bool)
    bad[line[event == _BAD]] = True
    bad[number.line[~number.good]] = True
    bad[line[number.stray]] = True
    bad[number.line[(kind[number.line] == SET_E) & (letter != ord("E")) & (letter != ord("G"))]] = True
    kind[bad] = OTHER

    row = kind != OTHER
    rows_before = np.concatenate([[0], np.cumsum(row)])
    known = row[number.line]
    wanted = AXES + ARC_WORDS if ((kind == ARC_CW) | (kind == ARC_CCW)).any() else AXES
    count = int(rows_before[-1])
    words = {}
    for code in wanted:
        pick = np.flatnonzero(known & (letter == code))
        at = rows_before[number.line[pick]]
        said, values = np.zeros(count, bool), np.zeros(count)
        said[at] = True
        values[at] = number.values(pick)
        words[code] = (said, values)
    return Lines(start, end, kind, rows_before, words)


def _kinds(bytes_: np.ndarray, start: np.ndarray) -> np.ndarray:
    """(n,) int8: what each line looks like by its first five bytes."""
    b0, b1, b2 = bytes_[start], bytes_[start + 1], bytes_[start + 2]
    kind = np.full(len(start), OTHER, np.int8)
    g = b0 == ord("G")
    blank = g & (b2 == ord(" "))
    kind[blank & ((b1 == ord("0")) | (b1 == ord("1")))] = MOVE
    kind[blank & (b1 == ord("2"))] = ARC_CW
    kind[blank & (b1 == ord("3"))] = ARC_CCW
    rare = np.flatnonzero(g & ~blank)
    b1, b2, b3, b4 = (bytes_[start[rare] + i] for i in range(1, 5))
    kind[rare[(b1 == ord("9")) & (b2 == ord("2")) & (b3 == ord(" ")) & (b4 == ord("E"))]] = SET_E
    over = (b3 == ord("\n")) | (b3 == ord("\r")) | (b3 == ord(";")) | ((b3 == ord(" ")) & (b4 == ord(";")))
    kind[rare[(b1 == ord("1")) & (b2 == ord("0")) & over]] = RETRACT
    kind[rare[(b1 == ord("1")) & (b2 == ord("1")) & over]] = UNRETRACT
    return kind


def _events(
    body: np.ndarray, start: np.ndarray, end: np.ndarray, kind: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where anything but a digit stands in the code of the rows: position, class, line; comments are left out."""
    class_ = _CLASS[body]
    position = np.flatnonzero(class_)
    event = class_[position]
    line = np.cumsum(event == _LINE)
    line -= event == _LINE
    cut = end.copy()
    semicolons = np.flatnonzero(body == ord(";"))
    if len(semicolons):
        lines, first = np.unique(np.searchsorted(end, semicolons), return_index=True)
        cut[lines] = semicolons[first]
    cut[kind == OTHER] = -1
    keep = position <= cut[line]
    return position[keep], event[keep], line[keep]


class _Numbers:
    """The numbers that follow letters: `at` (index of the letter's event), `line`, `good`; and the `stray` events."""

    def __init__(self, bytes_: np.ndarray, position: np.ndarray, event: np.ndarray, line: np.ndarray) -> None:
        self._bytes = bytes_
        self.at = np.flatnonzero(event == _LETTER)
        self.line = line[self.at]
        padded_event = np.append(event, [_LINE] * 3).astype(np.uint8)
        padded_position = np.append(position, [len(bytes_)] * 3)
        after = self.at + 1
        minus = padded_event[after] == _MINUS
        next_ = after + minus
        dot = padded_event[next_] == _DOT
        over = next_ + dot
        self._minus = minus
        self._first = position[self.at] + 1 + minus
        stop = padded_position[over]
        self._decimals = np.where(dot, stop - padded_position[next_] - 1, 0)
        self._digits = stop - self._first - dot
        closing = padded_event[over]
        self.good = ((closing == _BLANK) | (closing == _LINE)) & (self._digits >= 1) & (self._digits <= MOST_DIGITS)
        self.good &= ~minus | (padded_position[after] == position[self.at] + 1)
        used = np.zeros(len(padded_event), bool)
        used[after[minus]] = True
        used[next_[dot]] = True
        marks = (event == _MINUS) | (event == _DOT)
        self.stray = np.flatnonzero(marks & ~used[: len(event)])

    def values(self, pick: np.ndarray) -> np.ndarray:
        """(len(pick),) float64."""
        digits, decimals, first = self._digits[pick], self._decimals[pick], self._first[pick]
        if not len(pick):
            return np.zeros(0)
        whole = digits - decimals
        value = np.zeros(len(pick), np.int64)
        shortest = int(digits.min())
        for k in range(int(digits.max())):
            figure = self._bytes[first + k + (k >= whole)]
            if k < shortest:
                value = value * 10 + (figure & 15)
            else:
                value = np.where(k < digits, value * 10 + (figure & 15), value)
        scaled = value / _POWER[decimals]
        return np.where(self._minus[pick], -scaled, scaled)
