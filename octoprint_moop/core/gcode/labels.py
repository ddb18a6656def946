"""Which bead belongs to which object, by whichever of a file's kinds of labels says it best."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..toolpath import NO_OBJECT
from .dialects import LABEL_SYSTEMS
from .layers import Held
from .said import TAKEN_BACK, Labels, Said

FIRMWARE_SYSTEMS = ("exclude_object", "m486_named", "m486")


@dataclass(frozen=True, eq=False)
class Objects:
    """Which bead belongs to which object.

    ids             : index into names for each bead, or None where nothing is labelled
    names           : in order of appearance, only of objects that print something
    cancelled       : see Toolpath
    cancel_commands : see Toolpath
    """

    ids: Held | None
    names: tuple[str, ...]
    cancelled: tuple[tuple[int, int], ...]
    cancel_commands: tuple[str, ...]


def find_objects(said: Said, count: int) -> Objects:
    """The objects as one of the file's systems of labels tells them, see LABEL_SYSTEMS."""
    labels = dict(said.labels)
    if said.m486_names and "m486" in labels:
        labels["m486_named"] = labels["m486"]
    for system in LABEL_SYSTEMS:
        if system in labels:
            ids, kept = _printed(labels[system], count)
            if kept:
                break
    else:
        return Objects(None, (), (), ())
    original = list(labels[system].names)
    names = [_object_name(system, original[k], said) for k in kept]
    commands = tuple(_cancel_commands(system, [original[k] for k in kept], ids, labels, count))
    cancelled: dict[int, int] = {}
    for spoken_by, name, position in said.cancelled:
        command = _cancel_command(spoken_by, name)
        if position == TAKEN_BACK:
            for index in [index for index in cancelled if not name or commands[index] == command]:
                del cancelled[index]
        elif command in commands:
            cancelled.setdefault(commands.index(command), position)
    return Objects(ids, tuple(names), tuple(sorted(cancelled.items())), commands)


def _printed(labels: Labels, count: int) -> tuple[Held, list[int]]:
    """Object of each bead, renumbered over the objects that have beads; and which those are."""
    held = Held(labels.changes, NO_OBJECT)
    seen = np.zeros(len(labels.names) + 1, bool)
    seen[held.values[held.lengths(count) > 0].astype(np.int64)] = True
    kept = np.flatnonzero(seen[:-1]).tolist()
    renumbered = np.full(len(labels.names) + 1, NO_OBJECT, np.float32)
    renumbered[kept] = np.arange(len(kept))
    held.values = renumbered[held.values.astype(np.int64)]  # index -1 is the last entry: NO_OBJECT
    return held, kept


def _object_name(system: str, name: str, said: Said) -> str:
    if system in ("m486", "m486_named"):
        return said.m486_names.get(int(name), f"object {name}")
    return name


def _cancel_command(system: str, name: str) -> str:
    if system == "exclude_object":
        return f"EXCLUDE_OBJECT NAME={name}"
    if system in ("m486", "m486_named"):
        return f"M486 P{name}"
    return ""


def _cancel_commands(system: str, names: list[str], ids: Held, labels: dict[str, Labels], count: int) -> list[str]:
    """What the firmware must be told to skip each object; "" where the file holds no labels that it understands."""
    if system in FIRMWARE_SYSTEMS:
        return [_cancel_command(system, name) for name in names]
    commands = [""] * len(names)
    for spoken in FIRMWARE_SYSTEMS:
        if spoken not in labels:
            continue
        other, known = Held(labels[spoken].changes, NO_OBJECT), list(labels[spoken].names)
        begins = np.unique(np.concatenate([ids.starts, other.starts]))
        begins = begins[begins < count]
        for begin in begins.tolist():  # both kinds of labels hold unchanged from here to the next
            ours, theirs = int(ids.at(begin)), int(other.at(begin))
            if ours >= 0 and theirs >= 0 and not commands[ours]:
                commands[ours] = _cancel_command(spoken, known[theirs])
        break
    return commands
