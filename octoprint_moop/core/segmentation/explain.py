"""Which simple story about the expected mask the picture tells: as expected, moved, or unfinished.

An expected mask is right or wrong as a whole far more often than pixel by pixel. Its pixels together tell what none of
them can tell alone: 10000 weak pixels see a part that slid by 5 mm on a bed of its own colour. And where it ends, the
picture should have a border: black before black still has an edge that catches the light.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

_NEAR_PX = 3  # a calibrated camera, a warm bed and a slicer's bead model are together wrong by this much
_SIDE_PX = 48  # the search looks at the expected mask shrunk to about this size
_REACH_X, _REACH_Y = 0.35, 0.1  # of its size: how far a part is looked for
_CUT_MAX = 0.6  # of its height: more than this missing is not told from a picture that shows something else
_SEEN = 2.0  # evidence of filament that leaves little to doubt
_RIM_PX, _SPOT_PX = 2, 3
_CLIP = 3.0  # of the evidence, so that a lamp in the background does not outweigh the print
_BORDER_SLOPE = 4.0
_BORDER_WEIGHT = 1.2  # of the mean over the outline, against the mean evidence over the area


@dataclass(frozen=True, eq=False)
class Explanation:
    """The expected mask as the picture supports it.

    mask       : (H, W) uint8, 0 or 255
    support    : mean evidence inside `mask`, within +-3; below 0 the picture speaks against it
    moved_px   : (x, y) by which it was moved, (0, 0) if not
    missing_px : height of what is missing at its top
    """

    mask: np.ndarray
    support: float
    moved_px: tuple[int, int] = (0, 0)
    missing_px: int = 0


@dataclass(frozen=True, eq=False)
class _Field:
    """What the search looks at, small: (h, w) the expected mask's box, the pictures larger by its reach all around.

    shape, outline : (h, w) float32, 0..1 and 0 or 1
    evidence       : log-odds of filament
    border, ledge  : log-odds that an outline, or its top, runs here
    """

    shape: np.ndarray
    outline: np.ndarray
    evidence: np.ndarray
    border: np.ndarray
    ledge: np.ndarray
    near: int

    @property
    def reach(self) -> tuple[int, int]:
        """(rows, columns)"""
        height, width = self.shape.shape
        return (self.evidence.shape[0] - height) // 2, (self.evidence.shape[1] - width) // 2

    def moves(self) -> np.ndarray:
        """Score of the mask moved to each place within reach."""
        inside = cv2.matchTemplate(self.evidence, self.shape, cv2.TM_CCORR) / self.shape.sum()
        along = cv2.matchTemplate(self.border, self.outline, cv2.TM_CCORR) / self.outline.sum()
        return inside + _BORDER_WEIGHT * along

    def support(self, row: int, column: int, cut: int) -> float:
        """Mean evidence within the mask that lies at (row, column) and lacks its uppermost `cut` rows."""
        height, width = self.shape.shape
        shape = self.shape[cut:]
        within = self.evidence[row + cut : row + height, column : column + width] * shape
        return float(within.sum() / max(float(shape.sum()), 1e-6))

    def cut(self, row: int, column: int) -> tuple[float, int]:
        """The best gain of taking rows away from the top of the mask that lies at (row, column), and how many."""
        height, width = self.shape.shape
        most = int(_CUT_MAX * height)
        if most <= self.near + 1:
            return 0.0, 0
        here = np.s_[row : row + height, column : column + width]
        solid = self.shape > 0.5
        lost = np.cumsum((self.evidence[here] * self.shape).sum(axis=1)) / self.shape.sum()
        above = np.cumsum((self.border[here] * self.outline).sum(axis=1))
        above_px = np.cumsum(self.outline.sum(axis=1))
        along, along_px = above[-1] - above[:-1], above_px[-1] - above_px[:-1]
        tops = np.where(solid, self.ledge[here], 0).sum(axis=1)[1:]
        border = (along + tops) / np.maximum(along_px + solid[1:].sum(axis=1), 1) - above[-1] / above_px[-1]
        gains = (_BORDER_WEIGHT * border - lost[:-1])[self.near : most - 1]
        best = int(gains.argmax())
        return float(gains[best]), best + self.near + 1


def _border_odds(strength: np.ndarray) -> np.ndarray:
    """(H, W) float32: log-odds that an outline runs through a pixel, by its rank in strength among the pixels here.

    Along outlines of real prints the density of ranks r in 0..1 grows about as exp(4 r), in front of any background;
    the strength itself differs by camera, light and colour.
    """
    ranks = np.cumsum(np.bincount(strength.ravel(), minlength=256)) / strength.size
    density = np.log(_BORDER_SLOPE / math.expm1(_BORDER_SLOPE)) + _BORDER_SLOPE * ranks
    return cv2.LUT(strength, density.astype(np.float32))


def _strength(colours: np.ndarray, size: tuple[int, int], step: int) -> tuple[np.ndarray, np.ndarray]:
    """How much the colour changes across each pixel, uint8, in any direction and upwards; the strongest about each
    pixel of the smaller picture."""
    channels = [cv2.extractChannel(colours, number) for number in range(3)]
    across = []
    for kernel in (np.ones((1, 3), np.uint8), np.ones((3, 1), np.uint8)):
        first, second, third = (cv2.morphologyEx(channel, cv2.MORPH_GRADIENT, kernel) for channel in channels)
        across.append(cv2.add(cv2.add(first, second), third))
    side = 2 * (step // 2) + 3
    pictures = (cv2.max(*across), across[1])
    wide = (cv2.dilate(picture, np.ones((side, side), np.uint8)) for picture in pictures)
    strongest, upwards = (cv2.resize(picture, size, interpolation=cv2.INTER_NEAREST) for picture in wide)
    return strongest, upwards


def _look(
    evidence: np.ndarray, expected: np.ndarray, colours: np.ndarray, box: tuple[int, int, int, int], step: int
) -> _Field:
    """box : (x, y, w, h) of the expected mask, each a multiple of the step but for the picture's end"""
    x, y, w, h = box
    size = (math.ceil(w / step), math.ceil(h / step))
    shape = cv2.resize(expected[y : y + h, x : x + w], size, interpolation=cv2.INTER_AREA).astype(np.float32) / 255
    solid = cv2.copyMakeBorder((shape > 0.5).astype(np.uint8), 1, 1, 1, 1, cv2.BORDER_CONSTANT)
    outline = (solid - cv2.erode(solid, np.ones((3, 3), np.uint8)))[1:-1, 1:-1].astype(np.float32)
    near = math.ceil(_NEAR_PX / step)
    reach_x, reach_y = (
        max(math.ceil(share * length), near + 1) for share, length in zip((_REACH_X, _REACH_Y), size)
    )  # fmt: skip
    left, top = x - reach_x * step, y - reach_y * step
    wide = (size[0] + 2 * reach_x, size[1] + 2 * reach_y)
    right, bottom = left + wide[0] * step, top + wide[1] * step
    height, width = expected.shape
    beyond = (max(-top, 0), max(bottom - height, 0), max(-left, 0), max(right - width, 0))

    def around(picture: np.ndarray) -> np.ndarray:
        part = picture[max(top, 0) : max(bottom, 0), max(left, 0) : max(right, 0)]
        return cv2.copyMakeBorder(part, *beyond, cv2.BORDER_REPLICATE) if any(beyond) else part

    small = cv2.resize(np.clip(around(evidence), -_CLIP, _CLIP), wide, interpolation=cv2.INTER_AREA)
    border, ledge = (_border_odds(picture) for picture in _strength(around(colours), wide, step))
    return _Field(shape, outline, small, border, ledge, near)


def _all_seen(evidence: np.ndarray, expected: np.ndarray) -> bool:
    """Whether no spot of the mask, but for its rim, lacks evidence of filament: then nothing is left to be explained."""
    inside = cv2.erode(expected, np.ones((2 * _RIM_PX + 1,) * 2, np.uint8))
    unseen = cv2.bitwise_and(inside, (evidence <= _SEEN).view(np.uint8))
    return not cv2.erode(unseen, np.ones((_SPOT_PX,) * 2, np.uint8)).any()


def explain(evidence: np.ndarray, expected: np.ndarray, colours: np.ndarray) -> Explanation:
    """The story with the most evidence for it: as expected, moved, unfinished, or moved and unfinished.

    evidence : (H, W) float32, log likelihood ratios of filament
    expected : (H, W) uint8, 0 or 255
    colours  : (H, W, 3) uint8, the picture, its borders
    Any story but "as expected" must earn more than a few pixels of luck would give it.
    """
    area_px = cv2.countNonZero(expected)
    if not area_px:
        return Explanation(expected, 0.0)
    x, y, w, h = cv2.boundingRect(expected)
    within = np.s_[y : y + h, x : x + w]
    if _all_seen(evidence[within], expected[within]):
        return Explanation(expected, min(cv2.mean(evidence[within], mask=expected[within])[0], _CLIP))
    step = max(1, int(np.sqrt(w * h) / _SIDE_PX))
    top, left = y // step * step, x // step * step
    field = _look(evidence, expected, colours, (left, top, x + w - left, y + h - top), step)
    reach_y, reach_x = field.reach
    scores = field.moves()

    def best(allowed: np.ndarray) -> tuple[float, int, int]:
        row, column = np.unravel_index(np.where(allowed, scores, -np.inf).argmax(), scores.shape)
        return float(scores[row, column]), int(row), int(column)

    rows, columns = np.ogrid[: scores.shape[0], : scores.shape[1]]
    close = (abs(rows - reach_y) <= field.near) & (abs(columns - reach_x) <= field.near)
    there, row, column = best(close)
    away, far_row, far_column = best(~close)
    # What luck gives falls with the number of independent pixels
    price_move, price_cut = 0.01 + 6 / np.sqrt(area_px), 0.01 + 2 / np.sqrt(area_px)
    stories = [(there, 0, 0, 0)]
    gain, cut = field.cut(row, column)
    if gain > price_cut:
        stories.append((there + gain - price_cut, 0, 0, cut))
    if away - there > price_move:
        move = (far_column - reach_x, far_row - reach_y)
        stories.append((away - price_move, *move, 0))
        gain, cut = field.cut(far_row, far_column)
        if gain > price_cut:
            stories.append((away + gain - price_move - price_cut, *move, cut))
    _, move_x, move_y, cut = max(stories)
    mask = expected
    if cut:
        mask = mask.copy()
        mask[: top + cut * step] = 0
    if move_x or move_y:
        shift = np.array([[1, 0, move_x * step], [0, 1, move_y * step]], np.float32)
        mask = cv2.warpAffine(mask, shift, mask.shape[::-1], flags=cv2.INTER_NEAREST)
    support = field.support(reach_y + move_y, reach_x + move_x, cut)
    return Explanation(mask, support, (move_x * step, move_y * step), cut * step)
