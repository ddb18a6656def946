"""The shape of a print head, as boxes: plain numbers, so that it can be checked where it is entered.

What of the picture it hides is `expected/hardware.py`'s to say.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from .errors import SettingsError


@dataclass(frozen=True)
class Box:
    """A box around the nozzle's tip, in millimetres from it: x right, y to the back, z up."""

    low_mm: tuple[float, float, float]
    high_mm: tuple[float, float, float]

    def __post_init__(self) -> None:
        try:
            low, high = (tuple(float(side) for side in corner) for corner in (self.low_mm, self.high_mm))
        except (TypeError, ValueError):
            raise SettingsError("A box of the print head needs two corners of three numbers each, in mm.") from None
        if len(low) != 3 or len(high) != 3 or not all(math.isfinite(side) for side in (*low, *high)):
            raise SettingsError("A box of the print head needs two corners of three numbers each, in mm.")
        if not all(a < b for a, b in zip(low, high)):
            raise SettingsError(f"A box of the print head goes from {low} to {high} mm; each must grow.")
        object.__setattr__(self, "low_mm", low)
        object.__setattr__(self, "high_mm", high)

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Box:
        """Raises SettingsError where a corner is missing or makes no sense."""
        try:
            return cls(data["low_mm"], data["high_mm"])
        except (KeyError, TypeError):
            raise SettingsError("A box of the print head needs low_mm and high_mm, three numbers each.") from None

    def to_json(self) -> dict[str, Any]:
        return {"low_mm": list(self.low_mm), "high_mm": list(self.high_mm)}


@dataclass(frozen=True)
class HeadModel:
    """Boxes that move with the nozzle, and a beam along X that follows it in Y and Z only.

    head       : boxes around the nozzle
    gantry     : the beam's box; its x is where it begins and ends on the machine, not about the nozzle. None for none
    """

    head: tuple[Box, ...]
    gantry: Box | None = None

    @classmethod
    def common(cls, width_mm: float, left_mm: float = 0.0) -> HeadModel:
        """A generous guess for a printer whose bed is `width_mm` wide and begins at x = `left_mm`: heater block, carriage
        with fans, two rods."""
        return cls(
            head=(Box((-14, -18, 0), (14, 18, 14)), Box((-35, -45, 8), (35, 40, 85))),
            gantry=Box((left_mm - 70, -15, 25), (left_mm + width_mm + 70, 45, 85)),
        )

    @classmethod
    def from_text(cls, text: str, width_mm: float, left_mm: float = 0.0) -> HeadModel:
        """The head that a setting describes in JSON; empty for the common one. Raises SettingsError."""
        if not text.strip():
            return cls.common(width_mm, left_mm)
        try:
            return cls.from_json(json.loads(text))
        except (ValueError, RecursionError) as error:
            raise SettingsError(
                f"The print head's shape is not JSON ({error}). Empty it to use the common one."
            ) from None

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> HeadModel:
        """Raises SettingsError where a box makes no sense."""
        if not isinstance(data, Mapping) or not isinstance(data.get("head"), (list, tuple)):
            raise SettingsError("The print head's shape needs `head`, a list of boxes, and perhaps `gantry`, one box.")
        gantry = data.get("gantry")
        return cls(tuple(Box.from_json(box) for box in data["head"]), None if gantry is None else Box.from_json(gantry))

    def to_json(self) -> dict[str, Any]:
        return {
            "head": [box.to_json() for box in self.head],
            "gantry": None if self.gantry is None else self.gantry.to_json(),
        }
