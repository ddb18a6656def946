"""The interpreter's moves for a whole run of rows at once: same semantics, numpy instead of a loop.

`interpreter.py` is the reference for what each line means; here only the shapes that `rows.py` recognises occur, and
no mode changes within a run.
"""

from __future__ import annotations

import numpy as np

from .arcs import LEAST_MOVE_MM, MAX_CHORDS, centres_by_radius, chords
from .interpreter import FARTHEST_MM, LEAST_FEED_MM, Interpreter
from .rows import ARC_CCW, ARC_CW, MOVE, RETRACT, SET_E, UNRETRACT, Lines
from .travels import FAR_MM

_QUIET, _BEAD, _RETRACT, _STOP = 0, 1, 2, 3
_E = ord("E")


class Walk:
    """A run of rows [first, last) executed. The machine's state is only changed by `apply`.

    sane        : False where a number is damaged; then the interpreter must take the run line by line
    path        : (n, 8) float32, the beads as from Interpreter.take
    beads_upto  : (rows + 1,) int64, beads laid before each row of the run
    """

    def __init__(self, machine: Interpreter, lines: Lines, kind: np.ndarray, first: int, last: int) -> None:
        self._machine = machine
        self._kind = kind[first:last]
        self._words = {code: (said[first:last], values[first:last]) for code, (said, values) in lines.words.items()}
        self._position = self._positions()
        self._e_after, self._feed = self._feeds()
        farthest = max(np.abs(self._position).max(), np.abs(self._feed).max(), np.abs(self._e_after).max())
        self.sane = bool(farthest < FARTHEST_MM)
        if self.sane:
            self._lay()

    def _positions(self) -> np.ndarray:
        """(rows + 1, 3) float64: where the nozzle is before each row, and at the end."""
        machine = self._machine
        position = np.empty((len(self._kind) + 1, 3))
        for i, letter in enumerate("XYZ"):
            said, values = self._words[ord(letter)]
            values = values * machine.unit_mm
            column = position[:, i]
            column[0] = machine.position[i]
            if machine.relative:
                column[1:] = values  # 0 where not said
                np.cumsum(column, out=column)
            else:
                column[1:] = values + machine.places.offset[i]
                column[:] = column[_last_said(said)]
        return position

    def _feeds(self) -> tuple[np.ndarray, np.ndarray]:
        """E after each row, and what each row feeds: (rows + 1,), (rows,)."""
        machine = self._machine
        said, values = self._words[_E]
        values = values * machine.e_unit_mm
        reset = self._kind == SET_E
        moves = said & ~reset
        e = np.concatenate([[machine.e], values])
        if machine.relative or machine.relative_e:
            feed = np.where(moves, values, 0.0)
            begin = 0
            for end in [*(np.flatnonzero(reset) + 1).tolist(), len(e)]:  # E grows from each reset to the next
                e[begin + 1 : end] = feed[begin : end - 1]
                np.cumsum(e[begin:end], out=e[begin:end])
                begin = end
            return e, feed
        e = e[_last_said(said)]
        return e, np.where(moves, e[1:] - e[:-1], 0.0)

    def _lay(self) -> None:
        kind, position, feed = self._kind, self._position, self._feed
        step = np.abs(np.diff(position, axis=0))
        moved = (step[:, 0] > LEAST_MOVE_MM) | (step[:, 1] > LEAST_MOVE_MM)
        feeds = feed > LEAST_FEED_MM
        bead = feeds & moved & (kind == MOVE)
        self._class = np.zeros(len(kind), np.int8)
        self._class[(kind == MOVE) & (moved | (step[:, 2] > LEAST_MOVE_MM) | feeds)] = _STOP
        self._class[kind == UNRETRACT] = _STOP
        arcs = np.flatnonzero((kind == ARC_CW) | (kind == ARC_CCW))
        self._class[arcs] = _STOP
        self._class[bead] = _BEAD
        self._class[(feed < -LEAST_FEED_MM) | (kind == RETRACT)] = _RETRACT

        count = bead.astype(np.int64)
        fed = feed / self._machine.feed_area_mm2 * self._machine.flow
        expanded = self._arcs(arcs, fed) if len(arcs) else None
        if expanded is not None:
            rows, counts, _, _ = expanded
            count[rows] = counts
            self._class[rows] = _BEAD
        self.beads_upto = np.concatenate([[0], np.cumsum(count)])
        self.path = np.zeros((int(self.beads_upto[-1]), 8), np.float32)
        moves = np.flatnonzero(bead)
        at = self.beads_upto[moves]
        self.path[at, :3] = position[moves]
        self.path[at, 3:6] = position[moves + 1]
        self.path[at, 6] = fed[moves]
        if expanded is not None:
            rows, counts, start_end, fed_each = expanded
            at = np.repeat(self.beads_upto[rows] - (np.cumsum(counts) - counts), counts) + np.arange(counts.sum())
            self.path[at, :6] = start_end
            self.path[at, 6] = fed_each
        self._count = count
        self._travel = (kind == MOVE) & moved & ~feeds

    def _arcs(self, arcs: np.ndarray, fed: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray] | None:
        """The extruding arcs: their rows, chords of each, and start, end (n, 6) and feed (n,) of all chords."""
        unit = self._machine.unit_mm
        words = {
            chr(code): (said[arcs], values[arcs]) for code, (said, values) in self._words.items() if chr(code) in "IJRP"
        }
        start, end = self._position[arcs], self._position[arcs + 1]
        clockwise = self._kind[arcs] == ARC_CW
        offset = np.column_stack([words["I"][1], words["J"][1]]) * unit
        centre = np.where((words["I"][0] | words["J"][0])[:, None], start[:, :2] + offset, np.nan)
        by_radius = words["R"][0]
        if by_radius.any():
            found = centres_by_radius(start, end, words["R"][1] * unit, clockwise)
            centre[by_radius] = found[by_radius]
        self.pathless = int(np.isnan(centre[:, 0]).sum())
        feeds = self._feed[arcs] > LEAST_FEED_MM
        if not feeds.any():
            return None
        rows, start, end = arcs[feeds], start[feeds], end[feeds]
        turns = np.clip(words["P"][1][feeds], 0, 1e6).astype(np.int64)
        most = self._machine.most_chords(len(rows))
        counts, points = chords(start, end, centre[feeds], clockwise[feeds], turns, most)
        self._coarse = len(rows) if most < MAX_CHORDS and bool((counts == most).any()) else 0
        before = np.empty_like(points)
        before[1:] = points[:-1]
        heads = np.cumsum(counts) - counts
        before[heads] = start
        lengths = np.linalg.norm(points - before, axis=1)
        whole = np.add.reduceat(lengths, heads)
        laid = whole > LEAST_MOVE_MM
        each = np.repeat(laid, counts)
        share = lengths / np.repeat(np.maximum(whole, LEAST_MOVE_MM), counts)
        fed_each = np.repeat(fed[rows], counts) * share
        return rows[laid], counts[laid], np.column_stack([before, points])[each], fed_each[each]

    pathless = _coarse = 0

    def apply(self, end_pos: np.ndarray, stops: np.ndarray) -> np.ndarray:
        """Bring the machine to the end of the run. Returns the beads' end positions, (n,) int64.

        end_pos : (rows,) file position after each row
        stops   : rows of the run before which a command stands that ends a layer's retraction
        """
        machine = self._machine
        self._find_tails(end_pos, stops)
        self._find_travels(end_pos)
        machine.position = self._position[-1].tolist()
        machine.e = float(self._e_after[-1])
        fed = np.cumsum(np.concatenate([[machine.fed.get(machine.tool, 0.0)], self._feed / machine.feed_area_mm2]))
        machine.fed[machine.tool] = float(fed[-1])
        machine.most_fed[machine.tool] = max(machine.most_fed.get(machine.tool, 0.0), float(fed.max()))
        machine.skipped += self.pathless
        machine.coarse += self._coarse
        machine.laid += len(self.path)
        return np.repeat(end_pos, self._count)

    def _find_travels(self, end_pos: np.ndarray) -> None:
        """Note the travels that lead far away from the last bead."""
        machine = self._machine
        last_bead = _last_said(self._count > 0)  # where the nozzle is after it, for each row and at the end
        rows = np.flatnonzero(self._travel)
        before, place = last_bead.take(rows), self._position[rows + 1, :2]
        beyond = np.abs(place - np.where((before > 0)[:, None], self._position[before, :2], machine.last_xy))
        far = np.maximum(beyond[:, 0], beyond[:, 1]) >= FAR_MM
        laid = machine.laid + self.beads_upto[rows[far]]
        for bead, end, (x, y) in zip(laid.tolist(), end_pos[rows[far]].tolist(), place[far].tolist()):
            machine.travels.add(bead - 1, end, x, y)
        if last_bead[-1] > 0:
            machine.last_xy = (float(self._position[last_bead[-1], 0]), float(self._position[last_bead[-1], 1]))

    def _find_tails(self, end_pos: np.ndarray, stops: np.ndarray) -> None:
        """Note the retractions that follow a bead directly: nothing but quiet commands between."""
        machine = self._machine
        # As a row before the first: the last bead of the run before, if its tail is still open.
        class_ = np.concatenate([[_BEAD if machine.tail_open and machine.laid else _STOP], self._class])
        ordinal = np.arange(len(class_))
        breaks = np.where(class_ == _STOP, ordinal, 0)
        broken = np.zeros(len(class_) + 1, bool)
        broken[np.asarray(stops, np.int64) + 1] = True
        breaks = np.maximum(breaks, np.where(broken[:-1], ordinal, 0))
        last_break = np.maximum.accumulate(breaks)
        last_bead = np.maximum.accumulate(np.where(class_ == _BEAD, ordinal, -1))
        open_ = (last_bead >= 0) & (last_bead >= last_break)
        tails = np.flatnonzero((class_ == _RETRACT) & open_)
        beads = machine.laid + self.beads_upto[last_bead[tails]] - 1
        machine.tails[0].extend(beads.tolist())
        machine.tails[1].extend(end_pos[tails - 1].tolist())
        machine.tail_open = bool(open_[-1]) and not broken[-1]


def _last_said(said: np.ndarray) -> np.ndarray:
    """(n + 1,) indices: for each row and the state before it (0), where its value was said last."""
    index = np.zeros(len(said) + 1, np.int64)
    np.multiply(said, np.arange(1, len(said) + 1), out=index[1:])
    return np.maximum.accumulate(index)
