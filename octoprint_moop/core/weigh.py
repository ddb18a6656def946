"""Which pixels are filament, of any colour and in most light: what is known of this print, weighed pixel by pixel.

Evidence (appearance.py) says how much a pixel looks like filament. What is expected (explain.py) says where filament
should be: as a whole it may be as expected, moved, or unfinished, and only the story that the picture supports is
believed, more so near its edges than beyond. A guided filter (He et al. 2010) then smooths the sum along the picture's
own edges, so that noise goes and thin walls stay.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Optional

import cv2
import numpy as np

from .appearance import EVIDENCE_MAX, ColourModel, Plate, count_colours, evidence, opponent
from .explain import explain
from .segment import Observation

WORK_PX = 310_000  # pixels in the region beyond which the work is done at a half, a third, … of the size

_EXPECTED_WEIGHT = 3.0  # log-odds given to the believed story well inside and well outside of it
_EDGE_PX = 2.0  # the story's edge is this uncertain: the weight grows from 0 to full over it
_WRONG_LOOK = -0.3  # support below which the learned colours are not what is seen in this frame
_ALIKE, _APART = 0.8, 0.95  # separability: below, only neighbours together decide; above, each pixel by itself
_UNSURE = 0.25  # evidence, after smoothing, that says neither
_GUIDE_RADIUS_PX, _GUIDE_NOISE = 8, 0.01


@dataclass(frozen=True, eq=False)
class Look:
    """Everything about a region that does not depend on the frame, at the size at which the work is done.

    plate      : what the pixels are known to have shown, None where nothing is known
    place      : (H, W) float32, log-odds that filament is there before looking, where no expected mask is given
    underneath : (H, W) float32, log-odds (0 or less) under the print: what is seen there is its mirror image
    step       : the region's size over the work's size
    """

    plate: Optional[Plate]
    place: np.ndarray
    underneath: np.ndarray
    step: int

    @classmethod
    def without_label(cls, plate: Optional[Plate], shape: tuple[int, int]) -> Look:
        """Nothing is known about where filament is."""
        step = _step(shape)
        nothing = np.zeros(_work_shape(shape, step), np.float32)
        return cls(None if plate is None else plate.shrunk(step), nothing, nothing, step)


def _step(shape: tuple[int, int]) -> int:
    return math.ceil(math.sqrt(shape[0] * shape[1] / WORK_PX))


def _work_shape(shape: tuple[int, int], step: int) -> tuple[int, int]:
    return (max(shape[0] // step, 1), max(shape[1] // step, 1))


def _at_work_size(picture: np.ndarray, step: int) -> np.ndarray:
    if step == 1:
        return picture
    height, width = _work_shape(picture.shape[:2], step)
    return cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA)


def _mask_at_work_size(mask: np.ndarray, step: int) -> np.ndarray:
    return np.where(_at_work_size(mask, step) > 127, np.uint8(255), np.uint8(0))


def _edge_preserving(values: np.ndarray, guide: np.ndarray, full_guide: np.ndarray, radius: int) -> np.ndarray:
    """The guided filter of `values` by `guide`; (fast variant) carried to the size of `full_guide`."""
    window = (2 * radius + 1, 2 * radius + 1)
    guide = guide.astype(np.float32) / 255
    mean_guide, mean = cv2.blur(guide, window), cv2.blur(values, window)
    variance = cv2.blur(guide * guide, window) - mean_guide * mean_guide
    slope = (cv2.blur(guide * values, window) - mean_guide * mean) / (variance + _GUIDE_NOISE)
    offset = cv2.blur(mean - slope * mean_guide, window)
    slope = cv2.blur(slope, window)
    if full_guide.shape != guide.shape:
        size = full_guide.shape[::-1]
        slope = cv2.resize(slope, size, interpolation=cv2.INTER_LINEAR)
        offset = cv2.resize(offset, size, interpolation=cv2.INTER_LINEAR)
    return slope * (full_guide.astype(np.float32) / 255) + offset


def _expected_odds(mask: np.ndarray) -> np.ndarray:
    """(H, W) float32: log-odds of filament by the distance to the edge of a mask that is believed."""
    inside = cv2.distanceTransform(mask, cv2.DIST_L2, 3)
    outside = cv2.distanceTransform(cv2.bitwise_not(mask), cv2.DIST_L2, 3)
    if not mask.any():
        return np.full(mask.shape, -_EXPECTED_WEIGHT, np.float32)
    return np.clip((inside - outside) / _EDGE_PX, -1, 1) * np.float32(_EXPECTED_WEIGHT)


def _own_colours(colours: np.ndarray, mask: np.ndarray) -> tuple[np.ndarray, float]:
    """(H, W) float32 evidence by this frame's own colours inside the mask against those around it, and how well those
    are told apart, 0..1.

    For a first layer that looks unlike the bulk (a thin strand in the head's shadow). Never kept.
    """
    around = cv2.dilate(mask, np.ones((51, 51), np.uint8)) > cv2.dilate(mask, np.ones((5, 5), np.uint8))
    if mask.any() and around.any():
        model = ColourModel(count_colours(colours, mask > 0), count_colours(colours, around))
        return cv2.blur(np.clip(evidence(colours, model), -2, 2), (3, 3)), model.separability
    return np.zeros(mask.shape, np.float32), 0.0


def _top_odds(seen: np.ndarray, label: np.ndarray) -> np.ndarray:
    """(H, 1) float32: log-odds that a row of the labelled print is already (or no longer) printed.

    Prints grow upwards: the evidence within the label, summed from below, says up to which row it reaches.
    """
    rows = np.flatnonzero(label.any(axis=1))
    top, bottom = rows[0], rows[-1]
    per_row = np.where(label, seen, 0).sum(axis=1)
    score = np.cumsum(per_row[::-1])[::-1][top : bottom + 1] * 0.05
    likely = np.exp(score - score.max())
    likely /= likely.sum()
    reached = np.zeros(len(label))
    reached[:top] = likely[:3].sum()
    reached[top : bottom + 1] = np.cumsum(likely)
    reached[bottom + 1 :] = 1
    odds = np.log((reached + 0.01) / (1.01 - reached))
    return np.clip(odds, -2, 2).astype(np.float32)[:, None]


def look_of_label(frame_bgr: np.ndarray, label: np.ndarray) -> Look:
    """What a labelled picture tells about every later one: the plate, and where filament probably is."""
    step = _step(label.shape)
    known = np.where(label > 0, 1, -1).astype(np.int8)
    plate = Plate(opponent(frame_bgr), known).shrunk(step)
    mask = _mask_at_work_size(label, step)
    height, width = mask.shape
    size_px = np.sqrt(cv2.countNonZero(mask))
    outside = cv2.distanceTransform(cv2.bitwise_not(mask), cv2.DIST_L2, 5)
    place = np.where(mask > 0, 1.0, -np.minimum(outside / (size_px / 2), 1))
    columns = np.flatnonzero(mask.any(axis=0))
    lowest = np.interp(np.arange(width), columns, height - 1 - mask[::-1].argmax(axis=0)[columns])
    underneath = -EVIDENCE_MAX * np.clip((np.arange(height)[:, None] - lowest - 2) / 4, 0, 1)
    return Look(plate, (place + underneath).astype(np.float32), underneath.astype(np.float32), step)


def weigh(
    frame_bgr: np.ndarray, model: ColourModel, look: Look, expected: Optional[np.ndarray] = None
) -> Observation:
    """The region's pixels that are filament, and those on which neither is said.

    frame_bgr : (H, W, 3) uint8, the region of a frame; expected : (H, W) uint8, what should be there, right or wrong
    """
    small = _at_work_size(frame_bgr, look.step)
    colours = opponent(small)
    seen = evidence(colours, model, look.plate)
    if expected is None:
        odds = seen + look.place
        if look.plate is not None and (look.plate.known > 0).any():
            label = look.plate.known > 0
            rows = _top_odds(seen, label)
            odds += np.where(label, rows, np.minimum(rows, 0))
    else:
        mask = _mask_at_work_size(expected, look.step)
        story = explain(seen + look.underneath, mask)
        if story.support < _WRONG_LOOK:
            own, contrast = _own_colours(colours, mask)
            # what looks like everything around it is not there
            trust = float(np.clip((contrast - 0.3) / 0.4, 0, 1))
            seen = (1 - 0.75 * trust) * seen + 1.5 * own
            story = explain(seen, mask)
            odds = seen + trust * _expected_odds(story.mask)
        else:
            odds = seen + 0.3 * look.place + _expected_odds(story.mask)
    guide = colours[..., 0]
    full_guide = cv2.cvtColor(frame_bgr, cv2.COLOR_BGR2GRAY) if look.step > 1 else guide
    radius = max(_GUIDE_RADIUS_PX // look.step, 2)
    smooth = cv2.blur(_edge_preserving(odds, guide, full_guide, radius), (5, 5))
    # where colour alone is decisive a pixel is believed by itself, and a strand one pixel wide is kept
    sharp = float(np.clip((model.separability - _ALIKE) / (_APART - _ALIKE), 0, 1))
    if sharp:
        own = odds if look.step == 1 else cv2.resize(odds, full_guide.shape[::-1], interpolation=cv2.INTER_LINEAR)
        smooth = (1 - sharp) * smooth + sharp * own
    filament = np.where(smooth > 0, np.uint8(255), np.uint8(0))
    return Observation(filament, np.where(np.abs(smooth) < _UNSURE, np.uint8(255), np.uint8(0)))
