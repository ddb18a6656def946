"""`moop markers`: what is printed to calibrate with: marker plate, model with markers, checkerboard."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from ..core.errors import CalibrationError
from .calibrate import named, read_json, write_json

if TYPE_CHECKING:
    from ..core.header import Printer


@click.command()
@click.option("--profile", type=click.Path(), help="OctoPrint's printer profile, or a recording's header, as JSON.")
@click.option("--bed-mm", help="The bed instead of a profile: 250x210, or 200 for a round one.")
@click.option("--origin", type=click.Choice(["lowerleft", "center"]), help="Where print coordinates begin.")
@click.option("--nozzle-mm", type=float)
@click.option("--filament-mm", type=float)
@click.option("--nozzle-temperature", type=float, default=210.0, show_default=True)
@click.option("--bed-temperature", type=float, default=60.0, show_default=True)
@click.option("--start-gcode", type=click.Path(), help="A file with your own start code.")
@click.option("--end-gcode", type=click.Path(), help="A file with your own end code.")
@click.option("--diameter-mm", type=float, default=16.0, show_default=True)
@click.option("--hole-mm", type=float, default=6.0, show_default=True)
@click.option("--height-mm", type=float, default=1.2, show_default=True)
@click.option("--model", type=click.Path(), help="Put the markers around this model and write one mesh instead.")
@click.option("--board", help="Write a checkerboard to print as well: inner corners, e.g. 9x6.")
@click.option("--square-mm", type=float, default=15.0, show_default=True, help="The checkerboard's squares.")
@click.option("-o", "--output", type=click.Path(), default=".", show_default=True, help="Folder to write to.")
@click.option("--json", "as_json", is_flag=True, help="JSON on standard output alone.")
def markers(
    profile: str | None, bed_mm: str | None, origin: str | None, nozzle_mm: float | None, filament_mm: float | None,
    nozzle_temperature: float, bed_temperature: float, start_gcode: str | None, end_gcode: str | None,
    diameter_mm: float, hole_mm: float, height_mm: float, model: str | None, board: str | None, square_mm: float,
    output: str, as_json: bool,
) -> None:  # fmt: skip
    """Make the marker plate (G-code and markers.json), or a model with markers around it."""
    from ..core.calibration.board import board_svg
    from ..core.calibration.chessboard import Board
    from ..core.calibration.plate import PlateSettings, plate_gcode

    printer = _printer(profile, bed_mm, origin, nozzle_mm, filament_mm)
    settings = PlateSettings(
        diameter_mm, hole_mm, height_mm, nozzle_temperature, bed_temperature, _text(start_gcode), _text(end_gcode)
    )
    svg = board_svg(Board.parse(board, square_mm)) if board else None
    folder = Path(output)
    folder.mkdir(parents=True, exist_ok=True)
    if model is None:
        gcode, plate = plate_gcode(printer, settings)
        printed = folder / "markers.gcode"
        printed.write_text(gcode, encoding="utf-8")
    else:
        from ..core.calibration.plate_mesh import model_with_markers

        mesh, plate = model_with_markers(model, printer, settings)
        printed = folder / f"{Path(model).stem}-markers.stl"
        mesh.export(str(printed))
    written = [str(printed), str(folder / "markers.json")]
    write_json(written[1], plate.to_json())
    if svg is not None:
        written.append(str(folder / "checkerboard.svg"))
        Path(written[-1]).write_text(svg, encoding="utf-8")
    if as_json:
        click.echo(json.dumps({"files": written, "markers": plate.to_json()}))
        return
    for path in written:
        click.echo(path)
    if model is None:
        click.echo("Print it in a colour that stands out, leave it on the bed, and run `moop calibrate pose`.")
    else:
        click.echo(
            "Slice and print it. The markers are found in its G-code, and each print tells where the camera stands."
        )


def _text(path: str | None) -> str | None:
    return None if path is None else Path(path).read_text(encoding="utf-8", errors="replace")


def _printer(
    profile: str | None, bed_mm: str | None, origin: str | None, nozzle_mm: float | None, filament_mm: float | None
) -> Printer:
    from ..core.calibration.plate import printer_from_profile
    from ..core.header import Printer

    if profile is not None:
        with named(profile):
            printer = printer_from_profile(read_json(profile))
    elif bed_mm is not None:
        try:
            sides = [float(side) for side in bed_mm.lower().split("x")]
            width, depth = sides if len(sides) == 2 else (sides[0], sides[0])
        except (ValueError, IndexError):
            raise CalibrationError(f"--bed-mm {bed_mm!r} is not of the kind 250x210, or 200 for a round bed.") from None
        shape = "rectangular" if len(sides) == 2 else "circular"
        volume = {"width": width, "depth": depth, "height": 200}
        printer = Printer.from_json({"volume_mm": volume, "form_factor": shape})
    else:
        raise CalibrationError("Which printer? Give --profile, or the bed's size with --bed-mm 250x210.")
    changes = {"origin": origin, "nozzle_mm": nozzle_mm, "filament_mm": filament_mm}
    return Printer.from_json({**printer.to_json(), **{k: v for k, v in changes.items() if v is not None}})
