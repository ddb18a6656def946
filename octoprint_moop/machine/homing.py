"""Whether anybody knows where the printer stands, and a short move by which its bed's motion can be seen."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

from ..core.errors import CalibrationError

AXES = frozenset("XYZ")
LOSES_POSITION = frozenset({"M18", "M84", "M112", "M999"})
STEP_Z_MM, STEP_Y_RATIO, LEAST_Y_MM, MOST_Y_MM = 30.0, 0.3, 20.0, 80.0
MARGIN_MM = 5.0
HIGH_MM = 60.0  # above all that usually lies on a bed: from there one may also go down


class Homing:
    """Told of each command sent; written by OctoPrint's sending thread alone."""

    def __init__(self) -> None:
        self._homed: frozenset[str] = frozenset()

    @property
    def known(self) -> bool:
        """All axes were homed since the printer was connected, and its motors have not been let go since."""
        return self._homed == AXES

    def sent(self, gcode: str | None, command: str) -> None:
        if gcode == "G28":
            # Prusa's G28 W and Marlin's G28 O, R… name no axis: all of them are homed.
            named = AXES & set(re.findall(r"\b([XYZ])", command.upper().split(";")[0][3:]))
            self._homed = self._homed | (named or AXES)
        elif gcode in LOSES_POSITION:
            self._homed = frozenset()

    def lost(self) -> None:
        """The printer was connected anew, or reset itself."""
        self._homed = frozenset()


def short_move_mm(position_mm: Sequence[float], printer: dict[str, Any]) -> tuple[float, float]:
    """(dy, dz): a move that shows which way the bed goes. Up where there is room; down only from high up.

    printer : a recording header's
    Raises CalibrationError where the position is outside the volume, or there is no room for the move.
    """
    volume = printer["volume_mm"]
    width, depth, height = volume["width"], volume["depth"], volume["height"]
    centred = printer.get("origin") == "center" or printer.get("form_factor") == "circular"
    left, front = (-width / 2, -depth / 2) if centred else (0.0, 0.0)
    x, y, z = position_mm
    beside = 25.0  # homing switches and purge lines often lie a little outside
    if not (left - beside <= x <= left + width + beside and front - beside <= y <= front + depth + beside):
        raise CalibrationError(
            f"The printer reports X {x:g}, Y {y:g}, which is outside its bed in OctoPrint's printer profile. "
            "Home it, or correct the profile."
        )
    if -MARGIN_MM <= z <= height - MARGIN_MM - STEP_Z_MM:
        dz = STEP_Z_MM
    elif HIGH_MM + STEP_Z_MM <= z <= height + 2 * MARGIN_MM:
        dz = -STEP_Z_MM
    else:
        raise CalibrationError(
            f"The printer stands at Z {z:g} mm, where there is no room to move Z by {STEP_Z_MM:g} mm. "
            "Move it to the lower half of its height, and try again."
        )
    reach = min(max(STEP_Y_RATIO * depth, LEAST_Y_MM), MOST_Y_MM)
    middle = front + depth / 2
    dy = -reach if y > middle else reach
    if not front + MARGIN_MM <= y + dy <= front + depth - MARGIN_MM:
        raise CalibrationError(
            f"There is no room to move Y by {reach:g} mm from {y:g} mm. Move it to the bed's middle."
        )
    return dy, dz
