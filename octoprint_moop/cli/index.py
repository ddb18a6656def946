"""`moop index`: what a G-code file lays down."""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

import click

from ..core.gcode.read import read_gcode
from ..core.toolpath import Toolpath

LONG_S = 1.0  # reading that takes longer shows how far it is


@click.command()
@click.argument("file", type=click.Path(path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="JSON on standard output.")
@click.option("--cache", "cache_dir", type=click.Path(path_type=Path), help="Keep what was read in this folder.")
@click.option("--nozzle-mm", default=0.4, show_default=True, help="Nozzle, where beads' widths are not stated.")
@click.option("--filament-mm", default=1.75, show_default=True, help="Filament, where the file does not state it.")
def index(file: Path, as_json: bool, cache_dir: Path | None, nozzle_mm: float, filament_mm: float) -> None:
    """Layers, bounds, objects and filament of a G-code FILE, as its moves tell them."""
    began = time.monotonic()
    toolpath = read_gcode(
        file, cache_dir=cache_dir, nozzle_mm=nozzle_mm, filament_mm=filament_mm, progress=_progress(file.name, began)
    )
    seconds = time.monotonic() - began
    if as_json:
        click.echo(json.dumps(as_dict(toolpath, seconds), ensure_ascii=False))
    else:
        click.echo(for_people(file.name, toolpath, seconds))


def as_dict(toolpath: Toolpath, seconds: float) -> dict[str, object]:
    """The JSON of `moop index --json`."""
    return {
        "layers": toolpath.layers,
        "segments": len(toolpath),
        "bounds_mm": [[round(float(v), 3) for v in corner] for corner in toolpath.bounds_mm()],
        "filament_mm": round(toolpath.filament_mm, 2),
        "filament_own_mm": round(toolpath.filament_own_mm, 2),
        "objects": list(toolpath.objects),
        "slicer": toolpath.slicer,
        "bytes": toolpath.bytes,
        "seconds": round(seconds, 3),
    }


def for_people(name: str, toolpath: Toolpath, seconds: float) -> str:
    low, high = toolpath.bounds_mm()
    sizes = " x ".join(f"{high[i] - low[i]:.1f}" for i in range(2))
    lines = [
        f"{name}: {toolpath.layers} layers, {len(toolpath)} beads, sliced by {toolpath.slicer or 'an unknown slicer'}",
        f"  extruded   {sizes} mm on the bed, up to z = {high[2]:.2f} mm",
        f"  from, to   ({low[0]:.2f}, {low[1]:.2f}), ({high[0]:.2f}, {high[1]:.2f}) mm",
        f"  filament   {toolpath.filament_mm / 1000.0:.2f} m",
        f"  objects    {', '.join(toolpath.objects) or 'none labelled'}",
        *(f"  note       {note}" for note in toolpath.notes),
        f"  {toolpath.bytes} bytes read in {seconds:.2f} s",
    ]
    return "\n".join(lines)


def _progress(name: str, began: float):
    """Progress on standard error, for files that take long; one line that is rewritten on a terminal."""
    shown = [-1]

    def show(ratio: float) -> None:
        percent = int(100 * ratio)
        if time.monotonic() - began < LONG_S or percent < shown[0] + 5:
            return
        shown[0] = percent
        ending = "\r" if sys.stderr.isatty() and percent < 100 else "\n"
        click.echo(f"{name}: {percent} %{ending}", err=True, nl=False)

    return show
