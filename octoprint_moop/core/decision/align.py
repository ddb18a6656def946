"""By how much the whole picture is off: the observed silhouette registered against the expected one.

A calibration that is a pixel or two off, or a camera that was nudged, displaces every contour of the print by nearly
the same amount; a print that fails does not. So a smooth displacement of the picture is fitted to the distances, along
the normal, between the contours of the expected mask and the nearest edge of the observed one (iterative closest points
with point-to-line distances, Chen and Medioni 1992; weights that make outliers of what has failed, Huber 1981). It is
affine, with a prior that calls for more evidence the further it is from none, and a halo all around is fitted beside it,
so that a segmentation that sees filament too wide moves nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from ..expected.views import box_about

MOST_PX = 6.0  # a calibration further off than this must be done again, not explained away
POINTS = 500
REACH_PX, STEP_PX = 4.0, 0.5  # how far from a contour its edge is looked for, each round
ROUNDS = 5
NOISE_PX = 0.7
PRIOR_PX = (3.0, 3.0, 1.2, 1.2, 1.2, 1.2, 1.5)  # two of offset, four of shear, turn and scale at the print's rim, halo
LEAST_POINTS, LEAST_RATIO = 40, 0.35
LINE_SEEN = 0.8  # of the edges of what is only a line, to say where it lies
WORTH_PX = 0.05  # of the contour's length: what one more pixel of offset must explain, at the coarse search


@dataclass(frozen=True)
class Alignment:
    """Where the picture shows what is expected at a pixel x: at x + offset_px + shear_px · (x − middle) / reach.

    offset_px : (right, down); shear_px : 2 x 2, row by row; middle_px, reach_px : of the print
    """

    offset_px: tuple[float, float] = (0.0, 0.0)
    shear_px: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    middle_px: tuple[float, float] = (0.0, 0.0)
    reach_px: float = 1.0

    @property
    def most_px(self) -> float:
        """By how much the print is displaced where it is most."""
        return float(np.hypot(*self.offset_px) + np.linalg.norm(self.shear_px))

    def at(self, points: np.ndarray) -> np.ndarray:
        """(N, 2): the displacement at pixels (N, 2)."""
        off_middle = (points - np.array(self.middle_px)) / self.reach_px
        return np.array(self.offset_px) + off_middle @ np.array(self.shear_px).reshape(2, 2).T

    def inverse_map(self, left: float, top: float) -> np.ndarray:
        """(2, 3) for cv2.warpAffine with WARP_INVERSE_MAP: from a crop at (left, top) of the expected mask to the picture."""
        linear = np.eye(2) + np.array(self.shear_px).reshape(2, 2) / self.reach_px
        corner = np.array([left, top], float)
        return np.column_stack([linear, corner + self.at(corner[None])[0]])

    def displaced(self, labels: np.ndarray) -> np.ndarray:
        """Where the picture shows what the labels (h, w), uint32, say is expected; 0 where it shows nothing of them."""
        size = labels.shape[::-1]
        moved = cv2.warpAffine(labels.view(np.float32), self.inverse_map(0, 0), size, flags=cv2.INTER_NEAREST)
        return moved.view(np.uint32)

    def carried(self, matrix: np.ndarray) -> Alignment:
        """The same displacements of a print that is seen elsewhere now. matrix : (3, 3), new pixels from old ones"""
        x, y = self.middle_px
        across = np.array([[x, x + self.reach_px, x], [y, y, y + self.reach_px], [1, 1, 1]])
        middle, right, down = (matrix @ across / (matrix[2] @ across))[:2].T
        reach_px = float(np.sqrt(abs(np.linalg.det([right - middle, down - middle]))))
        return replace(self, middle_px=(float(middle[0]), float(middle[1])), reach_px=max(reach_px, 1.0))

    def within(self, most_px: float) -> Alignment:
        """The same, or as much of it as displaces the print by no more than `most_px`."""
        values = np.array([*self.offset_px, *self.shear_px])
        return self._of(values * min(1.0, most_px / max(self.most_px, 1e-9)))

    def towards(self, other: Alignment, most_px: float) -> Alignment:
        """As far on the way to another one as `most_px` at the print's rim allow."""
        here = np.array([*self.offset_px, *self.shear_px])
        there = np.array([*other.offset_px, *other.shear_px]) if self.reach_px == other.reach_px else here
        step = there - here
        size = float(np.hypot(step[0], step[1]) + np.linalg.norm(step[2:]))
        return self._of(here + step * min(1.0, most_px / max(size, 1e-9)))

    def _of(self, values: np.ndarray) -> Alignment:
        right, down, a, b, c, d = (float(value) for value in values[:6])
        return replace(self, offset_px=(right, down), shear_px=(a, b, c, d))


@dataclass(frozen=True)
class Fit:
    """alignment, and how far contours still are from their edges.

    halo_px     : by how much the observed silhouette is wider all around
    residual_px : (n,) signed distances that remain, of the contour points that found an edge
    share       : of all contour points that were asked, those that found one within a pixel and a half
    """

    alignment: Alignment
    halo_px: float
    residual_px: np.ndarray
    share: float


def about(wanted: np.ndarray, left: float, top: float) -> Alignment:
    """No displacement, of a print that is seen in `wanted` (bool or uint8, (h, w)), a crop at (left, top)."""
    x, y, width, height = cv2.boundingRect(wanted.astype(np.uint8))
    return Alignment(
        middle_px=(left + x + width / 2, top + y + height / 2), reach_px=max(width, height, 8) / 2
    )  # fmt: skip


def coarse(wanted: np.ndarray, observed: np.ndarray, known: np.ndarray, reach: int) -> tuple[int, int]:
    """(right, down): the whole-pixel offset within `reach` under which most of what is seen is explained.

    wanted : (h, w) bool; observed, known : (h + 2 reach, w + 2 reach) bool, the same crop with so much more around
    Of offsets that explain about as much, the smallest.
    """
    pays = np.where(observed, np.float32(1), np.float32(-1))
    pays[~known] = 0
    score = cv2.matchTemplate(pays, wanted.astype(np.float32), cv2.TM_CCORR)
    down, right = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    edge = wanted & ~(cv2.erode(wanted.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0)
    score -= WORTH_PX * np.count_nonzero(edge) * np.hypot(right, down)
    row, column = np.unravel_index(int(np.argmax(score)), score.shape)
    return int(column) - reach, int(row) - reach


def fit(
    wanted: np.ndarray, left: int, top: int, observed: np.ndarray, known: np.ndarray, start: Alignment
) -> Fit | None:
    """The displacement under which the expected contours lie on the edges of what is observed.

    wanted : (h, w) bool, a crop at (left, top) of the whole picture; observed, known : the whole picture's, bool.
    None where too few contours find an edge to tell.
    """
    few = box_about(wanted.view(np.uint8), 8)
    left, top = left + few[1].start, top + few[0].start
    points, normals = _contours(wanted[few])
    if len(points) < LEAST_POINTS:
        return None
    points = points + [left, top]
    off_middle = (points - np.array(start.middle_px)) / start.reach_px
    # what a point moves along its normal for each unknown
    design = np.column_stack([normals, normals[:, :1] * off_middle, normals[:, 1:] * off_middle, np.ones(len(points))])
    # further off than this no edge is looked for
    margin = start.most_px + 4 * REACH_PX
    corner = np.maximum(points.min(axis=0) - margin, 0).astype(int)
    end = (points.max(axis=0) + margin).astype(int)
    near = slice(corner[1], end[1]), slice(corner[0], end[0])
    soft = cv2.GaussianBlur(observed[near].astype(np.float32), (0, 0), 0.8)
    blind = (~known[near]).astype(np.uint8)
    offsets = np.arange(-REACH_PX, REACH_PX + STEP_PX, STEP_PX)
    lines = normals[:, :, None] * offsets - corner[:, None]
    thin = _of_lines(wanted[few], points - [left, top], normals)
    values = np.array([*start.offset_px, *start.shear_px, 0.0])
    prior = NOISE_PX**2 / np.array(PRIOR_PX) ** 2
    residual, found = np.zeros(len(points)), np.zeros(len(points), bool)
    for _ in range(ROUNDS):
        here = points + start._of(values).at(points)
        along, found = _edges(soft, blind, here[:, :, None] + lines, offsets, values[6])
        # of a line that is hardly seen, what is seen tells little of where it lies
        hardly = np.count_nonzero(found & thin) < LINE_SEEN * np.count_nonzero(thin)
        asked = ~thin if hardly else np.ones_like(thin)
        found &= asked
        if np.count_nonzero(found) < max(LEAST_POINTS, LEAST_RATIO * np.count_nonzero(asked)):
            return None
        residual = along - values[6]
        weight = _biweight(residual[found])
        rows = design[found]
        hessian = rows.T @ (rows * weight[:, None]) + np.diag(prior)
        step = np.linalg.solve(hessian, rows.T @ (weight * residual[found]) - prior * values)
        values = values + step
        if np.abs(step).max() < 0.02:
            break
    residual = residual - design @ step
    share = float(np.mean((found & (np.abs(residual) < 1.5))[asked]))
    if share < LEAST_RATIO:
        return None
    return Fit(start._of(values), float(values[6]), residual[found], share)


def _contours(wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(N, 2) contour pixels, and (N, 2) the outward normals there."""
    mask = wanted.astype(np.uint8)
    lines, _ = cv2.findContours(mask, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    if not lines:
        return np.zeros((0, 2)), np.zeros((0, 2))
    points = np.concatenate([line[:, 0] for line in lines if len(line) >= 12] or [np.zeros((0, 2), int)])
    points = points[:: max(1, len(points) // POINTS)]
    height, width = mask.shape
    inside = (points > 2).all(axis=1) & (points[:, 0] < width - 3) & (points[:, 1] < height - 3)
    points = points[inside]
    smooth = cv2.GaussianBlur(mask.astype(np.float32), (0, 0), 1.5)
    slope = np.column_stack(
        [cv2.Sobel(smooth, cv2.CV_32F, *axis)[points[:, 1], points[:, 0]] for axis in ((1, 0), (0, 1))]
    )
    length = np.linalg.norm(slope, axis=1)
    sure = length > 0.3  # not where two contours meet
    normals = -slope[sure] / length[sure, None]
    # the mask's edge lies half a pixel beyond its outermost pixel's middle
    return points[sure] + 0.5 * normals, normals.astype(np.float64)


def _of_lines(mask: np.ndarray, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """(N,) bool: contour points of what is only a pixel or two wide: a skirt, or the line with which a nozzle is primed."""
    wide = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    column, row = np.round(points - 0.5 * normals).astype(int).T
    return wide[row, column] == 0


def _edges(
    soft: np.ndarray, blind: np.ndarray, lines: np.ndarray, offsets: np.ndarray, halo_px: float
) -> tuple[np.ndarray, np.ndarray]:
    """(N,) how far outwards the silhouette's edge lies from each point, the nearest to where it is thought to be; and whether
    there is one within reach.

    lines : (N, 2, n) the pixels at each of `offsets` along each point's normal
    """
    x, y = (np.ascontiguousarray(lines[:, axis], np.float32) for axis in (0, 1))
    hidden = cv2.remap(blind, x, y, cv2.INTER_NEAREST, borderValue=1).any(axis=1)
    along, found, _ = nearest_edges(soft, x, y, offsets, halo_px)
    return along, found & ~hidden


def nearest_edges(
    soft: np.ndarray, x: np.ndarray, y: np.ndarray, offsets: np.ndarray, near_px: float | np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(N,) at which of the offsets a silhouette ends on each of N lines, nearest to `near_px`, to a part of a step; (N,) bool,
    whether it does; and (N,) int, which offset comes before.

    soft : (H, W) float32, the silhouette, blurred; x, y : (N, n) float32, its pixels at each of the `offsets`, (n,) evenly
    """
    profile = cv2.remap(soft, x, y, cv2.INTER_LINEAR)
    falls = (profile[:, :-1] >= 0.5) & (profile[:, 1:] < 0.5)
    away = np.where(falls, np.abs(offsets[:-1] - np.reshape(near_px, (-1, 1))), np.inf)
    at, rows = away.argmin(axis=1), np.arange(len(away))
    before, after = profile[rows, at], profile[rows, at + 1]
    along = offsets[at] + (offsets[1] - offsets[0]) * (before - 0.5) / np.maximum(before - after, 1e-6)
    return along, np.isfinite(away[rows, at]), at


def _biweight(residual: np.ndarray) -> np.ndarray:
    """Tukey's, of a scale that is measured but never below the noise."""
    scale = max(1.4826 * float(np.median(np.abs(residual))), NOISE_PX)
    return (1 - np.clip(residual / (3.0 * scale), -1, 1) ** 2) ** 2
