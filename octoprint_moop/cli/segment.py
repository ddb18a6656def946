"""`moop segment`: the observed mask, as a picture."""

from __future__ import annotations

from pathlib import Path

import click
import cv2
import numpy as np

from ..core.camera import Camera
from ..core.errors import FrameError, SegmentationError
from ..core.gcode.read import read_gcode
from ..core.inspection import Inspector
from ..core.segmentation.clicks import Region
from ..core.segmentation.labelled import LOOK_ALIKE, LearnedFilament, learn_from_clicks, learn_from_label
from ..machine.recording import Recording, read_frame
from ..machine.renderers import open_renderer
from .mask import write_png

PATH = click.Path(path_type=Path)


class _WithManyMasks(click.Command):
    """Takes `--expected A.png B.png` for `--expected A.png --expected B.png` where images were named before."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        if args.count("--expected") == 1 and not args[0].startswith("-"):
            first = args.index("--expected") + 1
            last = next((i for i in range(first, len(args)) if args[i].startswith("-")), len(args))
            masks = [word for mask in args[first:last] for word in ("--expected", mask)]
            args = [*args[: first - 1], *(masks or ["--expected"]), *args[last:]]
        return super().parse_args(ctx, args)


@click.command(cls=_WithManyMasks)
@click.argument("images", nargs=-1, required=True, type=PATH, metavar="RECORDING | IMAGE…")
@click.option("--frame", help="A frame of the RECORDING, e.g. frames/000012.jpg.")
@click.option("--distorted", is_flag=True, help="RECORDING: in the frame's own pixels, lens distortion included.")
@click.option("--learn", metavar="FRAME[=MASK]", help="IMAGE…: a frame of the same print, and its mask.")
@click.option("--filament", multiple=True, metavar="X,Y", help="IMAGE…, no MASK: a point of FRAME on filament.")
@click.option("--background", multiple=True, metavar="X,Y", help="IMAGE…, no MASK: a point of FRAME beside it.")
@click.option("--box", metavar="X0,Y0,X1,Y1", help="IMAGE…: look only at this part of the pictures, in pixels.")
@click.option("--expected", multiple=True, type=PATH, help="IMAGE…: what should be there, one mask an image, in order.")
@click.option("-o", "out", required=True, type=PATH, help="RECORDING: the PNG; IMAGE…: the folder for the masks.")
def segment(
    images: tuple[Path, ...],
    frame: str | None,
    distorted: bool,
    learn: str | None,
    filament: tuple[str, ...],
    background: tuple[str, ...],
    box: str | None,
    expected: tuple[Path, ...],
    out: Path,
) -> None:
    """Write which pixels are filament: 255 for filament, 0 for anything else.

    RECORDING with --frame: what the live plugin would have seen in that frame, after all frames before it.

    IMAGE… with --learn: learns from the one labelled frame and segments each image by itself, no camera or G-code
    needed. Writes OUT/<image's stem>.png. Instead of a mask a few points will do, three on filament and three beside
    it: --learn FRAME --filament X,Y --filament X,Y … --background X,Y …
    """
    if (frame is None) == (learn is None):
        raise click.UsageError("Name a frame of a recording (--frame), or a labelled frame for images (--learn).")
    if frame is not None:
        if len(images) > 1 or box or expected or filament or background:
            raise click.UsageError("--frame wants one RECORDING, and none of the options for images.")
        _segment_recording(images[0], frame, distorted, out)
    elif learn is not None:
        if distorted:
            raise click.UsageError("--distorted is for a RECORDING: images are never undistorted.")
        region = _region(box)
        clicked = filament or background
        learned = _learn_from_points(learn, filament, background, region) if clicked else _learn(learn, region)
        _segment_images(images, learned, expected, out)


def _segment_recording(folder: Path, frame: str, distorted: bool, out: Path) -> None:
    """Raises FrameError where nothing can be said about that frame."""
    opened = Recording.open(folder)
    last = opened.moment(frame)
    with opened.job_path() as path:
        toolpath = read_gcode(path)
    with open_renderer() as renderer:
        inspector = Inspector(opened.header, toolpath, renderer, reference_bgr=opened.reference())
        for moment in opened.moments:
            check = inspector.check(opened.frame(moment), moment)
            if moment.frame == frame:
                break
    pictures = inspector.pictures
    if pictures is None:
        raise FrameError(f"{frame}: {check.reason}")
    observed = pictures.observed
    write_png(out, observed if distorted else _undistorted(observed, opened.header.camera(last.camera)))


def _undistorted(mask: np.ndarray, camera: Camera) -> np.ndarray:
    """The mask as a camera with a perfect lens and the same K would have seen it."""
    rectify = cv2.fisheye.initUndistortRectifyMap if camera.model == "fisheye" else cv2.initUndistortRectifyMap
    maps = rectify(camera.K, camera.distortion, np.eye(3), camera.K, mask.shape[::-1], cv2.CV_32FC1)
    return np.where(cv2.remap(mask, *maps, cv2.INTER_LINEAR) > 127, np.uint8(255), np.uint8(0))


def _segment_images(
    images: tuple[Path, ...],
    learned: LearnedFilament,
    expected: tuple[Path, ...],
    out: Path,
) -> None:
    if expected and len(expected) != len(images):
        raise click.UsageError(f"{len(images)} images need as many masks with --expected, not {len(expected)}.")
    if len({image.stem for image in images}) < len(images):
        raise click.UsageError("Two images have one name, so that one mask would replace the other. Do them apart.")
    if learned.separability < LOOK_ALIKE:
        click.echo(
            f"moop: filament and background look alike here ({100 * learned.separability:.0f} % of them can be told "
            "apart by colour): more light or another bed colour would help.",
            err=True,
        )
    out.mkdir(parents=True, exist_ok=True)
    for number, image in enumerate(images):
        try:
            seen = learned.segment(read_frame(image), _read_mask(expected[number]) if expected else None)
        except SegmentationError as error:
            raise SegmentationError(f"{image}: {error}") from None
        write_png(out / f"{image.stem}.png", seen.mask)


def _learn(pair: str, region: Region | None) -> LearnedFilament:
    frame, found, mask = pair.partition("=")
    if not found or not frame or not mask:
        raise click.UsageError(
            f"--learn {pair!r}: two files are needed, FRAME.jpg=MASK.png, or points with --filament and --background."
        )
    try:
        return learn_from_label(read_frame(Path(frame)), _read_mask(Path(mask)), region)
    except SegmentationError as error:
        raise SegmentationError(f"{mask}: {error}") from None


def _learn_from_points(
    frame: str, filament: tuple[str, ...], background: tuple[str, ...], region: Region | None
) -> LearnedFilament:
    on, off = ([_point(text) for text in points] for points in (filament, background))
    try:
        return learn_from_clicks(read_frame(Path(frame)), on, off, region)
    except SegmentationError as error:
        raise SegmentationError(f"{frame}: {error}") from None


def _read_mask(path: Path) -> np.ndarray:
    """(H, W) uint8, 0 or 255: 255 for whatever is more than half as bright as the brightest."""
    grey = cv2.cvtColor(read_frame(path), cv2.COLOR_BGR2GRAY)
    return np.where(grey > int(grey.max()) // 2, np.uint8(255), np.uint8(0))


def _region(text: str | None) -> Region | None:
    if text is None:
        return None
    try:
        x0, y0, x1, y1 = (round(float(part)) for part in text.split(","))
    except (ValueError, OverflowError):
        raise click.UsageError(f"--box {text!r}: four numbers are needed, X0,Y0,X1,Y1 in pixels.") from None
    return (x0, y0, x1, y1)


def _point(text: str) -> tuple[int, int]:
    try:
        x, y = (round(float(part)) for part in text.split(","))
    except (ValueError, OverflowError):
        raise click.UsageError(f"The point {text!r}: two numbers are needed, X,Y in pixels.") from None
    return (x, y)
