"""The marker plate as G-code: rings on the bed, for a printer's bed, nozzle and filament.

The rings are printed as touching circles, so that they are round, and lie where no two distances between them are
alike: whichever way the camera is turned, they cannot be taken for each other.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import CalibrationError
from ..header import Printer
from .markers import MarkerPlate

# Places of the markers in parts of half the bed, from its middle: the best of many thousand at being unlike themselves
# when turned, mirrored or exchanged, that still span the bed.
_RECTANGULAR = np.array([[-0.58, -0.82], [0.89, -0.65], [0.92, 0.37], [-0.82, 0.82]])
_CIRCULAR = np.array([[-0.63, -0.72], [0.29, -0.58], [0.90, 0.22], [-0.82, 0.44]])
_SIDES = 96
_EDGE_MM = 5.0


@dataclass(frozen=True)
class PlateSettings:
    """How the rings are printed. Temperatures in degrees Celsius; 0 for the bed leaves it cold.

    start_gcode, end_gcode : the user's own; {nozzle_temperature} and {bed_temperature} in them are filled in. Where
    start_gcode is None a plain start (heat, home) is written.
    """

    diameter_mm: float = 16.0
    hole_diameter_mm: float = 6.0
    height_mm: float = 1.2
    nozzle_temperature: float = 210.0
    bed_temperature: float = 60.0
    start_gcode: str | None = None
    end_gcode: str | None = None

    def __post_init__(self) -> None:
        for name, low, high in (
            ("diameter_mm", 6, 60), ("hole_diameter_mm", 1, 50), ("height_mm", 0.2, 10),
            ("nozzle_temperature", 150, 500), ("bed_temperature", 0, 200),
        ):  # fmt: skip
            value = getattr(self, name)
            if not (isinstance(value, (int, float)) and low <= value <= high):
                raise CalibrationError(f"The plate's {name} is {value}; {low} to {high} can be.")
        if self.hole_diameter_mm > self.diameter_mm - 4:
            raise CalibrationError(
                f"A hole of {self.hole_diameter_mm} mm leaves no ring of {self.diameter_mm} mm; 4 mm less at least."
            )


def printer_from_profile(profile: Any) -> Printer:
    """From OctoPrint's printer profile, or from the `printer` of a recording's header, or from either's file.

    Raises CalibrationError or RecordingError naming what is missing or makes no sense.
    """
    if isinstance(profile, Mapping) and isinstance(profile.get("printer"), Mapping):
        profile = profile["printer"]
    if not isinstance(profile, Mapping):
        raise CalibrationError("The printer profile must be an object. Export it from OctoPrint's printer profiles.")
    if "volume_mm" in profile:
        return Printer.from_json(profile)
    volume = profile.get("volume")
    if not isinstance(volume, Mapping):
        raise CalibrationError("The printer profile has no volume. Export it from OctoPrint's printer profiles.")
    extruder = profile.get("extruder")
    nozzle_mm = extruder.get("nozzleDiameter", 0.4) if isinstance(extruder, Mapping) else 0.4
    circular = str(volume.get("formFactor", "rectangular")) == "circular"
    return Printer.from_json(
        {
            "volume_mm": {side: volume.get(side) for side in ("width", "depth", "height")},
            "form_factor": volume.get("formFactor", "rectangular"),
            "origin": "center" if circular else volume.get("origin", "lowerleft"),
            "nozzle_mm": nozzle_mm,
        }
    )


def bed_middle_mm(printer: Printer) -> np.ndarray:
    """(2,) float64: the bed's middle in print coordinates."""
    return np.add(printer.bed_low_mm, (printer.width_mm / 2, printer.depth_mm / 2))


def place_markers(printer: Printer, settings: PlateSettings) -> MarkerPlate:
    """Four rings spread over the bed. Raises CalibrationError where the bed is too small for them."""
    half_mm = np.array([printer.width_mm, printer.depth_mm]) / 2
    if printer.form_factor == "circular":
        half_mm = np.full(2, half_mm.min())
    places = _CIRCULAR if printer.form_factor == "circular" else _RECTANGULAR
    room_mm = half_mm - settings.diameter_mm / 2 - _EDGE_MM
    if room_mm.min() < 1.6 * settings.diameter_mm:
        raise CalibrationError(
            f"Four rings of {settings.diameter_mm:g} mm do not fit on a bed of {printer.width_mm:g} x "
            f"{printer.depth_mm:g} mm. Make them smaller, or correct the printer profile."
        )
    layers, _ = _layers(printer, settings)
    return MarkerPlate(
        settings.diameter_mm, round(layers[-1], 4), np.round(bed_middle_mm(printer) + places * room_mm, 2),
        settings.hole_diameter_mm,
    )  # fmt: skip


def plate_gcode(printer: Printer, settings: PlateSettings) -> tuple[str, MarkerPlate]:
    """G-code that prints the rings, and where they are. Raises CalibrationError where they do not fit on the bed."""
    plate = place_markers(printer, settings)
    layers, layer_mm = _layers(printer, settings)
    writer = _Writer(printer, layer_mm)
    lines = ["; generated by octoprint-moop: marker plate for the camera's pose", *_start(settings)]
    # Whatever the start code left behind: millimetres, absolute positions, relative filament.
    lines += ["G21", "G90", "M83", "G92 E0"]
    for number, z_mm in enumerate(layers):
        lines += [";LAYER_CHANGE", f";Z:{z_mm:.3f}", f";HEIGHT:{layer_mm:.3f}", f"G1 Z{z_mm:.3f} F600"]
        writer.speed = 1200 if number == 0 else 1800
        if number == 0:
            lines += [";TYPE:Skirt", *writer.prime_line()]
        for index, centre_mm in enumerate(plate.centres_mm):
            lines += [f"; printing object marker_{index + 1} id:{index} copy 0", ";TYPE:External perimeter"]
            lines += writer.ring(centre_mm, plate.outer_diameter_mm, settings.hole_diameter_mm, number)
            lines += [f"; stop printing object marker_{index + 1} id:{index} copy 0"]
    lines += _end(settings, layers[-1], printer)
    return "\n".join(lines) + "\n", plate


def _layers(printer: Printer, settings: PlateSettings) -> tuple[list[float], float]:
    """Print heights of the layers and their thickness: about half the nozzle, the marker's height in whole layers."""
    count = max(1, round(settings.height_mm / (0.5 * printer.nozzle_mm)))
    thick_mm = settings.height_mm / count
    return [thick_mm * (number + 1) for number in range(count)], thick_mm


class _Writer:
    """Turns circles into moves, and keeps count of the filament."""

    def __init__(self, printer: Printer, layer_mm: float) -> None:
        self._printer, self._layer_mm = printer, layer_mm
        self._filament_mm2 = math.pi * (printer.filament_mm / 2) ** 2
        # Neighbouring beads have round sides and overlap a little: spacing = width - height * (1 - pi / 4).
        self._overlap_mm = layer_mm * (1 - math.pi / 4)
        self.speed = 1200

    def ring(self, centre_mm: np.ndarray, outer_mm: float, hole_mm: float, layer: int) -> list[str]:
        """Touching circles from the outermost inwards; the seam goes round from layer to layer."""
        span_mm = (outer_mm - hole_mm) / 2
        count = max(1, round(span_mm / (1.125 * self._printer.nozzle_mm)))
        spacing_mm = (span_mm - self._overlap_mm) / count
        width_mm = spacing_mm + self._overlap_mm
        lines = [f";WIDTH:{width_mm:.3f}"]
        for turn in range(count):
            radius_mm = outer_mm / 2 - width_mm / 2 - turn * spacing_mm
            angles = 2.4 * layer + np.linspace(0, 2 * math.pi, _SIDES + 1)
            # On average the polygon has the circle's radius.
            corner_mm = radius_mm * (1 + (math.pi / _SIDES) ** 2 / 3)
            points = centre_mm + corner_mm * np.column_stack([np.cos(angles), np.sin(angles)])
            lines += self._line(points, width_mm, retract=turn == 0)
        return lines

    def prime_line(self) -> list[str]:
        """A line at the front, away from the markers, that fills the nozzle."""
        printer = self._printer
        x_mm, y_mm = bed_middle_mm(printer)
        width_mm = 1.25 * printer.nozzle_mm
        if printer.form_factor == "circular":
            radius_mm = min(printer.width_mm, printer.depth_mm) / 2
            reach_mm, y_mm = 0.2 * radius_mm, -0.92 * radius_mm
        else:
            reach_mm, y_mm = 0.2 * printer.width_mm, y_mm - printer.depth_mm / 2 + 3
        line = self._line(np.array([[x_mm - reach_mm, y_mm], [x_mm + reach_mm, y_mm]]), width_mm, retract=False)
        return [f";WIDTH:{width_mm:.3f}", *line]

    def _line(self, points_mm: np.ndarray, width_mm: float, retract: bool) -> list[str]:
        area_mm2 = (width_mm - self._layer_mm) * self._layer_mm + math.pi * (self._layer_mm / 2) ** 2
        x, y = points_mm[0]
        lines = ["G1 E-0.8 F2400"] if retract else []
        lines += [f"G1 X{x:.3f} Y{y:.3f} F7200"]
        lines += ["G1 E0.8 F2400"] if retract else []
        for number, (start, end) in enumerate(zip(points_mm, points_mm[1:])):
            e_mm = float(np.hypot(*(end - start))) * area_mm2 / self._filament_mm2
            lines.append(f"G1 X{end[0]:.3f} Y{end[1]:.3f} E{e_mm:.5f}" + (f" F{self.speed}" if number == 0 else ""))
        return lines


def _filled(code: str, settings: PlateSettings) -> list[str]:
    code = code.replace("{nozzle_temperature}", f"{settings.nozzle_temperature:g}")
    return code.replace("{bed_temperature}", f"{settings.bed_temperature:g}").rstrip("\n").splitlines()


def _start(settings: PlateSettings) -> list[str]:
    if settings.start_gcode is not None:
        return _filled(settings.start_gcode, settings)
    heat = ["M140 S{bed_temperature}", "M104 S{nozzle_temperature}", "G28", "M190 S{bed_temperature}"]
    heat = heat if settings.bed_temperature else ["M104 S{nozzle_temperature}", "G28"]
    return _filled("\n".join(["G21", "G90", *heat, "M109 S{nozzle_temperature}"]), settings)


def _end(settings: PlateSettings, top_mm: float, printer: Printer) -> list[str]:
    if settings.end_gcode is not None:
        return _filled(settings.end_gcode, settings)
    lift_mm = min(top_mm + 10, printer.height_mm)
    return ["G1 E-2 F2400", f"G1 Z{lift_mm:.3f} F600", "M104 S0", "M140 S0", "M107"]
