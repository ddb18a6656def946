"""Which pixels are filament, of any colour and in most light: what is known of this print, weighed pixel by pixel.

Evidence (appearance.py) says how much a pixel looks like filament. What is expected (explain.py) says where filament
should be: as a whole it may be as expected, moved, or unfinished, and only the story that the picture supports is
believed, more so near its edges than beyond. A guided filter (He et al. 2010) then smooths the sum along the picture's
own edges, so that noise goes and thin walls stay.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from .appearance import EVIDENCE_MAX, ColourModel, Plate, count_colours, evidence, opponent
from .explain import explain
from .reach import Reach
from .segment import Observation

# Pixels in the region beyond which the work is done at a half, a third, … of the size
WORK_PX, WORK_SHARP_PX = 80_000, 310_000

_EXPECTED_WEIGHT = 3.0  # log-odds given to the believed story well inside and well outside of it
_BEHIND_WEIGHT = 1.0  # inside, where a head may stand before it
_EDGE_PX = 2  # the story's edge is this uncertain: the weight grows from 0 to full over it
_WRONG_LOOK = -0.3  # support below which the learned colours are not what is seen in this frame
_ALIKE, _APART = 0.7, 0.82  # separability: below, only neighbours together decide; above, each pixel by itself
# Evidence, after smoothing, that says neither: by the separability, since a chance difference of two alike says little
_UNSURE = ((0.1, 0.4), (1.0, 0.25))
_SOME = 1e-9  # more than nothing
_GUIDE_RADIUS_PX, _GUIDE_NOISE = 8, 0.01
_SAME_LIGHT = 0.02
_CONTRAST = (0.2, 0.45)  # of a frame's own colours: below, nothing is there; above, something is


@dataclass(frozen=True, eq=False)
class Look:
    """Everything about a region that does not depend on the frame, at the size at which the work is done.

    plate      : what the pixels are known to have shown, None where nothing is known
    place      : (H, W) float32, log-odds that filament is there before looking; None where nothing is known
    underneath : (H, W) float32, log-odds (0 or less) under the print: what is seen there is its mirror image; or None
    step       : the region's size over the work's size
    """

    plate: Plate | None
    place: np.ndarray | None
    underneath: np.ndarray | None
    step: int

    @classmethod
    def without_label(cls, plate: Plate | None, shape: tuple[int, int], model: ColourModel) -> Look:
        """Nothing is known about where filament is."""
        step = _step(shape, model)
        return cls(None if plate is None else plate.shrunk(step), None, None, step)


def _step(shape: tuple[int, int], model: ColourModel) -> int:
    """Where neighbours decide together anyway, little is lost at a smaller size."""
    most_px = WORK_SHARP_PX if _sharpness(model) > 0.5 else WORK_PX
    return math.ceil(math.sqrt(shape[0] * shape[1] / most_px))


def _sharpness(model: ColourModel) -> float:
    """0..1: by how much a pixel is believed by itself; so a strand one pixel wide is kept where colour is decisive."""
    return float(np.clip((model.separability - _ALIKE) / (_APART - _ALIKE), 0, 1))


def _work_shape(shape: tuple[int, int], step: int) -> tuple[int, int]:
    return (max(shape[0] // step, 1), max(shape[1] // step, 1))


def _at_work_size(picture: np.ndarray, step: int) -> np.ndarray:
    if step == 1:
        return picture
    height, width = _work_shape(picture.shape[:2], step)
    return cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA)


def _mask_at_work_size(mask: np.ndarray, step: int) -> np.ndarray:
    return mask if step == 1 else cv2.threshold(_at_work_size(mask, step), 127, 255, cv2.THRESH_BINARY)[1]


def _as_mask(where: np.ndarray) -> np.ndarray:
    """uint8, 0 or 255, of bool."""
    return where.view(np.uint8) * np.uint8(255)


def _along_edges(values: np.ndarray, guide: np.ndarray) -> np.ndarray:
    """(H, W) float32: the guided filter of float32 `values` by the uint8 `guide`, worked at half the size."""
    height, width = values.shape
    half = ((width + 1) // 2, (height + 1) // 2)
    coarse = cv2.resize(values, half, interpolation=cv2.INTER_AREA)
    light = cv2.resize(guide, half, interpolation=cv2.INTER_AREA).astype(np.float32) * np.float32(1 / 255)
    window = (_GUIDE_RADIUS_PX + 1, _GUIDE_RADIUS_PX + 1)
    mean_light, mean = cv2.blur(light, window), cv2.blur(coarse, window)
    variance = cv2.blur(light * light, window) - mean_light * mean_light
    slope = (cv2.blur(light * coarse, window) - mean_light * mean) / (variance + np.float32(_GUIDE_NOISE))
    offset = cv2.blur(mean - slope * mean_light, window)
    slope = cv2.blur(slope, window) * np.float32(1 / 255)
    size = (width, height)
    slope = cv2.resize(slope, size, interpolation=cv2.INTER_LINEAR)
    return cv2.blur(slope * guide + cv2.resize(offset, size, interpolation=cv2.INTER_LINEAR), (5, 5))


def _odds_table() -> np.ndarray:
    """(256,) float32: log-odds by the mean of a pixel's own mask value and the mask's mean about it."""
    level = np.linspace(-1, 1, 256)  # the sign is the pixel's own, so that a strand one pixel wide keeps its odds
    steep = np.clip(2 * level - np.sign(level), -1, 1)
    return (_EXPECTED_WEIGHT * np.sign(level) * np.maximum(steep * np.sign(level), 0.25)).astype(np.float32)


_ODDS = _odds_table()


def _expected_odds(mask: np.ndarray, near: np.ndarray | None = None) -> np.ndarray:
    """(H, W) float32: log-odds of filament where a mask is believed, growing from its edge inwards and outwards.

    near : (H, W) bool, where a head may hide what is there; None for nowhere
    """
    side = 2 * _EDGE_PX + 1
    odds = cv2.LUT(cv2.addWeighted(mask, 0.5, cv2.blur(mask, (side, side)), 0.5, 0), _ODDS)
    if near is not None:
        odds[near] = np.minimum(odds[near], _BEHIND_WEIGHT)
    return odds


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


def look_of_label(frame_bgr: np.ndarray, label: np.ndarray, model: ColourModel) -> Look:
    """What a labelled picture tells about every later one: the plate, and where filament probably is."""
    step = _step(label.shape, model)
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
    frame_bgr: np.ndarray,
    model: ColourModel,
    look: Look,
    expected: np.ndarray | None = None,
    gain: np.ndarray | None = None,
    reach: Reach | None = None,
) -> Observation:
    """The region's pixels that are filament, and those on which neither is said.

    frame_bgr : (H, W, 3) uint8, the region of a frame
    expected  : (H, W) uint8, what should be there, right or wrong
    gain      : (3,) by what to multiply the channels, so that the light is that of the plate
    reach     : of the region: where a head may stand, so that what should be there may be hidden; None for nowhere
    """
    small = _at_work_size(frame_bgr, look.step)
    if gain is not None and np.abs(gain - 1).max() > _SAME_LIGHT:
        small = cv2.LUT(small, np.clip(np.arange(256)[:, None] * gain + 0.5, 0, 255).astype(np.uint8)[None])
    colours = opponent(small)
    sharp = _sharpness(model)
    # an unchanged bed is the bed, whatever its colour; that it has changed says little where colour says so much
    seen = evidence(colours, model, look.plate, change=1 - sharp)
    near = None if reach is None else _mask_at_work_size(reach.where, look.step) > 0
    if reach is not None and near is not None:
        seen = np.where(near, evidence(colours, reach.model, look.plate, change=1 - sharp), seen)
    if expected is None:
        odds = seen.copy() if look.place is None else seen + look.place
        if look.plate is not None and (look.plate.known > 0).any():
            label = look.plate.known > 0
            rows = _top_odds(seen, label)
            odds += np.where(label, rows, np.minimum(rows, 0))
    else:
        mask = _mask_at_work_size(expected, look.step)
        told = seen if look.underneath is None else seen + look.underneath
        # a print that is hidden has neither moved nor ended
        story = explain(told if near is None else np.where(near, np.float32(0), told), mask, colours)
        if story.support < _WRONG_LOOK:
            own, contrast = _own_colours(colours, mask if near is None else mask * ~near)
            # what looks like everything around it is not there
            trust = float(np.interp(contrast, _CONTRAST, (0, 1)))
            mixed = (1 - 0.75 * trust) * seen + 1.5 * own
            # the bed that is seen unchanged stays the bed
            seen = mixed if look.plate is None else np.where(look.plate.known < 0, seen, mixed)
            story = explain(seen, mask, colours)
            odds = seen + trust * _expected_odds(story.mask, near)
        else:
            odds = cv2.add(seen, _expected_odds(story.mask, near))
            if look.place is not None:
                odds = odds + 0.3 * look.place
    if sharp < 1:
        odds = cv2.addWeighted(_along_edges(odds, colours[..., 0]), 1 - sharp, odds, sharp, 0)
    says = cv2.blur(seen, (3, 3))
    unsure: float | np.ndarray = float(np.interp(model.separability, *_UNSURE))
    if reach is not None:
        unsure = np.where(reach.where > 0, np.interp(reach.model.separability, *_UNSURE), unsure)
    if look.step > 1:
        size = frame_bgr.shape[1::-1]
        odds = cv2.resize(odds, size, interpolation=cv2.INTER_LINEAR)
        says = cv2.resize(says, size, interpolation=cv2.INTER_LINEAR)
    return Observation(_as_mask(odds > _SOME), _as_mask((says >= -unsure) & (says <= unsure)))
