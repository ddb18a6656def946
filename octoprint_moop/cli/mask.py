"""`moop mask`: the expected mask of a recording, as a picture."""

from __future__ import annotations

import math
from pathlib import Path

import click
import cv2

from ..core.errors import MoopError, RecordingError
from ..core.expected.views import ExpectedViews
from ..machine.recording import Recording
from ..machine.renderers import open_renderer
from ..machine.roads import MeshChoice
from .replay import placement_from


@click.command()
@click.argument("recording", type=click.Path(path_type=Path))
@click.option("--frame", help="The moment of this frame, e.g. frames/000012.jpg.")
@click.option(
    "--file-pos", type=click.IntRange(min=0), help="The moment when the file is executed up to this position."
)
@click.option(
    "--position", help="Where the machine stands then, X,Y,Z in mm; the bed's reference position if left out."
)
@click.option("--complete", is_flag=True, help="The complete print.")
@click.option("--distorted", is_flag=True, help="In the frame's own pixels, lens distortion included.")
@click.option("--mesh", type=click.Path(path_type=Path), help="Draw this model (STL, OBJ, 3MF) instead of the beads.")
@click.option(
    "--mesh-at", metavar="X,Y[,DEG]", help="Middle of the model on the bed, mm, and its turn; else by bounds."
)
@click.option("-o", "out", required=True, type=click.Path(path_type=Path), help="The PNG to write: 0 or 255.")
def mask(
    recording: Path,
    frame: str | None,
    file_pos: int | None,
    position: str | None,
    complete: bool,
    distorted: bool,
    mesh: Path | None,
    mesh_at: str | None,
    out: Path,
) -> None:
    """Write what the camera must see of the print in RECORDING at one moment."""
    if (frame is not None) + (file_pos is not None) + complete != 1:
        raise click.UsageError("Name exactly one of --frame, --file-pos and --complete.")
    if mesh is None and mesh_at is not None:
        raise click.UsageError("--mesh-at is about a model: name it with --mesh.")
    opened = Recording.open(recording)
    bed = opened.header.printer.bed
    camera = opened.header.camera()
    position_mm = _position_mm(position) or bed.reference_mm
    road = opened.road(None if mesh is None else MeshChoice(mesh, placement_from(mesh_at)))
    if frame is not None:
        moment = road.moment(opened.moment(frame))
        camera = opened.header.camera(moment.camera)
        file_pos, position_mm = moment.file_pos, _position_mm(position) or moment.position_mm
    if not distorted:
        camera = camera.undistorted()
    for note in () if road.solid is None else road.notes:
        click.echo(note, err=True)
    with open_renderer() as renderer:
        views = ExpectedViews(road.toolpath, camera, bed, road.drawn_by(renderer))
        expected = views.at(file_pos or 0, position_mm)
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
        if not all(map(math.isfinite, (x, y, z))):
            raise ValueError
    except ValueError:
        raise MoopError(f"--position {text!r}: three numbers are needed, X,Y,Z in mm, as in 0,200,2.6.") from None
    return (x, y, z)
