"""From the bytes of G-code to columns of numbers, a whole chunk at once.

A *row* is a line of a shape that nearly all lines have: `G0`, `G1`, `G2` or `G3` followed by words like `X12.5`, each
after a blank; `G92 E…`; a bare `G10` or `G11`. Everything else (comments, settings, anything damaged) is left to the
line-by-line interpreter. Where most lines are in lower case, without blanks or with line numbers, they are rewritten.

Numbers are not converted from text to floating point, which is dear: the last eight bytes of all words are read as
64-bit integers, in which eight digits are added up at once, see `Figures`.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

import numpy as np

MOVE, ARC_CW, ARC_CCW, SET_E, RETRACT, UNRETRACT, OTHER = 0, 2, 3, 4, 5, 6, -1
MOST_CHARACTERS = 15  # of one number without its sign; longer ones are left to the interpreter

# What a byte is worth in a number: digits themselves, the dot 0x10, everything else 0x20 or, where it ends a word, 0x60.
_ELSE, _ENDS_WORD = 0x20, 0x60
_WORTH = bytearray([_ENDS_WORD] * 33 + [_ELSE] * 223)
_WORTH[ord("0") : ord("9") + 1] = range(10)
_WORTH[ord(".")], _WORTH[ord(";")], _WORTH[ord("*")] = 0x10, _ENDS_WORD, _ENDS_WORD
_PAD = b"\n" * 16
_BLANK = ord(" ")

MOST_ODD_LINES = 0.25  # of all lines may begin as moves do and be no rows, before they are rewritten
_ODD_BEGIN = np.frombuffer(b"GgNn \t", np.uint8)
_ODD_COMMAND = re.compile(
    rb"^(?=[ \tN]|G[ \t0])[ \t]{0,8}(?:N[ \t]{0,8}\d{1,9}[ \t]{0,8})?G[ \t]{0,8}0{0,4}(?=\d)", re.MULTILINE
)

AXES = tuple(ord(letter) for letter in "XYZE")
ARC_WORDS = tuple(ord(letter) for letter in "IJRP")


@dataclass(frozen=True, eq=False)
class Lines:
    """The lines of a chunk (n), and the words of those that are rows (m).

    start, end : (n,) int64, offsets within the chunk; end is the newline's
    kind       : (n,) int8, MOVE … UNRETRACT for rows, OTHER
    rows_before : (n + 1,) int64
    words      : letter -> the rows that have it, (k,) int64, ascending, and its numbers, (k,) float64; of several in one
                 row the last counts
    figures    : to read other numbers of the chunk
    """

    start: np.ndarray
    end: np.ndarray
    kind: np.ndarray
    rows_before: np.ndarray
    words: dict[int, tuple[np.ndarray, np.ndarray]]
    figures: Figures


def split(chunk: bytes) -> Lines:
    """Lines and words of a chunk, which must end with a newline."""
    lines = _split(chunk)
    odd = np.frombuffer(chunk, np.uint8).take(lines.start[lines.kind == OTHER])
    if np.isin(odd, _ODD_BEGIN).sum() <= MOST_ODD_LINES * len(lines.kind):
        return lines
    usual = _split(_as_usual(chunk))
    return replace(lines, kind=usual.kind, rows_before=usual.rows_before, words=usual.words)


def _as_usual(chunk: bytes) -> bytes:
    """The same lines, in upper case, with a blank before each word, and without line numbers and zeros before commands."""
    chunk = chunk.upper()
    if _ODD_COMMAND.search(chunk):
        chunk = _ODD_COMMAND.sub(b"G", chunk)
    text = np.frombuffer(chunk, np.uint8)
    letter = (text >= ord("A")) & (text <= ord("Z"))
    figure = (text >= ord("0")) & (text <= ord("9")) | (text == ord("."))
    return np.insert(text, np.flatnonzero(figure[:-1] & letter[1:]) + 1, _BLANK).tobytes()


def _split(chunk: bytes) -> Lines:
    text = np.frombuffer(chunk, np.uint8)
    figures = Figures(chunk)
    stops = np.flatnonzero(figures.worth == _ENDS_WORD)  # pieces end here; a line's first one is its command
    stop_byte = text.take(stops)
    last_piece = np.flatnonzero(stop_byte == ord("\n"))
    end = stops.take(last_piece)
    start, first_piece = _after(end), _after(last_piece)
    kind = _kinds(text, start)

    rows = np.flatnonzero(kind != OTHER)
    words = _Words(text, figures, stops, first_piece[rows], _code_end(stop_byte, last_piece)[rows])
    bad = words.bad_rows(kind[rows] >= SET_E)
    if bad.any():
        kind[rows[bad]] = OTHER
        words.leave_out(bad)
    rows_before = np.zeros(len(end) + 1, np.int64)
    np.cumsum(kind != OTHER, out=rows_before[1:])
    has_arcs = bool(((kind == ARC_CW) | (kind == ARC_CCW)).any())
    letters = AXES + ARC_WORDS if has_arcs else AXES
    return Lines(start, end, kind, rows_before, {letter: words.of(letter) for letter in letters}, figures)


def _after(last: np.ndarray) -> np.ndarray:
    """Where each begins, given where each ends."""
    first = np.zeros_like(last)
    np.add(last[:-1], 1, out=first[1:])
    return first


def _kinds(text: np.ndarray, start: np.ndarray) -> np.ndarray:
    """(n,) int8: what each line looks like by its first five bytes."""
    b0, b1, b2 = (text.take(start + i, mode="clip") for i in range(3))
    g = b0 == ord("G")
    blank = g & (b2 == _BLANK)
    kind = np.where(blank & (b1 >= ord("0")) & (b1 <= ord("3")), b1.view(np.int8) - ord("0"), OTHER).astype(np.int8)
    kind[kind == 1] = MOVE
    rare = np.flatnonzero(g & ~blank)
    b1, b2, b3, b4 = (text.take(start[rare] + i, mode="clip") for i in range(1, 5))
    kind[rare[(b1 == ord("9")) & (b2 == ord("2")) & (b3 == _BLANK) & (b4 == ord("E"))]] = SET_E
    over = (b3 == ord("\n")) | (b3 == ord("\r")) | (b3 == ord(";")) | ((b3 == _BLANK) & (b4 == ord(";")))
    kind[rare[(b1 == ord("1")) & (b2 == ord("0")) & over]] = RETRACT
    kind[rare[(b1 == ord("1")) & (b2 == ord("1")) & over]] = UNRETRACT
    return kind


def _code_end(stop_byte: np.ndarray, last_piece: np.ndarray) -> np.ndarray:
    """(n,) int64: each line's last piece that is no comment and no checksum."""
    code_end = last_piece.copy()
    marks = np.flatnonzero((stop_byte == ord(";")) | (stop_byte == ord("*")))
    line = np.searchsorted(last_piece, marks)
    code_end[line[::-1]] = marks[::-1]  # of those in one line the first is put down last
    return code_end


class _Words:
    """The words of rows, all that follows a line's command: their rows, letters and numbers."""

    def __init__(
        self, text: np.ndarray, figures: Figures, stops: np.ndarray, first_piece: np.ndarray, last_piece: np.ndarray
    ) -> None:
        """first_piece, last_piece : (m,) int64, indices of stops, of each row's code"""
        count = last_piece - first_piece
        behind = np.cumsum(count)
        piece = np.arange(1, int(count.sum()) + 1) + np.repeat(first_piece - behind + count, count)
        self._row = np.repeat(np.arange(len(count)), count)
        end, letter_at = stops.take(piece), stops.take(piece - 1) + 1
        self._letter, sign = text.take(letter_at), text.take(letter_at + 1, mode="clip")
        minus = sign == ord("-")
        self._numbers, sound = figures.numbers(letter_at + 1 + minus, end)
        self._numbers[minus] *= -1.0
        letters = (self._letter >= ord("A")) & (self._letter <= ord("Z"))
        self._odd = ~(sound & letters | (end == letter_at))  # empty: two blanks, a blank at the end, a carriage return

    def bad_rows(self, e_only: np.ndarray) -> np.ndarray:
        """(m,) bool: rows that hold a word of another shape, or, where they are `e_only`, of another letter than E."""
        odd = self._odd
        if e_only.any():
            odd = odd | ((self._letter >= ord("A")) & (self._letter != ord("E")) & e_only.take(self._row))
        rows = np.zeros(len(e_only), bool)
        rows[self._row[odd]] = True
        return rows

    def leave_out(self, rows: np.ndarray) -> None:
        """Forget rows and their words, and count the others anew; (m,) bool."""
        self._letter[rows.take(self._row)] = 0
        self._row = (np.cumsum(~rows) - 1).take(self._row)

    def of(self, letter: int) -> tuple[np.ndarray, np.ndarray]:
        """The rows that have this letter, and its numbers."""
        pick = np.flatnonzero(self._letter == letter)
        return self._row.take(pick), self._numbers.take(pick)


_EIGHT = 8
_LAST = np.array([(1 << 64) - (1 << (64 - 8 * n)) for n in range(_EIGHT + 1)], np.uint64)  # keeps the last n bytes
_TEN_TO = np.array([10**k for k in range(MOST_CHARACTERS + 1)], np.uint64)
_SCALE = np.array([1.0] + [float(10**k) for k in range(MOST_CHARACTERS + 1)])


def _each(byte: int) -> np.uint64:
    return np.uint64(byte * 0x0101010101010101)


class Figures:
    """Reads decimal numbers in a chunk's bytes.

    worth : (len(chunk),) uint8, see _WORTH
    """

    def __init__(self, chunk: bytes) -> None:
        worth = np.frombuffer(_PAD.translate(bytes(_WORTH)) + chunk.translate(bytes(_WORTH)), np.uint8)
        self.worth = worth[len(_PAD) :]
        # Entry i: the eight bytes before byte i of the chunk.
        self._before = np.ndarray(len(chunk) + 1, f"V{_EIGHT}", worth.data, offset=len(_PAD) - _EIGHT, strides=(1,))

    def numbers(self, begin: np.ndarray, end: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(n,) float64, the numbers in [begin, end), each equal to float() of its text; and (n,) bool, whether it is one.

        A number is digits with at most one dot, MOST_CHARACTERS at most. Whole numbers below 10^15 and the powers of
        ten that scale them are exact in float64, so that one division rounds once.
        """
        length = end - begin
        whole, point, sound = self._eight(end, length)
        long = np.flatnonzero(length > _EIGHT)
        if len(long):
            front, front_point, front_sound = self._eight(end[long] - _EIGHT, length[long] - _EIGHT)
            back_point = point[long]
            whole[long] += front * _TEN_TO.take(_EIGHT - (back_point > 0))
            point[long] = np.where(front_point > 0, front_point + _EIGHT, back_point)
            sound[long] &= front_sound & ~((front_point > 0) & (back_point > 0))
        sound &= (length > (point > 0)) & (length <= MOST_CHARACTERS)
        return whole / _SCALE.take(point, mode="clip"), sound

    def _eight(self, end: np.ndarray, length: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The digits among the last `length` of the eight bytes before `end` as a whole number, (n,) uint64; where their
        dot is, (n,) int64: 1 for the last byte to 8 for the first, 0 for nowhere; whether there is nothing else."""
        digits = self._before[end].view("<u8") & _LAST.take(length, mode="clip")
        dot = digits & _each(0x10)
        sound = ((digits & _each(_ELSE)) | (dot & (dot - np.uint64(1)))) == 0
        digits ^= dot
        digits += (digits & (np.maximum(dot >> np.uint64(4), 1) - np.uint64(1))) * np.uint64(0xFF)  # closes the gap
        # Neighbours are added up: pairs of digits, then pairs of pairs, then both halves.
        digits = (digits * np.uint64((10 << 8) + 1) >> np.uint64(8)) & np.uint64(0x00FF00FF00FF00FF)
        digits = (digits * np.uint64((100 << 16) + 1) >> np.uint64(16)) & np.uint64(0x0000FFFF0000FFFF)
        whole = digits * np.uint64((10000 << 32) + 1) >> np.uint64(32)
        point = (dot * np.uint64(0x0807060504030201) >> np.uint64(60)).view(np.int64)  # its byte's number goes on top
        return whole, point, sound
