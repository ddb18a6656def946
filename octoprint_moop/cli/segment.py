"""`moop segment`: the observed mask, as a picture."""

from __future__ import annotations

from pathlib import Path

import click
import cv2
import numpy as np

from ..core.errors import SegmentationError
from ..core.labelled import LOOK_ALIKE, LearnedFilament, learn_from_label
from ..machine.recording import read_frame
from .mask import write_png


@click.command()
@click.argument("images", nargs=-1, required=True, type=click.Path(path_type=Path), metavar="IMAGE… | RECORDING")
@click.option("--learn", metavar="FRAME=MASK", help="A frame of the same print, and its mask: non-zero is filament.")
@click.option("--box", metavar="X0,Y0,X1,Y1", help="Look only at this part of the pictures, in pixels.")
@click.option(
    "--expected",
    multiple=True,
    type=click.Path(path_type=Path),
    help="What should be there: one mask an image, in order.",
)
@click.option(
    "-o", "out", required=True, type=click.Path(path_type=Path), help="Folder for the masks; for a RECORDING, the PNG."
)
def segment(
    images: tuple[Path, ...], learn: str | None, box: str | None, expected: tuple[Path, ...], out: Path
) -> None:
    """Write which pixels are filament: 255 for filament, 0 for anything else.

    IMAGE… with --learn: learns from the one labelled frame and segments each image by itself, no camera or G-code
    needed. Writes OUT/<image's stem>.png.
    """
    if learn is None:
        raise click.UsageError("Name a labelled frame of the print: --learn FRAME.jpg=MASK.png.")
    if expected and len(expected) != len(images):
        raise click.UsageError(f"{len(images)} images need as many masks with --expected, not {len(expected)}.")
    stems = [image.stem for image in images]
    if len(set(stems)) < len(stems):
        raise click.UsageError("Two images have one name, so that one mask would replace the other. Do them apart.")
    learned = _learn(learn, _region(box))
    out.mkdir(parents=True, exist_ok=True)
    for number, image in enumerate(images):
        try:
            seen = learned.segment(read_frame(image), _read_mask(expected[number]) if expected else None)
        except SegmentationError as error:
            raise SegmentationError(f"{image}: {error}") from None
        write_png(out / f"{image.stem}.png", seen.mask)


def _learn(pair: str, region: tuple[int, int, int, int] | None) -> LearnedFilament:
    frame, found, mask = pair.partition("=")
    if not found or not frame or not mask:
        raise click.UsageError(f"--learn {pair!r}: two files are needed, FRAME.jpg=MASK.png.")
    try:
        learned = learn_from_label(read_frame(Path(frame)), _read_mask(Path(mask)), region)
    except SegmentationError as error:
        raise SegmentationError(f"{mask}: {error}") from None
    if learned.separability < LOOK_ALIKE:
        click.echo(
            f"Filament and background look alike here ({100 * learned.separability:.0f} % can be told apart by colour): "
            "more light or another bed colour would help.", err=True,
        )  # fmt: skip
    return learned


def _read_mask(path: Path) -> np.ndarray:
    """(H, W) uint8, 0 or 255. Whatever is more than half as bright as the brightest."""
    grey = cv2.cvtColor(read_frame(path), cv2.COLOR_BGR2GRAY)
    return np.where(grey > int(grey.max()) // 2, np.uint8(255), np.uint8(0))


def _region(text: str | None) -> tuple[int, int, int, int] | None:
    if text is None:
        return None
    try:
        x0, y0, x1, y1 = (round(float(part)) for part in text.split(","))
    except (ValueError, OverflowError):
        raise click.UsageError(f"--box {text!r}: four numbers are needed, X0,Y0,X1,Y1 in pixels.") from None
    return (x0, y0, x1, y1)
