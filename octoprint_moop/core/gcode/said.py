"""What a file's comments and labels said, in the order in which they said it, by index of the bead that came next."""

from __future__ import annotations

from array import array
from typing import Callable

import numpy as np

from .dialects import Declared, Feature, Height, Label, Layer, Meaning, Slicer, Width, meaning

TAKEN_BACK = -1  # in place of a file position: the cancelling of an object, or of all of them, is undone
NOT_SAID = -1.0  # role, width or height that no comment has told yet


class Changes:
    """A value that holds from a bead on: change points, compact."""

    def __init__(self) -> None:
        self.bead, self.value = array("q"), array("d")

    def at(self, bead: int, value: float) -> None:
        if self.bead and self.bead[-1] >= bead:
            self.value[-1] = value
        elif not self.value or self.value[-1] != value:
            self.bead.append(bead)
            self.value.append(value)

    def extend(self, beads: np.ndarray, values: np.ndarray) -> None:
        """As `at` for one after the other; beads (n,) int64, ascending, values (n,) float64."""
        last = np.append(beads[1:] != beads[:-1], True)  # of those at the same bead
        beads, values = beads[last], values[last]
        self.at(int(beads[0]), float(values[0]))
        new = np.flatnonzero(values[1:] != values[:-1]) + 1
        self.bead.frombytes(beads[new].astype(np.int64).tobytes())
        self.value.frombytes(values[new].astype(np.float64).tobytes())


class Labels:
    """Object labels of one kind: which object holds from a bead on (-1 for none), and their names in order."""

    def __init__(self) -> None:
        self.changes = Changes()
        self.names: dict[str, int] = {}

    def at(self, bead: int, name: str | None) -> None:
        self.changes.at(bead, -1 if name is None else self.names.setdefault(name, len(self.names)))

    def current(self) -> str | None:
        """The name that holds now."""
        index = int(self.changes.value[-1]) if self.changes.value else -1
        return None if index < 0 else list(self.names)[index]


class Said:
    """`layers`: kind of layer comment -> bead indices; `cancelled`: (kind of label, name, file position)."""

    def __init__(self) -> None:
        self.layers: dict[str, array[int]] = {}
        self.role, self.width, self.height = Changes(), Changes(), Changes()
        self.labels: dict[str, Labels] = {}
        self.m486_names: dict[int, str] = {}
        self.cancelled: list[tuple[str, str, int]] = []
        self.custom = False  # what follows is the user's own G-code
        self.slicer = ""
        self.declared: dict[str, tuple[float, ...]] = {}

    def comment(self, text: str, bead: int) -> None:
        """Take note of a comment, the text after the semicolon."""
        self.take(meaning(text), bead)

    def take(self, meanings: tuple[Meaning, ...], bead: int) -> None:
        """Take note of what a comment means."""
        for said in meanings:
            _NOTED[type(said)](self, said, bead)

    def _feature(self, said: Feature, bead: int) -> None:
        self.role.at(bead, said.role)
        self.custom = said.custom
        if said.custom:
            self.width.at(bead, NOT_SAID)
            self.height.at(bead, NOT_SAID)

    def _layer(self, said: Layer, bead: int) -> None:
        self.layers.setdefault(said.dialect, array("q")).append(bead)

    def _slicer(self, said: Slicer, bead: int) -> None:
        self.slicer = self.slicer or said.name

    def _declared(self, said: Declared, bead: int) -> None:
        self.declared.setdefault(said.setting, said.values)

    def label(self, system: str, name: str | None, bead: int) -> None:
        if system not in self.labels:
            self.labels[system] = Labels()
        self.labels[system].at(bead, name)

    def setting(self, name: str) -> float | None:
        """The first value of a setting that the file declares, or None."""
        values = self.declared.get(name)
        return values[0] if values else None


_NOTED: dict[type, Callable[..., None]] = {
    Feature: Said._feature,
    Label: lambda self, said, bead: self.label(said.system, said.name, bead),
    Width: lambda self, said, bead: self.width.at(bead, said.mm),
    Height: lambda self, said, bead: self.height.at(bead, said.mm),
    Layer: Said._layer,
    Slicer: Said._slicer,
    Declared: Said._declared,
}
