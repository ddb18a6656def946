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

from .arcs import LEAST_MOVE_MM, MAX_CHORDS, bezier, centres_by_radius, chords
from .commands import KEEPS_TAIL_G, NO_PATH_G, NO_PATH_WORDS, QUIET_M, QUIET_WORDS
from .dialects import outside_parentheses
from .objects import ObjectCommands, named
from .places import Places
from .said import Said
from .travels import FAR_MM, Travels

FARTHEST_MM = 1e6  # a coordinate beyond is a damaged line, not a place
LEAST_FEED_MM = 1e-7
LONGEST_COMMAND = 4096  # characters; the polygon of an object may be long, but nothing that moves is
INCH_MM = 25.4

_WORD = re.compile(r"([A-Z])\s*([-+]?(?:\d+\.?\d*|\.\d+))?")
_COMMAND = re.compile(r"\s*(?:N\s*\d+\s*)?([GMT])\s*(\d{1,6})(?:\.(\d+))?", re.IGNORECASE)
_MACRO = re.compile(r"\s*(?:N\s*\d+\s*)?([A-Za-z_]\w*)\s*(.*)")

# What arcs may come to: a file of nothing else must not fill the memory. Beads in all, and for each byte of the file.
SPARE_BEADS, BEADS_PER_BYTE, FEWEST_CHORDS = 200_000, 0.5, 4


class Interpreter:
    """The machine's state. `run` one line after the other; `said` and the beads taken by `take` hold what came of it.

    laid  : how many beads there are so far
    tails : beads that a retraction directly follows, and the positions where it ends; the last of a bead counts
    travels : moves between beads that lead far away from the last one
    last_xy : where the last bead ends
    """

    def __init__(self, relative_e: bool = False, extruder: str = "E") -> None:
        """extruder : the letter that feeds; Mach3, MakerWare and Sailfish say A"""
        self.said, self.extruder = Said(), extruder
        self.laid = 0
        self.last_xy = (0.0, 0.0)
        self._path, self._end_pos = array("f"), array("q")
        self.position = [0.0, 0.0, 0.0]  # of the nozzle over the bed, mm
        self.places = Places()
        self.e = 0.0  # the file's E, mm
        self.relative, self.relative_e = False, relative_e
        self.unit_mm = 1.0
        self.flow = 1.0
        self.volumetric = False
        self.filament_mm: float | None = None  # the diameter that M200 told
        self.tool = 0
        self.fed: dict[int, float] = {}  # tool -> net filament
        self.most_fed: dict[int, float] = {}  # tool -> the highest it has been
        self.objects = ObjectCommands(self.said)
        self.states: dict[str, tuple[bool, bool, float, list[float], list[float]]] = {}
        self.custom_mm = 0.0  # of `most_fed`, what the user's own G-code has fed so far, see `own_gcode`
        self._custom_from: float | None = 0.0
        self.read_bytes = 0  # of the file, or more; the reader tells
        self.coarse = 0  # arcs that were drawn in fewer chords than they deserve
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
        code = outside_parentheses(code[:LONGEST_COMMAND])
        if not code.strip():
            return
        command = _COMMAND.match(code)
        if command is None:
            self._macro(code, end_pos)
            return
        letter, number = command.group(1).upper(), int(command.group(2))
        rest = code[command.end() :].partition("*")[0]
        if command.group(3) and int(command.group(3)):
            self._sub(f"{letter}{number}.{int(command.group(3))}", number)
            return
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
        own = self.said.custom or not (self.said.layers or self.said.role.bead)
        if own != self.own_gcode:
            used = sum(self.most_fed.values())
            if self._custom_from is not None:
                self.custom_mm += used - self._custom_from
            self._custom_from = used if own else None

    def fed_by_own_gcode_mm(self) -> float:
        """Of the filament used, what the user's own G-code fed; nothing where no comment tells it from the rest."""
        if not self.said.layers:
            return 0.0
        now = sum(self.most_fed.values()) - self._custom_from if self._custom_from is not None else 0.0
        return self.custom_mm + now

    @property
    def own_gcode(self) -> bool:
        """What is being read is the user's own G-code: what precedes all layers and features, or is said to be custom."""
        return self._custom_from is not None

    def _sub(self, name: str, number: int) -> None:
        """A command with a decimal: G92.1 takes offsets back, G59.1 to G59.3 are places, others mean other things."""
        self.tail_open = False
        if name == "G92.1":
            self.places.reset()
        elif name in ("G59.1", "G59.2", "G59.3"):
            self.places.select(int(name[-1]) + 6)
        elif name.startswith("G") and number not in NO_PATH_G:
            self.unknown[name] += 1

    # -- motion ------------------------------------------------------------------------------------------------------

    @property
    def e_unit_mm(self) -> float:
        return 1.0 if self.volumetric else self.unit_mm

    def _words(self, rest: str) -> dict[str, float | None]:
        words = {letter: float(value) if value else None for letter, value in _WORD.findall(rest.upper())}
        if self.extruder != "E" and self.extruder in words:
            words["E"] = words.pop(self.extruder)
        return words

    def _g(self, number: int, rest: str, end_pos: int) -> None:
        if number in (0, 1):
            self._move(self._words(rest), end_pos)
        elif number in (2, 3):
            self._arc(self._words(rest), number == 2, end_pos)
        elif number == 92:
            self._set_position(self._words(rest))
        elif number == 5:
            self._bezier(self._words(rest), end_pos)
        elif number == 28:
            words = self._words(rest)
            homed = [i for i, axis in enumerate("XYZ") if axis in words] or [0, 1, 2]
            for i in homed:
                self.position[i] = self.places.offset[i] = 0.0
            self.tail_open = False
        elif number == 53:
            self._in_machine_coordinates(rest, end_pos)
        elif 54 <= number <= 59:
            self.places.select(number - 53)
            self.tail_open = False
        elif number in (90, 91):
            self.relative = number == 91
        elif number in (20, 21):
            self.unit_mm = INCH_MM if number == 20 else 1.0
        elif number == 10:
            # RepRapFirmware's G10 with P or R sets a tool up, with L a place; without, firmware retraction: no E.
            words = self._words(rest)
            if words.get("L") in (2.0, 20.0):
                self.places.define(words, self.position, self.unit_mm)
            elif not {"P", "L", "R", "X", "Y", "Z"} & words.keys():
                self._retracted(end_pos)
        else:
            self.tail_open = self.tail_open and number in KEEPS_TAIL_G
            if number not in NO_PATH_G:
                self.unknown[f"G{number}"] += 1

    def _in_machine_coordinates(self, rest: str, end_pos: int) -> None:
        """G53: the command beside it, without any offset; alone, from now on (Marlin)."""
        if not rest.strip():
            self.places.select(0)
            self.tail_open = False
            return
        offset = self.places.offset
        self.places.offset = [0.0, 0.0, 0.0]
        self.run(rest, end_pos)
        self.places.offset = offset

    def _target(self, words: dict[str, float | None]) -> tuple[list[float], float] | None:
        """Where a move goes and how much it feeds, or None where its numbers are damaged."""
        target = list(self.position)
        for i, axis in enumerate("XYZ"):
            value = words.get(axis)
            if value is not None:
                value *= self.unit_mm
                target[i] = target[i] + value if self.relative else value + self.places.offset[i]
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
        most = self.most_chords(1)
        count, points = chords(start, end, centre, np.array([clockwise]), turns, most)
        self.coarse += int(count[0] == most < MAX_CHORDS)
        self._follow(np.concatenate([start, points]), feed, end_pos)
        self.position = target

    def most_chords(self, arcs: int) -> int:
        """Into how many chords each of so many arcs may be cut."""
        spare = SPARE_BEADS + int(BEADS_PER_BYTE * self.read_bytes) - self.laid
        return min(max(spare // max(arcs, 1), FEWEST_CHORDS), MAX_CHORDS)

    def _bezier(self, words: dict[str, float | None], end_pos: int) -> None:
        """G5: I and J lead from the start to the first control point, P and Q from the end to the second."""
        goal = self._target(words)
        if goal is None:
            return
        target, feed = goal
        i, j, p, q = ((words.get(letter) or 0.0) * self.unit_mm for letter in "IJPQ")
        if max(abs(i), abs(j), abs(p), abs(q)) < FARTHEST_MM:
            points = bezier(np.array(self.position), np.array([i, j]), np.array([p, q]), np.array(target))
            self._follow(points, feed, end_pos)
        else:
            self.skipped += 1
        self.position = target

    def _follow(self, path: np.ndarray, feed: float, end_pos: int) -> None:
        """Lay, or only move, along a path, (n, 3) mm."""
        self._feed(feed)
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
                self.places.offset[i] = self.position[i] - value * self.unit_mm
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
            self.objects.m486(rest, self.laid, end_pos)
        if number not in QUIET_M:
            self.tail_open = False

    def _volumetric(self, words: dict[str, float | None]) -> None:
        """M200: D0 or S0 ends volumetric extrusion, a diameter or S1 begins it."""
        diameter, switch = words.get("D"), words.get("S")
        if diameter is not None and 0.0 < diameter < 100.0:
            self.filament_mm = diameter
        self.volumetric = bool(switch) if switch is not None else bool(diameter)

    def _macro(self, code: str, end_pos: int) -> None:
        """Words that are no G, M or T: Klipper's macros, OctoPrint's @ commands, anything else."""
        text = code.strip()
        if text.startswith("@"):
            self.objects.at_command(text[1:], self.laid)
            return
        found = _MACRO.match(code)
        word = found.group(1).upper() if found else text[:1]
        if word in ("SAVE_GCODE_STATE", "RESTORE_GCODE_STATE"):
            self._gcode_state(word, code)
        elif not (word in QUIET_WORDS or self.objects.macro(word, code, self.laid, end_pos)):
            self.tail_open = False
            if word not in NO_PATH_WORDS:
                self.unknown[word] += 1

    def _gcode_state(self, word: str, code: str) -> None:
        """Klipper's SAVE_GCODE_STATE and RESTORE_GCODE_STATE: modes, offsets and the file's E, by name."""
        name = named(code) or "default"
        if word == "SAVE_GCODE_STATE":
            self.states[name] = (self.relative, self.relative_e, self.e, list(self.places.offset), list(self.position))
        elif name in self.states:
            self.relative, self.relative_e, self.e, offset, position = self.states[name]
            self.places.offset[:] = offset
            if "MOVE=1" in code.upper():
                self.position = list(position)
            self.tail_open = False
