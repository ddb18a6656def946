"""`moop mask`: the expected mask of a recording, as a picture."""

from __future__ import annotations

from pathlib import Path

import click
import cv2

from ..core.errors import MoopError, RecordingError
from ..core.expected.meshroad import MeshRoad
from ..core.expected.solid import read_solid
from ..core.expected.views import ExpectedViews
from ..core.gcode.read import read_gcode
from ..machine.recording import Recording
from ..machine.renderers import open_renderer


@click.command()
@click.argument("recording", type=click.Path(path_type=Path))
@click.option("--frame", help="The moment of this frame, e.g. frames/000012.jpg.")
@click.option("--file-pos", type=int, help="The moment when the file is executed up to this position.")
@click.option(
    "--position", help="Where the machine stands then, X,Y,Z in mm; the bed's reference position if left out."
)
@click.option("--complete", is_flag=True, help="The complete print.")
@click.option("--distorted", is_flag=True, help="In the frame's own pixels, lens distortion included.")
@click.option("--mesh", type=click.Path(path_type=Path), help="Draw this model (STL, OBJ, 3MF) instead of the beads.")
@click.option("-o", "out", required=True, type=click.Path(path_type=Path), help="The PNG to write: 0 or 255.")
def mask(
    recording: Path,
    frame: str | None,
    file_pos: int | None,
    position: str | None,
    complete: bool,
    distorted: bool,
    mesh: Path | None,
    out: Path,
) -> None:
    """Write what the camera must see of the print in RECORDING at one moment."""
    if (frame is not None) + (file_pos is not None) + complete != 1:
        raise click.UsageError("Name exactly one of --frame, --file-pos and --complete.")
    opened = Recording.open(recording)
    bed = opened.header.printer.bed
    camera = opened.header.camera()
    position_mm = _position_mm(position) or bed.reference_mm
    if frame is not None:
        moment = opened.moment(frame)
        camera = opened.header.camera(moment.camera)
        file_pos, position_mm = moment.file_pos, _position_mm(position) or moment.position_mm
    if not distorted:
        camera = camera.undistorted()
    with opened.job_path() as path:
        toolpath = read_gcode(path)
    solid = None if mesh is None else read_solid(mesh).placed_on(toolpath)
    for note in () if solid is None else solid.notes:
        click.echo(note, err=True)
    with open_renderer() as renderer:
        road = renderer if solid is None else MeshRoad(renderer, solid)
        expected = ExpectedViews(toolpath, camera, bed, road).at(file_pos or 0, position_mm)
        write_png(out, expected.complete if complete else expected.mask)


def write_png(path: Path, image) -> None:
    """Raises RecordingError where the picture cannot be written there."""
    done, data = cv2.imencode(".png", image)
    if not done:
        raise RecordingError(f"{path}: the picture cannot be written as PNG.")
    path.write_bytes(data.tobytes())


def _position_mm(text: str | None) -> tuple[float, float, float] | None:
    """Raises MoopError unless the text is three numbers."""
    if text is None:
        return None
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        raise MoopError(f"--position {text!r}: three numbers are needed, X,Y,Z in mm, as in 0,200,2.6.") from None
    return (x, y, z)
