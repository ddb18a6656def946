"""Where a model stands on the bed: where the G-code prints it, or where the user puts it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ..errors import MeshError
from ..toolpath import Toolpath
from .solid import Solid, printed_bounds_mm

FARTHEST_MM = 10_000.0


@dataclass(frozen=True)
class Placement:
    """The model is turned first, counter-clockwise seen from above, then its bounds' middle is brought to (x, y).

    x_mm, y_mm : both None: where the G-code prints it, or as it is where there is none
    """

    x_mm: float | None = None
    y_mm: float | None = None
    turn_deg: float = 0.0

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Placement:
        """Raises MeshError where a number is none, or only one of x and y is given."""
        found = {}
        for name, most in (("x_mm", FARTHEST_MM), ("y_mm", FARTHEST_MM), ("turn_deg", 360.0)):
            value = data.get(name)
            if value is None:
                continue
            try:
                found[name] = float(value)
            except (TypeError, ValueError):
                raise MeshError(f"The model's {name} is {value!r}; a number is needed.") from None
            if not (math.isfinite(found[name]) and abs(found[name]) <= most):
                raise MeshError(f"The model's {name} is {found[name]:g}; {-most:g} to {most:g} is allowed.")
        if ("x_mm" in found) != ("y_mm" in found):
            raise MeshError("The model's place needs both x_mm and y_mm, or neither to place it by the G-code.")
        return cls(**found)

    def to_json(self) -> dict[str, float | None]:
        return {"x_mm": self.x_mm, "y_mm": self.y_mm, "turn_deg": self.turn_deg}


def place(solid: Solid, placement: Placement, toolpath: Toolpath | None = None) -> Solid:
    """The solid where it is printed, standing on the bed; `notes` tells what does not fit. toolpath : None for none"""
    turned = solid.turned(placement.turn_deg)
    if placement.x_mm is None or placement.y_mm is None:
        if toolpath is not None:
            return turned.placed_on(toolpath)
        return turned.moved([0, 0, -float(turned.bounds_mm()[0, 2])])
    low, high = turned.bounds_mm()
    ground_mm = 0.0 if toolpath is None else float(printed_bounds_mm(toolpath)[0, 2])
    x_mm, y_mm, _ = (low + high) / 2
    return turned.moved([placement.x_mm - x_mm, placement.y_mm - y_mm, ground_mm - low[2]])
