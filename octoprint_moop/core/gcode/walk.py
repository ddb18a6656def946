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
        self._words = {}
        for letter, (rows, numbers) in lines.words.items():
            among = slice(*np.searchsorted(rows, (first, last)))
            self._words[letter] = rows[among] - first, numbers[among]
        self._place = [self._coordinate(i) for i in range(3)]
        self._e_after, self._feed = self._feeds()
        farthest = max(np.abs(column).max() for column in (*self._place, self._feed, self._e_after))
        self.sane = bool(farthest < FARTHEST_MM)
        if self.sane:
            self._lay()

    def _coordinate(self, axis: int) -> np.ndarray:
        """(rows + 1,) float64: where the nozzle is before each row, and at the end; X, Y or Z."""
        machine = self._machine
        rows, numbers = self._words[ord("XYZ"[axis])]
        numbers = numbers * machine.unit_mm
        if machine.relative:
            return np.cumsum(np.concatenate([[machine.position[axis]], self._spread(rows, numbers)]))
        return self._held(machine.position[axis], rows, numbers + machine.places.offset[axis])

    def _held(self, before: float, rows: np.ndarray, values: np.ndarray) -> np.ndarray:
        """(rows + 1,): what holds before each row, and at the end, where each value holds from after its row on."""
        bounds = np.concatenate([[0], rows + 1, [len(self._kind) + 1]])
        return np.repeat(np.concatenate([[before], values]), bounds[1:] - bounds[:-1])

    def _spread(self, rows: np.ndarray, values: np.ndarray) -> np.ndarray:
        """(rows,): the value of each row, 0 of those that have none."""
        spread = np.zeros(len(self._kind))
        spread[rows] = values
        return spread

    def _feeds(self) -> tuple[np.ndarray, np.ndarray]:
        """E after each row, and what each row feeds: (rows + 1,), (rows,)."""
        machine = self._machine
        rows, numbers = self._words[_E]
        numbers = numbers * machine.e_unit_mm
        reset = np.flatnonzero(self._kind == SET_E)
        if not (machine.relative or machine.relative_e):
            e = self._held(machine.e, rows, numbers)
            feed = e[1:] - e[:-1]
            feed[reset] = 0.0
            return e, feed
        feed = self._spread(rows, numbers)
        e = np.concatenate([[machine.e], feed])
        feed[reset] = 0.0
        begin = 0
        for end in [*(reset + 1).tolist(), len(e)]:  # E grows from each reset to the next
            np.cumsum(e[begin:end], out=e[begin:end])
            begin = end
        return e, feed

    def _lay(self) -> None:
        x, y, z = self._place
        move = self._kind == MOVE
        self._moved = (np.abs(x[1:] - x[:-1]) > LEAST_MOVE_MM) | (np.abs(y[1:] - y[:-1]) > LEAST_MOVE_MM)
        self._feeds_any = self._feed > LEAST_FEED_MM
        bead = self._feeds_any & self._moved & move
        fed = self._feed / self._machine.feed_area_mm2 * self._machine.flow
        path = np.zeros((len(bead), 8), np.float32)
        for i, column in enumerate((x[:-1], y[:-1], z[:-1], x[1:], y[1:], z[1:], fed)):
            path[:, i] = column
        self.beads_upto = np.zeros(len(bead) + 1, np.int64)
        arcs = np.flatnonzero((self._kind == ARC_CW) | (self._kind == ARC_CCW))
        expanded = self._arcs(arcs, fed) if len(arcs) else None
        if expanded is None:
            self._laying = np.flatnonzero(bead)  # rows that lay beads
            self._count = np.ones(len(self._laying), np.int64)
            np.cumsum(bead, out=self.beads_upto[1:])
            self.path = path.take(self._laying, axis=0)
            return
        rows, counts, start_end, fed_each = expanded
        count = bead.astype(np.int64)
        count[rows] = counts
        self._laying = np.flatnonzero(count)
        self._count = count[self._laying]
        np.cumsum(count, out=self.beads_upto[1:])
        self.path = path.repeat(count, axis=0)
        at = np.repeat(self.beads_upto[rows] - (np.cumsum(counts) - counts), counts) + np.arange(counts.sum())
        self.path[at, :6] = start_end
        self.path[at, 6] = fed_each

    def _arcs(self, arcs: np.ndarray, fed: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray] | None:
        """The extruding arcs: their rows, chords of each, and start, end (n, 6) and feed (n,) of all chords."""
        unit = self._machine.unit_mm
        said = {letter: np.isin(arcs, self._words[ord(letter)][0]) for letter in "IJR"}
        words = {letter: self._spread(*self._words[ord(letter)])[arcs] for letter in "IJRP"}
        start, end = (np.column_stack([column[at] for column in self._place]) for at in (arcs, arcs + 1))
        clockwise = self._kind[arcs] == ARC_CW
        offset = np.column_stack([words["I"], words["J"]]) * unit
        centre = np.where((said["I"] | said["J"])[:, None], start[:, :2] + offset, np.nan)
        by_radius = said["R"]
        if by_radius.any():
            found = centres_by_radius(start, end, words["R"] * unit, clockwise)
            centre[by_radius] = found[by_radius]
        self.pathless = int(np.isnan(centre[:, 0]).sum())
        feeds = self._feeds_any[arcs]
        if not feeds.any():
            return None
        rows, start, end = arcs[feeds], start[feeds], end[feeds]
        turns = np.clip(words["P"][feeds], 0, 1e6).astype(np.int64)
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
        stops   : rows of the run before which a command stands that ends a layer's retraction, ascending
        """
        machine = self._machine
        self._find_tails(end_pos, stops)
        self._find_travels(end_pos)
        machine.position = [float(column[-1]) for column in self._place]
        machine.e = float(self._e_after[-1])
        fed = np.cumsum(np.concatenate([[machine.fed.get(machine.tool, 0.0)], self._feed / machine.feed_area_mm2]))
        machine.fed[machine.tool] = float(fed[-1])
        machine.most_fed[machine.tool] = max(machine.most_fed.get(machine.tool, 0.0), float(fed.max()))
        machine.skipped += self.pathless
        machine.coarse += self._coarse
        machine.laid += len(self.path)
        return np.repeat(end_pos.take(self._laying), self._count)

    def _find_travels(self, end_pos: np.ndarray) -> None:
        """Note the travels that lead far away from the last bead."""
        machine, (x, y, _) = self._machine, self._place
        ends = np.concatenate([[0], self._laying + 1])  # rows before which each bead, and that of the run before, ends
        last_x, last_y = x.take(ends), y.take(ends)
        last_x[0], last_y[0] = machine.last_xy
        rows = np.flatnonzero((self._kind == MOVE) & self._moved & ~self._feeds_any)
        before = np.searchsorted(self._laying, rows)
        beyond_x, beyond_y = (
            np.abs(x.take(rows + 1) - last_x.take(before)),
            np.abs(y.take(rows + 1) - last_y.take(before)),
        )
        far = rows[np.maximum(beyond_x, beyond_y) >= FAR_MM]
        laid, to = machine.laid + self.beads_upto[far], far + 1
        for bead, end, to_x, to_y in zip(laid.tolist(), end_pos[far].tolist(), x[to].tolist(), y[to].tolist()):
            machine.travels.add(bead - 1, end, to_x, to_y)
        machine.last_xy = (float(last_x[-1]), float(last_y[-1]))

    def _find_tails(self, end_pos: np.ndarray, stops: np.ndarray) -> None:
        """Note the retractions that follow a bead directly: nothing but quiet commands between.

        That is so where beads were laid since the last row that breaks a tail, or command before a row.
        """
        machine, kind, z = self._machine, self._kind, self._place[2]
        retracts = (self._feed < -LEAST_FEED_MM) | (kind == RETRACT)
        breaks = (kind >= ARC_CW) & (kind <= ARC_CCW) | (kind == UNRETRACT)
        breaks |= (kind == MOVE) & (self._moved | self._feeds_any | (np.abs(z[1:] - z[:-1]) > LEAST_MOVE_MM))
        breaks &= ~retracts
        breaks[self._laying] = False
        broken = np.sort(np.concatenate([np.flatnonzero(breaks), stops]), kind="stable")
        # Before the first break: whether beads are laid, or the tail of the run before is still open.
        since = np.concatenate([[-1 if machine.tail_open and machine.laid else 0], self.beads_upto[broken]])
        asked = np.append(np.flatnonzero(retracts), len(kind))
        open_ = self.beads_upto[asked] > since[np.searchsorted(broken, asked, side="right")]
        tails = asked[:-1][open_[:-1]]
        machine.tails[0].extend((machine.laid + self.beads_upto[tails] - 1).tolist())
        machine.tails[1].extend(end_pos[tails].tolist())
        machine.tail_open = bool(open_[-1])
