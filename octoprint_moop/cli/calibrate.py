"""`moop calibrate`: the lens from a checkerboard, the pose from ring markers or clicked points."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import cv2
import numpy as np

from ..core.errors import CalibrationError, FrameError, MoopError

if TYPE_CHECKING:
    from ..core.calibration.calibrate import Lens
    from ..core.calibration.markers import MarkerPlate
    from ..core.calibration.pose import PoseResult


def read_picture(path: str) -> np.ndarray:
    """(H, W, 3) uint8 BGR. Raises FrameError where the file is no picture, OSError where it cannot be read."""
    data = np.frombuffer(Path(path).read_bytes(), np.uint8)
    picture = cv2.imdecode(data, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION) if data.size else None
    if picture is None:
        raise FrameError(f"{path}: not a picture that can be read. Save it again as JPEG or PNG.")
    return picture


def read_json(path: str) -> Any:
    """Raises CalibrationError where the file is not JSON, OSError where it cannot be read."""
    try:
        return json.loads(Path(path).read_text(encoding="utf-8"))
    except ValueError as error:
        raise CalibrationError(f"{path}: not JSON ({error}). Export it again.") from None


def read_markers(path: str) -> MarkerPlate:
    """From markers.json, or from a job's own G-code. Raises CalibrationError where there are none, OSError."""
    from ..core.calibration.markers import MarkerPlate
    from ..core.calibration.printed import markers_in
    from ..core.gcode.read import read_gcode

    if not path.lower().endswith((".gcode", ".gco", ".g", ".gz")):
        with named(path):
            return MarkerPlate.from_json(read_json(path))
    found = markers_in(read_gcode(Path(path)))
    if found is None:
        raise CalibrationError(
            f"{path}: no four equal rings that stand alone on the bed. `moop markers --model` puts them around a model."
        )
    return found


@contextlib.contextmanager
def named(path: str) -> Iterator[None]:
    """An error about what a file holds names the file."""
    try:
        yield
    except MoopError as error:
        raise error if path in str(error) else type(error)(f"{path}: {error}") from None


def read_lens(path: str) -> Lens:
    """Raises CalibrationError where the file holds none, OSError where it cannot be read."""
    from ..core.calibration.calibrate import Lens

    with named(path):
        return Lens.from_json(read_json(path))


def write_json(path: str, data: dict[str, Any]) -> None:
    Path(path).write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")


@click.group()
def calibrate() -> None:
    """Find the lens and the place of the camera."""


@calibrate.command()
@click.argument("images", nargs=-1, required=True, type=click.Path())
@click.option("--board", "corners", default="9x6", show_default=True, help="Inner corners: columns x rows.")
@click.option("--square-mm", type=float, required=True, help="Side of a square, as measured on the print.")
@click.option("--model", type=click.Choice(["auto", "pinhole", "fisheye"]), default="auto", show_default=True)
@click.option("-o", "--output", type=click.Path(), help="Write the lens here; `calibrate pose --lens` reads it.")
@click.option("--json", "as_json", is_flag=True, help="JSON on standard output alone.")
def lens(
    images: tuple[str, ...], corners: str, square_mm: float, model: str, output: str | None, as_json: bool
) -> None:
    """The lens, from about 12 IMAGES of a checkerboard tilted in different ways."""
    from ..core.calibration.calibrate import calibrate_lens
    from ..core.calibration.chessboard import Board

    board = Board.parse(corners, square_mm)
    result = calibrate_lens([(path, read_picture(path)) for path in images], board, model)
    data = result.to_json()
    if output:
        write_json(output, data)
    if as_json:
        click.echo(json.dumps(data))
        return
    click.echo(f"{len(result.used)} of {len(images)} pictures used, over {result.coverage_ratio:.0%} of the image.")
    for name, why in result.rejected:
        click.echo(f"  not used: {name}: {why}")
    K = result.lens.K
    click.echo(f"{result.lens.model}, distortion {result.order}: f {K[0, 0]:.1f} x {K[1, 1]:.1f} px, "
               f"centre {K[0, 2]:.1f}, {K[1, 2]:.1f} px")  # fmt: skip
    mean_px, worst_px = result.error_px
    click.echo(f"corners fit to {result.rms_px:.3f} px, unseen views to {result.held_out_px:.3f} px; "
               f"over the whole image the lens is sure to {mean_px:.2f} px (worst {worst_px:.2f})")  # fmt: skip
    for note in result.notes:
        click.echo(note)


@calibrate.command()
@click.argument("image", type=click.Path())
@click.option("--lens", "lens_path", required=True, type=click.Path(), help="What `calibrate lens -o` wrote.")
@click.option(
    "--markers", "markers_path", required=True, type=click.Path(), help="markers.json, or the G-code that printed them."
)
@click.option("--hue", help="The markers' hue in degrees: from,to; wraps through 0.")
@click.option("--saturation-min", type=float, default=0.4, show_default=True)
@click.option("--value-min", type=float, default=0.25, show_default=True)
@click.option("-o", "--output", type=click.Path(), help="Write the camera here.")
@click.option("--json", "as_json", is_flag=True, help="JSON on standard output alone.")
def pose(
    image: str, lens_path: str, markers_path: str, hue: str | None, saturation_min: float, value_min: float,
    output: str | None, as_json: bool,
) -> None:  # fmt: skip
    """The camera's pose, from an IMAGE of the marker plate on the bed."""
    from ..core.calibration.pose import calibrate_pose, calibrate_pose_any_colour

    plate = read_markers(markers_path)
    lens_found = read_lens(lens_path)
    picture = read_picture(image)
    if hue is None:
        result = calibrate_pose_any_colour(picture, lens_found, plate)
    else:
        result = calibrate_pose(picture, lens_found, plate, parse_colour(hue, saturation_min, value_min))
    report_pose(result, "markers", output, as_json)


def report_pose(result: PoseResult, what: str, output: str | None, as_json: bool) -> None:
    data = result.to_json()
    if output:
        write_json(output, data)
    if as_json:
        click.echo(json.dumps(data))
        return
    found = sum(px is not None for px in result.markers_px)
    x, y, z = result.camera.centre_mm
    click.echo(f"{found} of {len(result.markers_px)} {what}; they fit to {result.rms_px:.2f} px.")
    click.echo(
        f"The camera stands at {x:.0f}, {y:.0f}, {z:.0f} mm; points of a print are sure to {result.error_px[0]:.2f} px "
        f"({result.error_mm[0]:.2f} mm), at worst {result.error_px[1]:.2f} px."
    )
    for note in result.notes:
        click.echo(note)


def parse_colour(hue: str, saturation_min: float, value_min: float) -> Any:
    """HsvThresholds from "18,47". Raises SegmentationError, or CalibrationError where it is no pair of numbers."""
    from ..core.segmentation.segment import HsvThresholds

    try:
        low, high = (float(part) % 360 if float(part) != 360 else 360.0 for part in hue.split(","))
    except ValueError:
        raise CalibrationError(f"--hue {hue!r} is not of the kind 18,47 (degrees).") from None
    return HsvThresholds(low, high, saturation_min, value_min)


@calibrate.command()
@click.argument("image", type=click.Path())
@click.argument("points_path", metavar="POINTS", type=click.Path())
@click.option("--lens", "lens_path", type=click.Path(), help="What `calibrate lens -o` wrote; without it, a guess.")
@click.option("--click-px", type=float, default=2.0, show_default=True, help="How far off a click is, usually.")
@click.option("-o", "--output", type=click.Path(), help="Write the camera here.")
@click.option("--json", "as_json", is_flag=True, help="JSON on standard output alone.")
def points(
    image: str, points_path: str, lens_path: str | None, click_px: float, output: str | None, as_json: bool
) -> None:
    """The camera's pose, from POINTS clicked on an IMAGE: a JSON list of {"mm": [x, y, z], "px": [u, v]}."""
    from ..core.calibration.clicks import Points, pose_from_points

    with named(points_path):
        clicked = Points.from_json(read_json(points_path))
    lens_found = None if lens_path is None else read_lens(lens_path)
    height, width = read_picture(image).shape[:2]
    if not 0.1 <= click_px <= 100:
        raise CalibrationError(f"--click-px is {click_px}; 0.1 to 100 can be.")
    report_pose(pose_from_points(clicked, (width, height), lens_found, click_px), "points", output, as_json)
