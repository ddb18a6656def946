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

from .dialects import Declared, Feature, Height, Label, Layer, Slicer, Width, meaning

CHORD_ERROR_MM = 0.05
MAX_CHORDS = 2000  # of one arc command; the P parameter would allow millions
FARTHEST_MM = 1e6  # a coordinate beyond is a damaged line, not a place
LEAST_FEED_MM = 1e-7
LEAST_MOVE_MM = 1e-6
INCH_MM = 25.4
NOT_SAID = -1.0  # role, width or height that no comment has told yet

_WORD = re.compile(r"([A-Z])\s*([-+]?(?:\d+\.?\d*|\.\d+))?")
_COMMAND = re.compile(r"\s*(?:N\s*\d+\s*)?([GMT])\s*(\d{1,6})(?:\.(\d+))?", re.IGNORECASE)
_MACRO = re.compile(r"\s*(?:N\s*\d+\s*)?([A-Za-z_]\w*)\s*(.*)")
_PARENTHESES = re.compile(r"\([^)]*\)")
_NAMED = re.compile(r"\bNAME=(\"[^\"]*\"|'[^']*'|\S+)", re.IGNORECASE)

# Commands that neither move nor extrude nor wait: a layer's retraction may have them in its midst.
_QUIET = frozenset((73, 106, 107, 117, 118, 204, 205, 220, 221, 400, 486, 572, 593, 900))


class Changes:
    """A value that holds from a bead on: change points, compact."""

    def __init__(self) -> None:
        self.bead, self.value = array("q"), array("d")

    def at(self, bead: int, value: float) -> None:
        if self.bead and self.bead[-1] == bead:
            self.value[-1] = value
        elif not self.value or self.value[-1] != value:
            self.bead.append(bead)
            self.value.append(value)


class Labels:
    """Object labels of one kind: which object holds from a bead on (-1 for none), and their names in order."""

    def __init__(self) -> None:
        self.changes, self.names = Changes(), {}  # type: Changes, dict[str, int]

    def at(self, bead: int, name: str | None) -> None:
        self.changes.at(bead, -1 if name is None else self.names.setdefault(name, len(self.names)))


class Said:
    """What comments and labels said, by index of the bead that came next."""

    def __init__(self) -> None:
        self.layers: dict[str, array] = {}
        self.role, self.width, self.height = Changes(), Changes(), Changes()
        self.labels: dict[str, Labels] = {}
        self.m486_names: dict[int, str] = {}
        self.cancelled: list[tuple[str, str | None, int]] = []  # (system, name or None for all, position)
        self.slicer = ""
        self.declared: dict[str, float] = {}

    def comment(self, text: str, bead: int) -> None:
        for said in meaning(text):
            if isinstance(said, Layer):
                self.layers.setdefault(said.dialect, array("q")).append(bead)
            elif isinstance(said, Feature):
                self.role.at(bead, said.role)
                if said.custom:
                    self.width.at(bead, NOT_SAID)
                    self.height.at(bead, NOT_SAID)
            elif isinstance(said, Width):
                self.width.at(bead, said.mm)
            elif isinstance(said, Height):
                self.height.at(bead, said.mm)
            elif isinstance(said, Label):
                self.label(said.system, said.name, bead)
            elif isinstance(said, Slicer):
                self.slicer = self.slicer or said.name
            elif isinstance(said, Declared):
                self.declared.setdefault(said.setting, said.value)

    def label(self, system: str, name: str | None, bead: int) -> None:
        self.labels.setdefault(system, Labels()).at(bead, name)


class Beads:
    """Beads as they come: seven float32 each (x0 y0 z0 x1 y1 z1 and the filament fed, mm) and an end position."""

    def __init__(self) -> None:
        self.path, self.end_pos = array("f"), array("q")

    def __len__(self) -> int:
        return len(self.end_pos)

    def add(self, start: tuple, end: tuple, fed_mm: float, end_pos: int) -> None:
        self.path.extend((*start, *end, fed_mm))
        self.end_pos.append(end_pos)


class Interpreter:
    """The machine's state. `run` one line after the other; `beads` and `said` hold what came of it."""

    def __init__(self, relative_e: bool = False) -> None:
        self.beads, self.said = Beads(), Said()
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
        self.tails = (array("q"), array("q"))  # beads followed by a retraction, and where that ends
        self._tail_open = False
        # Travels between beads: the bead before, where the move ends in the file, and where over the bed.
        self.travels = (array("q"), array("q"), array("f"), array("f"))
        self.skipped = 0
        self.unknown: Counter[str] = Counter()

    def run(self, line: str, end_pos: int) -> None:
        """Execute one line of the file, which ends at `end_pos`."""
        code, semicolon, comment = line.partition(";")
        if semicolon:
            self.said.comment(comment, len(self.beads))
        if "(" in code:
            code = _PARENTHESES.sub(" ", code)
        if not code.strip():
            return
        command = _COMMAND.match(code)
        if command is None:
            self._macro(code, end_pos)
            return
        letter, number = command.group(1).upper(), int(command.group(2))
        if command.group(3) and int(command.group(3)):
            self._tail_open = False
            self.unknown[f"{letter}{number}.{command.group(3)}"] += 1
            return
        rest = code[command.end() :].partition("*")[0]
        if letter == "G":
            self._g(number, rest, end_pos)
        elif letter == "M":
            self._m(number, rest, end_pos)
        else:
            self.tool = number
            self._tail_open = False

    # -- motion ------------------------------------------------------------------------------------------------------

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
            self._tail_open = False
        elif number in (90, 91):
            self.relative = number == 91
        elif number in (20, 21):
            self.unit_mm = INCH_MM if number == 20 else 1.0
        elif number == 10:
            # RepRapFirmware's G10 with P or L sets a tool up; without, firmware retraction: no geometry, no E.
            if not {"P", "L", "X", "Y", "Z"} & self._words(rest).keys():
                self._retracted(end_pos)
        elif number not in (4, 11, 17, 21, 29, 80):
            self._tail_open = False
            self.unknown[f"G{number}"] += 1
        else:
            self._tail_open = self._tail_open and number == 17

    def _target(self, words: dict[str, float | None]) -> tuple[list[float], float] | None:
        """Where a move goes and how much it feeds, or None where its numbers are damaged."""
        target = list(self.position)
        for i, axis in enumerate("XYZ"):
            value = words.get(axis)
            if value is not None:
                value *= self.unit_mm
                target[i] = target[i] + value if self.relative else value + self.offset[i]
        feed = 0.0
        value = words.get("E")
        if value is not None:
            value *= 1.0 if self.volumetric else self.unit_mm
            feed = value if self.relative or self.relative_e else value - self.e
        if max(abs(target[0]), abs(target[1]), abs(target[2]), abs(feed), abs(self.e + feed)) > FARTHEST_MM:
            self.skipped += 1
            return None
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
            self.beads.add(tuple(start), tuple(target), self._linear_mm(feed), end_pos)
            self._tail_open = True
        elif feed < -LEAST_FEED_MM:
            self._retracted(end_pos)
        elif moved or lifted or feed > LEAST_FEED_MM:
            self._tail_open = False
        if moved and feed <= LEAST_FEED_MM:
            beads, ends, xs, ys = self.travels
            beads.append(len(self.beads) - 1)
            ends.append(end_pos)
            xs.append(target[0])
            ys.append(target[1])
        self.position = target

    def _arc(self, words: dict[str, float | None], clockwise: bool, end_pos: int) -> None:
        goal = self._target(words)
        if goal is None:
            return
        target, feed = goal
        points = self._arc_points(self.position, target, words, clockwise)
        self._feed(feed)
        if feed > LEAST_FEED_MM and len(points) > 0:
            lengths = [math.dist(a, b) for a, b in zip([self.position, *points], points)]
            whole = sum(lengths)
            start = tuple(self.position)
            if whole > LEAST_MOVE_MM:
                for point, length in zip(points, lengths):
                    self.beads.add(start, tuple(point), self._linear_mm(feed) * length / whole, end_pos)
                    start = tuple(point)
                self._tail_open = True
        elif feed < -LEAST_FEED_MM:
            self._retracted(end_pos)
        else:
            self._tail_open = False
        self.position = target

    def _arc_points(
        self, start: list[float], end: list[float], words: dict[str, float | None], clockwise: bool
    ) -> list[tuple[float, float, float]]:
        """The chords' ends of a G2 or G3, the last being `end`; a straight line where it has no sensible centre."""
        unit = self.unit_mm
        radius = words.get("R")
        if radius is not None:
            centre = _centre_by_radius(start, end, radius * unit, clockwise)
        elif words.get("I") is not None or words.get("J") is not None:
            centre = (start[0] + (words.get("I") or 0.0) * unit, start[1] + (words.get("J") or 0.0) * unit)
        else:
            centre = None
        if centre is None:
            self.skipped += 1
            return [(end[0], end[1], end[2])]
        ax, ay = start[0] - centre[0], start[1] - centre[1]
        bx, by = end[0] - centre[0], end[1] - centre[1]
        radius = math.hypot(ax, ay)
        if not LEAST_MOVE_MM < radius < FARTHEST_MM:
            return [(end[0], end[1], end[2])]
        angle = math.atan2(ax * by - ay * bx, ax * bx + ay * by)
        closed = math.hypot(end[0] - start[0], end[1] - start[1]) < LEAST_MOVE_MM
        if closed:
            angle = 0.0
        if clockwise and angle >= 0.0:
            angle -= 2.0 * math.pi
        elif not clockwise and angle <= 0.0:
            angle += 2.0 * math.pi
        turns = min(max(int(words.get("P") or 0) - (1 if closed else 0), 0), MAX_CHORDS)
        angle += math.copysign(2.0 * math.pi * turns, angle)
        widest = 2.0 * math.acos(1.0 - min(CHORD_ERROR_MM / radius, 0.5))
        count = min(max(math.ceil(abs(angle) / widest), 1), MAX_CHORDS)
        first, far = math.atan2(ay, ax), math.hypot(bx, by)
        points = []
        for k in range(1, count):
            part = k / count
            r, a = radius + (far - radius) * part, first + angle * part
            points.append(
                (centre[0] + r * math.cos(a), centre[1] + r * math.sin(a), start[2] + (end[2] - start[2]) * part)
            )
        points.append((end[0], end[1], end[2]))
        return points

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
            self.e = value * (1.0 if self.volumetric else self.unit_mm)

    # -- extrusion ---------------------------------------------------------------------------------------------------

    def _linear_mm(self, feed: float) -> float:
        """Length of filament that reaches the bed, with the flow factor; or mm³, see `assemble`."""
        if self.volumetric and self.filament_mm:
            feed /= math.pi / 4.0 * self.filament_mm**2
        return feed * self.flow

    def _feed(self, feed: float) -> None:
        if not feed:
            return
        self.e += feed
        if self.volumetric and self.filament_mm:
            feed /= math.pi / 4.0 * self.filament_mm**2
        fed = self.fed.get(self.tool, 0.0) + feed
        self.fed[self.tool] = fed
        if fed > self.most_fed.get(self.tool, 0.0):
            self.most_fed[self.tool] = fed

    def _retracted(self, end_pos: int) -> None:
        if self._tail_open and len(self.beads):
            beads, ends = self.tails
            last = len(self.beads) - 1
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
            self._tail_open = False

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
        self.said.label("m486", None if self.m486 < 0 else str(self.m486), len(self.beads))

    def _macro(self, code: str, end_pos: int) -> None:
        """Words that are no G, M or T: Klipper's macros, OctoPrint's @ commands, anything else."""
        text = code.strip()
        if text.startswith("@"):
            word, _, rest = text[1:].partition(" ")
            if word.lower() == "object":
                self.said.label("at_object", rest.strip() or None, len(self.beads))
            elif word.lower() == "objectend":
                self.said.label("at_object", None, len(self.beads))
            return
        found = _MACRO.match(code)
        word = found.group(1).upper() if found else text[:1]
        named = _NAMED.search(code) if found else None
        name: str | None = named.group(1).strip("\"'") if named else None
        if word == "EXCLUDE_OBJECT_START":
            self.said.label("exclude_object", name, len(self.beads))
        elif word == "EXCLUDE_OBJECT_END":
            self.said.label("exclude_object", None, len(self.beads))
        elif word == "EXCLUDE_OBJECT":
            self._exclude(name, code.upper(), end_pos)
        elif word != "EXCLUDE_OBJECT_DEFINE":
            self._tail_open = False
            self.unknown[word] += 1

    def _exclude(self, name: str | None, code: str, end_pos: int) -> None:
        if name is None and "CURRENT=1" in code:
            labels = self.said.labels.get("exclude_object")
            if labels and labels.changes.value and labels.changes.value[-1] >= 0:
                name = list(labels.names)[int(labels.changes.value[-1])]
        if name is not None:
            self.said.cancelled.append(("exclude_object", name, end_pos))


def _centre_by_radius(
    start: list[float], end: list[float], radius: float, clockwise: bool
) -> tuple[float, float] | None:
    """The centre of an arc given by R: the short way round for R > 0, the long way for R < 0."""
    dx, dy = end[0] - start[0], end[1] - start[1]
    chord = math.hypot(dx, dy)
    if chord < LEAST_MOVE_MM or abs(radius) < LEAST_MOVE_MM:
        return None
    rise = math.sqrt(max(radius * radius - chord * chord / 4.0, 0.0))
    if clockwise == (radius > 0.0):
        rise = -rise
    return ((start[0] + end[0]) / 2.0 - dy / chord * rise, (start[1] + end[1]) / 2.0 + dx / chord * rise)
