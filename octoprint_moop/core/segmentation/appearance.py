"""What filament and background look like in this print: colour statistics, and the same pixel's own past.

Two kinds of evidence say whether a pixel is filament. Its colour, against histograms learned from this print; and the
*plate*: the last picture in which it was known what this very pixel showed. A camera that stands still sees an
unchanged pixel as what it was, which tells a black print from a black gantry where colour cannot.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import cv2
import numpy as np

_BITS = 5  # of each channel: 32 x 32 x 32 cells of colour
_CELLS = 1 << (3 * _BITS)
_CELL_VOLUME = float((256 >> _BITS) ** 3)
_STRETCH = 1.5  # filaments and beds differ in their chroma by a tenth of what they differ in brightness
_FLOOR = 1e-8  # density of a colour never seen: neither filament nor background is favoured

# How far an unchanged pixel wanders in opponent colours (noise, JPEG blocks, shading), and how often it is unchanged
_STAY_SIGMA = 10.0
_STAY_SHARE = 0.5
EVIDENCE_MAX = 4.0  # one pixel never says more than 55 : 1, since its neighbours repeat it


# ITU-R BT.601, as in a JPEG's own Y, Cb, Cr: rows of (blue, green, red, 1)
_OPPONENT = np.array(
    [
        [0.114, 0.587, 0.299, 0],
        [0.5 * _STRETCH, -0.331264 * _STRETCH, -0.168736 * _STRETCH, 128],
        [-0.081312 * _STRETCH, -0.418688 * _STRETCH, 0.5 * _STRETCH, 128],
    ]
)


def opponent(frame_bgr: np.ndarray) -> np.ndarray:
    """(H, W, 3) uint8: brightness, and blue and red chroma about 128 stretched by one and a half."""
    return cv2.transform(frame_bgr, _OPPONENT)


def cells_of(colours: np.ndarray) -> np.ndarray:
    """(H, W) uint16: the histogram cell of each pixel of an opponent picture, five bits of each channel."""
    # what OpenCV calls 5-5-5 is just that, and by far the quickest way to it
    return cv2.cvtColor(colours, cv2.COLOR_RGB2BGR555).view(np.uint16)[..., 0]


def _smooth(histogram: np.ndarray) -> np.ndarray:
    """The histogram (float32, flat) blurred by one cell along each axis, so that a few hundred pixels fill it."""
    side = 1 << _BITS
    kernel = cv2.getGaussianKernel(7, 1.0).astype(np.float32)
    flat = histogram.astype(np.float32).reshape(side, side * side)
    one = np.ones((1, 1), np.float32)
    cube = cv2.sepFilter2D(flat, -1, one, kernel).reshape(side, side, side)
    return np.stack([cv2.sepFilter2D(plane, -1, kernel, kernel) for plane in cube]).reshape(-1)


def channel_sum(picture: np.ndarray) -> np.ndarray:
    """(H, W) uint8: the sum of the three channels of (H, W, 3), 255 where it is more."""
    first, second, third = (cv2.extractChannel(picture, number) for number in range(3))
    return cv2.add(cv2.add(first, second), third)


def count_colours(colours: np.ndarray, where: np.ndarray) -> np.ndarray:
    """(32768,) float64: how many of the pixels chosen by `where` (bool) have each colour of an opponent picture."""
    return count_kinds(colours, where)[0]


def count_kinds(colours: np.ndarray, *kinds: np.ndarray) -> list[np.ndarray]:
    """`count_colours` for each of several choices (bool)."""
    cells = cells_of(colours)
    return [np.bincount(cells[where], minlength=_CELLS).astype(np.float64) for where in kinds]


def every_colour() -> np.ndarray:
    """(1, 32768, 3) uint8 BGR: the colour in the middle of each cell, in the order of the counts."""
    side, width = 1 << _BITS, 256 >> _BITS
    middles = np.stack(np.meshgrid(*[np.arange(side)] * 3, indexing="ij"), axis=-1) * width + width // 2
    bgr = (middles - _OPPONENT[:, 3]) @ np.linalg.inv(_OPPONENT[:, :3]).T
    return np.clip(bgr.round(), 0, 255).astype(np.uint8).reshape(1, -1, 3)


@dataclass(frozen=True, eq=False)
class ColourModel:
    """Counts of colours on filament and on background, each (32768,) float64, and the densities made of them.

    densities : (2, 32768) float32: how dense filament (0) and background (1) lie about each colour
    ratios    : (32768,) float32: log of the first over the second
    separability : 0..1, the share of filament and background that colour alone tells apart, 0 where they look alike:
                   total variation distance of the densities, that is 1 - 2 x the error of the best possible guess
    """

    filament: np.ndarray
    background: np.ndarray
    densities: np.ndarray = field(init=False)
    ratios: np.ndarray = field(init=False)
    separability: float = field(init=False)

    def __post_init__(self) -> None:
        dense = np.stack(
            [
                _smooth(counts) / (max(float(counts.sum()), 1.0) * _CELL_VOLUME)
                for counts in (self.filament, self.background)
            ]
        ).astype(np.float32)
        object.__setattr__(self, "densities", dense)
        apart = float(min(1.0, 0.5 * np.abs(dense[0] - dense[1]).sum() * _CELL_VOLUME))
        object.__setattr__(self, "separability", apart)
        object.__setattr__(self, "ratios", np.log((dense[0] + _FLOOR) / (dense[1] + _FLOOR)))


@dataclass(frozen=True, eq=False)
class Plate:
    """What each pixel was known to show.

    colours : (H, W, 3) uint8, opponent picture
    known   : (H, W) int8: 1 filament, -1 background, 0 not known
    """

    colours: np.ndarray
    known: np.ndarray

    def shrunk(self, step: int) -> Plate:
        """At 1/step of the size."""
        if step == 1:
            return self
        size = (max(self.known.shape[1] // step, 1), max(self.known.shape[0] // step, 1))
        known = cv2.resize(self.known.astype(np.float32), size, interpolation=cv2.INTER_AREA)
        return Plate(
            cv2.resize(self.colours, size, interpolation=cv2.INTER_AREA), np.sign(np.round(known)).astype(np.int8)
        )

    def part(self, region: tuple[int, int, int, int]) -> Plate:
        """Of the region (x0, y0, x1, y1)."""
        x0, y0, x1, y1 = region
        return Plate(self.colours[y0:y1, x0:x1], self.known[y0:y1, x0:x1])


def _stay_table() -> np.ndarray:
    """(256,) float32: density of an unchanged pixel by the sum of its channels' differences.

    The sum of three is 1.5 times their root of squares in the mean over directions, and needs no floating point.
    """
    distance = np.arange(256) / 1.5
    density = np.exp(-0.5 * (distance / _STAY_SIGMA) ** 2) / ((2 * np.pi) ** 1.5 * _STAY_SIGMA**3)
    return density.astype(np.float32)


_STAY = _stay_table()


def evidence(colours: np.ndarray, model: ColourModel, plate: Plate | None = None, change: float = 1.0) -> np.ndarray:
    """(H, W) float32: log likelihood ratio of filament against background, within +-EVIDENCE_MAX.

    A pixel known to have shown filament shows, if filament, either the same as then or any filament colour; likewise
    for background. 0 where the picture says nothing.

    change : 0..1, how much it counts that a pixel is not what it was: shade and mirror images change a bed as well
    """
    cells = cells_of(colours)
    ratio = np.take(model.ratios, cells, mode="clip")  # which they all are within, but numpy need not ask
    if plate is not None:
        share, least = np.float32(_STAY_SHARE), np.float32(change * math.log(1 - _STAY_SHARE))
        # where colour says all that may be said, nothing is gained
        few = np.flatnonzero(ratio * plate.known < EVIDENCE_MAX - least)
        apart = cv2.blur(channel_sum(cv2.absdiff(colours, plate.colours)), (3, 3))
        stay, known = _STAY[apart.ravel()[few]], plate.known.ravel()[few]
        dense = model.densities[(known < 0).view(np.uint8), cells.ravel()[few]] + np.float32(_FLOOR)
        # log(share x stay + (1 - share) x dense) - log(dense), of the kind that the pixel was known to be
        gain = np.maximum(np.log(stay * (share / dense) + (1 - share)), least)
        ratio.ravel()[few] += gain * known
    return np.clip(ratio, -EVIDENCE_MAX, EVIDENCE_MAX, out=ratio)
