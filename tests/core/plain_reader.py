"""An oracle for the G-code reader: one line at a time, one state dictionary, no numpy, nothing shared with the product.

It knows what moves and extrudes, not what comments say: layers, labels and roles are checked against the slicers' own
words elsewhere.
"""

from __future__ import annotations

import math
import re


def plain_read(data: bytes, relative_e: bool = False) -> dict:
    """`beads`: (start, end, fed_mm, end_pos) of each; `tails`: last bead -> end of the retraction that follows it;
    `travels`: ends of the moves that extrude nothing; `filament_mm`; `bytes`."""
    at, shift, e = [0.0, 0.0, 0.0], [0.0, 0.0, 0.0], 0.0
    moves_relative, unit, flow, area = False, 1.0, 1.0, None
    volumetric, tool, fed, most = False, 0, {}, {}
    place, places, states = 1, {0: None}, {}
    beads, tails, travels, tail_open = [], {}, set(), False
    text = data.decode("utf-8", errors="replace")
    position = 3 if text.startswith("\ufeff") else 0
    for line in re.findall(r"[^\r\n]*(?:\r\n|\r|\n)|[^\r\n]+$", text.lstrip("\ufeff")):
        position += len(line.encode("utf-8"))
        code = re.sub(r"\([^)]*\)", " ", line.split(";")[0]).split("*")[0].strip().upper()
        within = re.match(r"(?:N\s*\d+\s*)?G\s*0*53(?![\d.])\s*(?=\S)", code)
        kept, code = (list(shift), code[within.end() :]) if within else (None, code)
        shift = [0.0, 0.0, 0.0] if within else shift
        head = re.match(r"(?:N\s*\d+\s*)?([GMT])\s*0*(\d+)(\.\d+)?", code)
        if not code:
            continue
        if head is None or (head.group(3) and int(head.group(3)[1:])):
            known = re.sub(r"\s|N\d+\s", "", code)
            state = re.match(r"(SAVE|RESTORE)_GCODE_STATE", code)
            if re.match(r"G92\.0*1(?!\d)", known):
                shift = [0.0, 0.0, 0.0]
            elif re.match(r"G59\.0*[123](?!\d)", known):
                places[place], place = shift, 6 + int(known[known.index(".") :].lstrip(".0")[0])
                shift = list(places.get(place) or [0.0, 0.0, 0.0])
            elif state and state.group(1) == "SAVE":
                states[macro_name(code)] = (moves_relative, relative_e, e, list(shift), list(at))
            elif state and macro_name(code) in states:
                moves_relative, relative_e, e, saved, was_at = states[macro_name(code)]
                shift, at, tail_open = list(saved), list(was_at) if "MOVE=1" in code else at, False
            tail_open = tail_open and (code.startswith(("@", "EXCLUDE_OBJECT", "SET_VELOCITY_LIMIT ")) or bool(state))
            shift = kept or shift
            continue
        name = head.group(1) + head.group(2)
        words = {}
        for letter, number in re.findall(r"([A-Z])\s*([-+]?(?:\d+\.?\d*|\.\d+))?", code[head.end() :]):
            words[letter] = float(number) if number else None
        value = {letter: number for letter, number in words.items() if number is not None}
        e_unit = 1.0 if volumetric else unit
        if name in ("G0", "G1", "G2", "G3", "G5"):
            goal = list(at)
            for i, axis in enumerate("XYZ"):
                if axis in value:
                    goal[i] = (at[i] if moves_relative else shift[i]) + value[axis] * unit
            is_relative = moves_relative or relative_e
            feed = 0.0
            if "E" in value:
                feed = value["E"] * e_unit - (0.0 if is_relative else e)
            new_e = e + feed if is_relative or "E" not in value else value["E"] * e_unit
            if max(abs(number) for number in (*goal, feed, new_e)) >= 1e6:
                continue
            e = new_e
            path = [tuple(at), tuple(goal)]
            if name in ("G2", "G3"):
                path = arc(at, goal, value, unit, name == "G2")
            if name == "G5":
                path = curve(at, goal, [value.get(letter, 0.0) * unit for letter in "IJPQ"])
            moved = any(abs(a - b) > 1e-6 for p, q in zip(path, path[1:]) for a, b in zip(p[:2], q[:2]))
            whole = sum(math.dist(p, q) for p, q in zip(path, path[1:]))
            if name in ("G2", "G3", "G5"):
                moved = whole > 1e-6
            length = feed / area if volumetric and area else feed
            fed[tool] = fed.get(tool, 0.0) + length
            most[tool] = max(most.get(tool, 0.0), fed[tool])
            if feed > 1e-7 and moved:
                for p, q in zip(path, path[1:]):
                    beads.append((p, q, length * flow * math.dist(p, q) / whole, position))
                tail_open = True
            elif feed < -1e-7:
                if tail_open:
                    tails[len(beads) - 1] = position
            elif name in ("G2", "G3", "G5") or moved or feed > 1e-7 or abs(goal[2] - at[2]) > 1e-6:
                tail_open = False
            if name in ("G0", "G1") and moved and feed <= 1e-7:
                travels.add(position)
            at = goal
        elif name == "G92":
            if not set(words) & set("XYZE"):
                value = {"X": 0.0, "Y": 0.0, "Z": 0.0, "E": 0.0}
            for i, axis in enumerate("XYZ"):
                if axis in value and abs(value[axis]) < 1e6:
                    shift[i] = at[i] - value[axis] * unit
            if "E" in value and abs(value["E"]) < 1e6:
                e = value["E"] * e_unit
        elif name == "G28":
            for i, axis in enumerate("XYZ"):
                if axis in words or not set(words) & set("XYZ"):
                    at[i] = shift[i] = 0.0
            tail_open = False
        elif name in ("G90", "G91"):
            moves_relative = name == "G91"
        elif name in ("G20", "G21"):
            unit = 25.4 if name == "G20" else 1.0
        elif name == "G53" or name in ("G54", "G55", "G56", "G57", "G58", "G59"):
            places[place], place, tail_open = shift, int(name[1:]) - 53, False
            shift = list((places.get(place) if place else None) or [0.0, 0.0, 0.0])
        elif name == "G10" and value.get("L") in (2.0, 20.0):
            which = int(value.get("P", 0)) or place or 1
            there = shift if which == (place or 1) else list(places.get(which) or [0.0, 0.0, 0.0])
            for i, axis in enumerate("XYZ"):
                if axis in value and abs(value[axis]) < 1e6:
                    there[i] = value[axis] * unit if value["L"] == 2.0 else at[i] - value[axis] * unit
            if which != (place or 1):
                places[which] = there
        elif name == "G10":
            if tail_open and not set(words) & set("PLRXYZ"):
                tails[len(beads) - 1] = position
        elif name in ("M82", "M83"):
            relative_e, tail_open = name == "M83", False
        elif name == "M200":
            if 0.0 < value.get("D", 0.0) < 100.0:
                area = math.pi * (value["D"] / 2.0) ** 2
            volumetric = bool(value["S"]) if "S" in value else bool(value.get("D"))
            tail_open = False
        elif name == "M221":
            if 0.0 < value.get("S", 0.0) < 1000.0:
                flow = value["S"] / 100.0
        elif name[0] == "T":
            tool, tail_open = int(name[1:]), False
        elif name != "G17" and name not in QUIET:
            tail_open = False
        shift = kept or shift
    return {"beads": beads, "tails": tails, "travels": travels, "filament_mm": sum(most.values()), "bytes": position}


QUIET = {f"M{number}" for number in (73, 106, 107, 117, 118, 204, 205, 220, 400, 486, 572, 593, 624, 625, 900)}


def macro_name(code):
    found = re.search(r"\bNAME=(\S+)", code)
    return found.group(1) if found else ""


def curve(start, end, offsets):
    """Points of a cubic curve by de Casteljau's construction, as many as a chord error of 0.05 mm asks for."""
    i, j, p, q = offsets
    if max(map(abs, offsets)) >= 1e6:
        return [tuple(start), tuple(start)]
    corners = [(start[0], start[1]), (start[0] + i, start[1] + j), (end[0] + p, end[1] + q), (end[0], end[1])]
    bends = [
        math.hypot(*(a[k] - 2 * b[k] + c[k] for k in (0, 1))) for a, b, c in zip(corners, corners[1:], corners[2:])
    ]
    count = min(max(math.ceil(math.sqrt(6 * max(bends) / 0.4)), 1), 2000)
    points = []
    for n in range(1, count):
        t, line = n / count, corners
        while len(line) > 1:
            line = [tuple(a[k] + (b[k] - a[k]) * t for k in (0, 1)) for a, b in zip(line, line[1:])]
        points.append((*line[0], start[2] + (end[2] - start[2]) * t))
    return [tuple(start), *points, tuple(end)]


def arc(start, end, value, unit, clockwise):
    """Points of an arc whose chords leave it by 0.05 mm at most."""
    closed = math.hypot(end[0] - start[0], end[1] - start[1]) < 1e-6
    if "R" in value:
        radius, half = value["R"] * unit, math.hypot(end[0] - start[0], end[1] - start[1]) / 2.0
        if closed or abs(radius) < 1e-6:
            return [tuple(start), tuple(end)]
        height = math.sqrt(max(radius**2 - half**2, 0.0)) * (1.0 if (radius > 0.0) != clockwise else -1.0)
        nx, ny = (start[1] - end[1]) / (2.0 * half), (end[0] - start[0]) / (2.0 * half)
        cx, cy = (start[0] + end[0]) / 2.0 + nx * height, (start[1] + end[1]) / 2.0 + ny * height
    elif "I" in value or "J" in value:
        cx, cy = start[0] + value.get("I", 0.0) * unit, start[1] + value.get("J", 0.0) * unit
    else:
        return [tuple(start), tuple(end)]
    r0, r1 = math.hypot(start[0] - cx, start[1] - cy), math.hypot(end[0] - cx, end[1] - cy)
    if not 1e-6 < r0 < 1e6:
        return [tuple(start), tuple(end)]
    a0, a1 = math.atan2(start[1] - cy, start[0] - cx), math.atan2(end[1] - cy, end[0] - cx)
    sweep = (a0 - a1 if clockwise else a1 - a0) % (2.0 * math.pi)
    if closed or sweep < 1e-12:
        sweep = 2.0 * math.pi
    turns = min(max(int(min(max(value.get("P", 0.0), 0.0), 1e6)) - closed, 0), 2000)
    sweep += 2.0 * math.pi * turns
    count = math.ceil(sweep / (2.0 * math.acos(1.0 - min(0.05 / r0, 0.5))) - 1e-9)  # a small circle is three
    count = min(max(count, 1), 2000)
    points = [tuple(start)]
    for k in range(1, count):
        part = k / count
        angle, r = a0 + (-sweep if clockwise else sweep) * part, r0 + (r1 - r0) * part
        points.append((cx + r * math.cos(angle), cy + r * math.sin(angle), start[2] + (end[2] - start[2]) * part))
    return [*points, tuple(end)]
