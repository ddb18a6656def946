"""Where the head goes between two beads: a layer's end may be where the file itself parks it."""

from __future__ import annotations

from array import array

FAR_MM = 20.0  # a head this far beyond a layer does not stand before it


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
