"""A printer's state, moved line by line through G-code, and what it lays down on the way.

Semantics follow Marlin, and Klipper where they differ on relative extrusion: E is relative after M83 *or* G91, and G90
does not take M83 back. (Marlin's G90 does, but a sliced file that meant it would say M82; Klipper's custom macros
leave G90 behind everywhere.)
"""

from __future__ import annotations

import math
import re
from array import array
from collections import Counter

import numpy as np

from .arcs import LEAST_MOVE_MM, centres_by_radius, chords
from .said import Said

FARTHEST_MM = 1e6  # a coordinate beyond is a damaged line, not a place
LEAST_FEED_MM = 1e-7
LONGEST_COMMAND = 4096  # characters; the polygon of an object may be long, but nothing that moves is
FAR_MM = 20.0  # a head this far beyond a layer does not stand before it
INCH_MM = 25.4

_WORD = re.compile(r"([A-Z])\s*([-+]?(?:\d+\.?\d*|\.\d+))?")
_COMMAND = re.compile(r"\s*(?:N\s*\d+\s*)?([GMT])\s*(\d{1,6})(?:\.(\d+))?", re.IGNORECASE)
_MACRO = re.compile(r"\s*(?:N\s*\d+\s*)?([A-Za-z_]\w*)\s*(.*)")
_NAMED = re.compile(r"\bNAME=(\"[^\"]*\"|'[^']*'|\S+)", re.IGNORECASE)

# Commands that neither move nor extrude nor wait: a layer's retraction may have them in its midst.
_QUIET = frozenset((73, 106, 107, 117, 118, 204, 205, 220, 221, 400, 486, 572, 593, 900))


class Travels:
    """Moves without extrusion that end FAR_MM or more, in X or in Y, from the end of the last bead.

    bead : index of the bead before; end_pos : where the move ends in the file; x, y : where it ends over the bed, mm
    """

    def __init__(self) -> None:
        self.bead, self.end_pos, self.x, self.y = array("q"), array("q"), array("d"), array("d")

    def add(self, bead: int, end_pos: int, x: float, y: float) -> None:
        self.bead.append(bead)
        self.end_pos.append(end_pos)
        self.x.append(x)
        self.y.append(y)


class Interpreter:
    """The machine's state. `run` one line after the other; `said` and the beads taken by `take` hold what came of it.

    laid  : how many beads there are so far
    tails : beads that a retraction directly follows, and the positions where it ends; the last of a bead counts
    travels : moves between beads that lead far away from the last one
    last_xy : where the last bead ends
    """

    def __init__(self, relative_e: bool = False) -> None:
        self.said = Said()
        self.laid = 0
        self.last_xy = (0.0, 0.0)
        self._path, self._end_pos = array("f"), array("q")
        self.position = [0.0, 0.0, 0.0]  # of the nozzle over the bed, mm
        self.offset = [0.0, 0.0, 0.0]  # added to the file's coordinates: G92
        self.e = 0.0  # the file's E, mm
        self.relative, self.relative_e = False, relative_e
        self.unit_mm = 1.0
        self.flow = 1.0
        self.volumetric = False
        self.filament_mm: float | None = None  # the diameter that M200 told
        self.tool = 0
        self.fed: dict[int, float] = {}  # tool -> net filament
        self.most_fed: dict[int, float] = {}  # tool -> the highest it has been
        self.m486 = -1
        self.primed_mm: float | None = None  # filament used before the first layer comment
        self.tails = (array("q"), array("q"))
        self.travels = Travels()
        self.tail_open = False
        self.skipped = 0
        self.unknown: Counter[str] = Counter()

    def run(self, line: str, end_pos: int) -> None:
        """Execute one line of the file, which ends at `end_pos`."""
        code, semicolon, comment = line.partition(";")
        if semicolon:
            self.comment(comment)
        code = _outside_parentheses(code[:LONGEST_COMMAND])
        if not code.strip():
            return
        command = _COMMAND.match(code)
        if command is None:
            self._macro(code, end_pos)
            return
        letter, number = command.group(1).upper(), int(command.group(2))
        if command.group(3) and int(command.group(3)):
            self.tail_open = False
            self.unknown[f"{letter}{number}.{command.group(3)}"] += 1
            return
        rest = code[command.end() :].partition("*")[0]
        if letter == "G":
            self._g(number, rest, end_pos)
        elif letter == "M":
            self._m(number, rest, end_pos)
        else:
            self.tool = number
            self.tail_open = False

    def comment(self, text: str) -> None:
        """Take note of a comment, the text after the semicolon."""
        self.said.comment(text, self.laid)
        if self.primed_mm is None and self.said.layers:
            self.primed_mm = sum(self.most_fed.values())

    # -- motion ------------------------------------------------------------------------------------------------------

    @property
    def e_unit_mm(self) -> float:
        return 1.0 if self.volumetric else self.unit_mm

    def _words(self, rest: str) -> dict[str, float | None]:
        return {letter: float(value) if value else None for letter, value in _WORD.findall(rest.upper())}

    def _g(self, number: int, rest: str, end_pos: int) -> None:
        if number in (0, 1):
            self._move(self._words(rest), end_pos)
        elif number in (2, 3):
            self._arc(self._words(rest), number == 2, end_pos)
        elif number == 92:
            self._set_position(self._words(rest))
        elif number == 28:
            words = self._words(rest)
            homed = [i for i, axis in enumerate("XYZ") if axis in words] or [0, 1, 2]
            for i in homed:
                self.position[i] = self.offset[i] = 0.0
            self.tail_open = False
        elif number in (90, 91):
            self.relative = number == 91
        elif number in (20, 21):
            self.unit_mm = INCH_MM if number == 20 else 1.0
        elif number == 10:
            # RepRapFirmware's G10 with P or L sets a tool up; without, firmware retraction: no geometry, no E.
            if not {"P", "L", "X", "Y", "Z"} & self._words(rest).keys():
                self._retracted(end_pos)
        elif number not in (4, 11, 17, 21, 29, 80):
            self.tail_open = False
            self.unknown[f"G{number}"] += 1
        else:
            self.tail_open = self.tail_open and number == 17

    def _target(self, words: dict[str, float | None]) -> tuple[list[float], float] | None:
        """Where a move goes and how much it feeds, or None where its numbers are damaged."""
        target = list(self.position)
        for i, axis in enumerate("XYZ"):
            value = words.get(axis)
            if value is not None:
                value *= self.unit_mm
                target[i] = target[i] + value if self.relative else value + self.offset[i]
        feed, e = 0.0, self.e
        value = words.get("E")
        if value is not None:
            value *= self.e_unit_mm
            feed = value if self.relative or self.relative_e else value - self.e
            e = self.e + value if self.relative or self.relative_e else value
        if not max(abs(target[0]), abs(target[1]), abs(target[2]), abs(feed), abs(e)) < FARTHEST_MM:
            self.skipped += 1
            return None
        self.e = e
        return target, feed

    def _move(self, words: dict[str, float | None], end_pos: int) -> None:
        goal = self._target(words)
        if goal is None:
            return
        target, feed = goal
        start = self.position
        moved = abs(target[0] - start[0]) > LEAST_MOVE_MM or abs(target[1] - start[1]) > LEAST_MOVE_MM
        lifted = abs(target[2] - start[2]) > LEAST_MOVE_MM
        self._feed(feed)
        if feed > LEAST_FEED_MM and moved:
            self._lay(start, target, self.on_bed_mm(feed), end_pos)
            self.tail_open = True
        elif feed < -LEAST_FEED_MM:
            self._retracted(end_pos)
        elif moved or lifted or feed > LEAST_FEED_MM:
            self.tail_open = False
        x, y = self.last_xy
        if moved and feed <= LEAST_FEED_MM and max(abs(target[0] - x), abs(target[1] - y)) >= FAR_MM:
            self.travels.add(self.laid - 1, end_pos, target[0], target[1])
        self.position = target

    def _arc(self, words: dict[str, float | None], clockwise: bool, end_pos: int) -> None:
        goal = self._target(words)
        if goal is None:
            return
        target, feed = goal
        start, end = np.array([self.position]), np.array([target])
        centre = self._arc_centre(words, start, end, clockwise)
        turns = np.array([int(min(max(words.get("P") or 0.0, 0.0), 1e6))])
        _, points = chords(start, end, centre, np.array([clockwise]), turns)
        self._feed(feed)
        path = np.concatenate([start, points])
        lengths = np.linalg.norm(np.diff(path, axis=0), axis=1)
        whole = float(lengths.sum())
        if feed > LEAST_FEED_MM and whole > LEAST_MOVE_MM:
            for k, length in enumerate(lengths.tolist()):
                self._lay(path[k].tolist(), path[k + 1].tolist(), self.on_bed_mm(feed) * length / whole, end_pos)
            self.tail_open = True
        elif feed < -LEAST_FEED_MM:
            self._retracted(end_pos)
        else:
            self.tail_open = False
        self.position = target

    def _arc_centre(
        self, words: dict[str, float | None], start: np.ndarray, end: np.ndarray, clockwise: bool
    ) -> np.ndarray:
        """(1, 2), NaN where the words tell none: then the arc is taken for a straight move."""
        radius = words.get("R")
        if radius is not None:
            centre = centres_by_radius(start, end, np.array([radius * self.unit_mm]), np.array([clockwise]))
        elif words.get("I") is not None or words.get("J") is not None:
            centre = start[:, :2] + np.array([[words.get("I") or 0.0, words.get("J") or 0.0]]) * self.unit_mm
        else:
            centre = np.full((1, 2), np.nan)
        self.skipped += int(np.isnan(centre[0, 0]))
        return centre

    def _set_position(self, words: dict[str, float | None]) -> None:
        """G92. Bare, it sets all axes to zero, as in RepRap's specification, Klipper and OctoPrint."""
        if not any(axis in words for axis in "XYZE"):
            words = {"X": 0.0, "Y": 0.0, "Z": 0.0, "E": 0.0}
        for i, axis in enumerate("XYZ"):
            value = words.get(axis)
            if value is not None and abs(value) < FARTHEST_MM:
                self.offset[i] = self.position[i] - value * self.unit_mm
        value = words.get("E")
        if value is not None and abs(value) < FARTHEST_MM:
            self.e = value * self.e_unit_mm

    # -- extrusion ---------------------------------------------------------------------------------------------------

    def _lay(self, start: list[float], end: list[float], fed_mm: float, end_pos: int) -> None:
        self._path.extend((*start, *end, fed_mm, 0.0))
        self._end_pos.append(end_pos)
        self.laid += 1
        self.last_xy = (end[0], end[1])

    def take(self) -> tuple[np.ndarray, np.ndarray]:
        """The beads laid since the last call: (n, 8) float32, x0 y0 z0 x1 y1 z1, filament fed in mm, 0; (n,) int64."""
        path, end_pos = self._path, self._end_pos
        self._path, self._end_pos = array("f"), array("q")
        return np.array(path, np.float32).reshape(-1, 8), np.array(end_pos, np.int64)

    def on_bed_mm(self, feed: float) -> float:
        """Length of filament that reaches the bed, with the flow factor; or mm³, see `assemble`."""
        return feed / self.feed_area_mm2 * self.flow

    @property
    def feed_area_mm2(self) -> float:
        """What E must be divided by to be a length of filament."""
        return math.pi / 4.0 * self.filament_mm**2 if self.volumetric and self.filament_mm else 1.0

    def _feed(self, feed: float) -> None:
        fed = self.fed.get(self.tool, 0.0) + feed / self.feed_area_mm2
        self.fed[self.tool] = fed
        if fed > self.most_fed.get(self.tool, 0.0):
            self.most_fed[self.tool] = fed

    def _retracted(self, end_pos: int) -> None:
        if self.tail_open and self.laid:
            beads, ends = self.tails
            last = self.laid - 1
            if beads and beads[-1] == last:
                ends[-1] = end_pos
            else:
                beads.append(last)
                ends.append(end_pos)

    # -- everything else ---------------------------------------------------------------------------------------------

    def _m(self, number: int, rest: str, end_pos: int) -> None:
        if number in (82, 83):
            self.relative_e = number == 83
        elif number == 200:
            self._volumetric(self._words(rest))
        elif number == 221:
            words = self._words(rest)
            percent = words.get("S")
            if percent and 0.0 < percent < 1000.0:
                self.flow = percent / 100.0
        elif number == 486:
            self._m486(rest, end_pos)
        if number not in _QUIET:
            self.tail_open = False

    def _volumetric(self, words: dict[str, float | None]) -> None:
        """M200: D0 or S0 ends volumetric extrusion, a diameter or S1 begins it."""
        diameter, switch = words.get("D"), words.get("S")
        if diameter is not None and 0.0 < diameter < 100.0:
            self.filament_mm = diameter
        self.volumetric = bool(switch) if switch is not None else bool(diameter)

    def _m486(self, rest: str, end_pos: int) -> None:
        """Marlin's and RepRapFirmware's objects: S selects (-1 none), A names, P cancels, C cancels the current one."""
        name = re.match(r"\s*A\s*\"?(.*?)\"?\s*$", rest, re.IGNORECASE)
        if name:
            self._name_m486(name.group(1))
            return
        named = re.search(r"\bA\"([^\"]*)\"", rest, re.IGNORECASE)
        words = self._words(rest[: named.start()] if named else rest)
        if words.get("S") is not None:
            self.m486 = max(int(words["S"] or 0), -1)
            self._label_m486()
        if named:
            self._name_m486(named.group(1))
        if words.get("P") is not None:
            self.said.cancelled.append(("m486", str(int(words["P"] or 0)), end_pos))
        if "C" in words and self.m486 >= 0:
            self.said.cancelled.append(("m486", str(self.m486), end_pos))

    def _name_m486(self, name: str) -> None:
        if self.m486 >= 0 and name:
            self.said.m486_names[self.m486] = name

    def _label_m486(self) -> None:
        self.said.label("m486", None if self.m486 < 0 else str(self.m486), self.laid)

    def _macro(self, code: str, end_pos: int) -> None:
        """Words that are no G, M or T: Klipper's macros, OctoPrint's @ commands, anything else."""
        text = code.strip()
        if text.startswith("@"):
            word, _, rest = text[1:].partition(" ")
            if word.lower() == "object":
                self.said.label("at_object", rest.strip() or None, self.laid)
            elif word.lower() == "objectend":
                self.said.label("at_object", None, self.laid)
            return
        found = _MACRO.match(code)
        word = found.group(1).upper() if found else text[:1]
        named = _NAMED.search(code) if found else None
        name: str | None = named.group(1).strip("\"'") if named else None
        if word == "EXCLUDE_OBJECT_START":
            self.said.label("exclude_object", name, self.laid)
        elif word == "EXCLUDE_OBJECT_END":
            self.said.label("exclude_object", None, self.laid)
        elif word == "EXCLUDE_OBJECT":
            self._exclude(name, code.upper(), end_pos)
        elif word != "EXCLUDE_OBJECT_DEFINE":
            self.tail_open = False
            self.unknown[word] += 1

    def _exclude(self, name: str | None, code: str, end_pos: int) -> None:
        if name is None and "CURRENT=1" in code:
            labels = self.said.labels.get("exclude_object")
            name = labels.current() if labels else None
        if name is not None:
            self.said.cancelled.append(("exclude_object", name, end_pos))


def _outside_parentheses(code: str) -> str:
    """Code without its comments in parentheses; one that is not closed stays."""
    if "(" not in code:
        return code
    kept: list[str] = []
    rest = code
    while True:
        before, opened, after = rest.partition("(")
        _, closed, behind = after.partition(")")
        if not (opened and closed):
            return " ".join([*kept, rest])
        kept.append(before)
        rest = behind
