"""Which simple story about the expected mask the picture tells: as expected, moved, or unfinished.

An expected mask is right or wrong as a whole far more often than pixel by pixel. Its pixels together tell what none of
them can tell alone: 10000 weak pixels see a part that slid by 5 mm on a bed of its own colour.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

_NEAR_PX = 3  # a calibrated camera, a warm bed and a slicer's bead model are together wrong by this much
_SIDE_PX = 48  # the search looks at the expected mask shrunk to about this size
_REACH_X, _REACH_Y = 0.35, 0.1  # of its size: how far a part is looked for
_CUT_MAX = 0.6  # of its height: more than this missing is not told from a picture that shows something else
_CLIP = 3.0  # of the evidence, so that a lamp in the background does not outweigh the print


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


def _moved(mask: np.ndarray, x_px: int, y_px: int) -> np.ndarray:
    shift = np.array([[1, 0, x_px], [0, 1, y_px]], np.float32)
    return cv2.warpAffine(mask, shift, (mask.shape[1], mask.shape[0]), flags=cv2.INTER_NEAREST)


def _cut(gains: np.ndarray, tolerance: int) -> tuple[float, int]:
    """The best gain, and the rows to take away for it, more than the tolerance and no more than _CUT_MAX of all."""
    most = int(_CUT_MAX * len(gains))
    if most <= tolerance:
        return 0.0, 0
    rows = int(gains[tolerance:most].argmax()) + tolerance
    return float(gains[rows]), rows + 1


def explain(evidence: np.ndarray, expected: np.ndarray) -> Explanation:
    """The story with the most evidence for it: as expected, moved, unfinished, or moved and unfinished.

    evidence : (H, W) float32, log likelihood ratios of filament
    expected : (H, W) uint8, 0 or 255
    Any story but "as expected" must earn more than a few pixels of luck would give it.
    """
    area_px = cv2.countNonZero(expected)
    if not area_px:
        return Explanation(expected, 0.0)
    height, width = evidence.shape
    _, _, box_w, box_h = cv2.boundingRect(expected)
    step = max(1, int(np.sqrt(box_w * box_h) / _SIDE_PX))
    size = (max(width // step, 1), max(height // step, 1))
    small = cv2.resize(np.clip(evidence, -_CLIP, _CLIP), size, interpolation=cv2.INTER_AREA)
    shape = cv2.resize(expected, size, interpolation=cv2.INTER_AREA)
    x, y, w, h = cv2.boundingRect(shape)
    shape = shape[y : y + h, x : x + w].astype(np.float32) / 255
    area = max(float(shape.sum()), 1e-6)
    near = int(np.ceil(_NEAR_PX / step))
    reach_x, reach_y = max(int(np.ceil(_REACH_X * w)), near + 1), max(int(np.ceil(_REACH_Y * h)), near + 1)
    field = cv2.copyMakeBorder(small, reach_y, reach_y, reach_x, reach_x, cv2.BORDER_REPLICATE)
    field = field[y : y + h + 2 * reach_y, x : x + w + 2 * reach_x]
    scores = cv2.matchTemplate(field, shape, cv2.TM_CCORR) / area

    def best(allowed: np.ndarray) -> tuple[float, int, int]:
        row, column = np.unravel_index(np.where(allowed, scores, -np.inf).argmax(), scores.shape)
        return float(scores[row, column]), int(row), int(column)

    def missing(row: int, column: int) -> tuple[float, int]:
        lost = (field[row : row + h, column : column + w] * shape).sum(axis=1) / area
        return _cut(-np.cumsum(lost), near)

    rows, columns = np.ogrid[: scores.shape[0], : scores.shape[1]]
    close = (abs(rows - reach_y) <= near) & (abs(columns - reach_x) <= near)
    there, row, column = best(close)
    away, far_row, far_column = best(~close)
    # What luck gives falls with the number of independent pixels
    price_move, price_cut = 0.01 + 6 / np.sqrt(area_px), 0.01 + 2 / np.sqrt(area_px)
    stories = [(there, 0, 0, 0)]
    gain, cut = missing(row, column)
    if gain > price_cut:
        stories.append((there + gain - price_cut, 0, 0, cut))
    if away - there > price_move:
        move = (far_column - reach_x, far_row - reach_y)
        stories.append((away - price_move, *move, 0))
        gain, cut = missing(far_row, far_column)
        if gain > price_cut:
            stories.append((away + gain - price_move - price_cut, *move, cut))
    _, move_x, move_y, cut = max(stories)
    mask = expected
    if cut:
        mask = mask.copy()
        mask[: (y + cut) * step] = 0
    if move_x or move_y:
        mask = _moved(mask, move_x * step, move_y * step)
    inside = evidence[mask > 0]
    support = float(np.clip(inside, -_CLIP, _CLIP).mean()) if inside.size else 0.0
    return Explanation(mask, support, (move_x * step, move_y * step), cut * step)
