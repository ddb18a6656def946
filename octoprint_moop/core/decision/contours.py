"""Where the contour of what stands is seen, against where it was seen while all was well.

The band about expected edges tells nothing of one pixel. Of a stretch of contour it does: noise moves points of it hither
and thither, a corner that rises moves all of them the same way. So each contour pixel keeps how far off its edge was
seen, along the normal, and points that have come inwards since count where they hang together and agree.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from .align import nearest_edges
from .spots import Window, about

REACH_PX, STEP_PX = 5.0, 0.5  # how far to either side of a contour its edge is looked for
RIM_PX = 8  # nothing is asked so near to the window's rim
CHORD = 3  # contour pixels to either side that tell which way is out
LEAST_CHAIN, LEAST_POINTS, LEAST_LOOKS = 12, 20, 2
THICK_PX = 4.0  # what is thinner is seen or not as the light falls
NEWEST, DOUBTFUL = 0.12, 0.25  # weight of the newest look, and how much less of it where the contour has come inwards
MOST_STEP_PX, DOUBTFUL_PX = 1.0, 0.5
SUNK_PX, LEAST_SUNK = 1.0, 6
AGREE_RATIO = 0.6  # of what has moved along a stretch, times the share of the stretch that has
JOINED_PX = 5
BESIDE_PX, SHADE = 4.0, 9.0  # grey levels by which it has become darker where a shadow falls
JUST_PX, MATTER = 2.0, 18.0  # just outside of an edge; grey levels by which it looks less like the bed than elsewhere
PRIOR, OUTLIER_PX, ROUNDS = 5.0, 2.0, 3


class Contours:
    """Of one view of one print. Windows are rows and columns of the expected mask, masks are cut to them and laid upon it."""

    def __init__(self, shape: tuple[int, int]) -> None:
        self._edge_px = np.zeros(shape, np.float32)
        self._beside = np.zeros(shape, np.float32)  # grey levels of what is beside it
        self._looks = np.zeros(shape, np.uint8)

    def learn(self, window: Window, wanted: np.ndarray, look: np.ndarray, seen: np.ndarray, known: np.ndarray) -> None:
        """Take in where a good check shows the edges. look : (3, h, w) uint8; wanted, seen, known : (h, w) bool"""
        points = _Points.of(wanted)
        edge_px, beside, looks = self._edge_px[window], self._beside[window], self._looks[window]
        at = points.row, points.column
        now_px, found = points.edges(seen, known, edge_px[at])
        at = points.row[found], points.column[found]
        step_px = np.clip(now_px[found] - edge_px[at], -MOST_STEP_PX, MOST_STEP_PX)
        weight = np.maximum(NEWEST, 1 / (looks[at] + 1.0)) * np.where(step_px < -DOUBTFUL_PX, DOUBTFUL, 1.0)
        first = looks[at] == 0
        edge_px[at] += np.where(first, now_px[found] - edge_px[at], weight * step_px)
        beside[at] += np.where(first, 1.0, weight) * (points[found].beside(look) - beside[at])
        looks[at] = np.minimum(looks[at], 254) + 1

    def sunk(
        self, window: Window, wanted: np.ndarray, look: np.ndarray, seen: np.ndarray, known: np.ndarray,
        unlike_bed: Callable[[], np.ndarray],
    ) -> np.ndarray:  # fmt: skip
        """(h, w) bool: contour pixels from which the edge has come inwards by more than a pixel, with their neighbours and the
        way they have. look : (3, h, w) uint8; wanted, seen, known : (h, w) bool; unlike_bed : gives (h, w) uint8, by how
        many grey levels a pixel looks unlike the bare bed, 0 where that is not known

        By what all contours have moved, and have grown or shrunk, is no part of it: that is camera or light. Nor is what has
        become darker on both sides, since a shadow falls there, nor what looks less like the bed than what lies as near to
        the edges elsewhere: that is matter in shade.
        """
        sunk = np.zeros(wanted.shape, bool)
        points = _Points.of(wanted)
        points = points[self._looks[window][points.row, points.column] >= LEAST_LOOKS]
        bare = points.inwards(1.0)
        if np.count_nonzero(known[bare] & ~seen[bare]) < LEAST_SUNK:
            return sunk
        was_px = self._edge_px[window][points.row, points.column]
        now_px, found = points.edges(seen, known, was_px)
        if np.count_nonzero(found) < LEAST_POINTS:
            return sunk
        points, now_px, moved_px = points[found], now_px[found], (now_px - was_px)[found]
        moved_px = moved_px - np.median(moved_px)
        moved_px -= points.normal @ _common(points.normal, moved_px)
        come = moved_px < -SUNK_PX
        come &= points.beside(look) > self._beside[window][points.row, points.column] - SHADE
        if np.count_nonzero(come) < LEAST_SUNK:
            return sunk
        unlike = unlike_bed()[points.inwards(-np.maximum(now_px, -REACH_PX) - JUST_PX)].astype(np.float32)
        if not come.all():
            come &= unlike <= np.percentile(unlike[~come], 75) + MATTER
        if np.count_nonzero(come) < LEAST_SUNK:
            return sunk
        sunk[points.row[come], points.column[come]] = True
        few = about(sunk)
        _, labels = cv2.connectedComponents(cv2.dilate(sunk.view(np.uint8), np.ones((JOINED_PX,) * 2, np.uint8)))
        stretch = labels[points.row, points.column]
        sunk[few] = False
        for number in np.unique(stretch[come]):
            here = stretch == number
            gone = here & come
            share = np.count_nonzero(gone) / np.count_nonzero(here)
            if (
                np.count_nonzero(gone) >= LEAST_SUNK
                and share * _agreed(points.normal[gone], moved_px[gone]) > AGREE_RATIO
            ):
                sunk[points.row[gone], points.column[gone]] = True
        return sunk

    def carried(self, matrix: np.ndarray, shape: tuple[int, int]) -> None:
        """What a pixel showed is now seen elsewhere. matrix : (3, 3), new pixels from old ones; shape : of the new pictures"""

        def warp(picture: np.ndarray) -> np.ndarray:
            return cv2.warpPerspective(picture, matrix, shape[::-1], flags=cv2.INTER_NEAREST)

        self._edge_px, self._beside, self._looks = warp(self._edge_px), warp(self._beside), warp(self._looks)

    def forget(self) -> None:
        """From now on the contours are where they are seen next."""
        self._looks[:] = 0


@dataclass(frozen=True, eq=False)
class _Points:
    """Contour pixels, (N,) int, and the unit normals outwards there, (N, 2) right and down."""

    row: np.ndarray
    column: np.ndarray
    normal: np.ndarray

    @classmethod
    def of(cls, wanted: np.ndarray) -> _Points:
        """Of all bodies of the mask (bool) that are not thin there."""
        height, width = wanted.shape
        lines, _ = cv2.findContours(wanted.view(np.uint8), cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
        chains = [line[:, 0] for line in lines if len(line) >= LEAST_CHAIN]
        if not chains:
            return cls(np.zeros(0, int), np.zeros(0, int), np.zeros((0, 2)))
        pixels = np.concatenate(chains)
        chords = np.concatenate([np.roll(chain, -CHORD, axis=0) - np.roll(chain, CHORD, axis=0) for chain in chains])
        length = np.hypot(*chords.T.astype(float))
        normal = np.column_stack([-chords[:, 1], chords[:, 0]]) / np.maximum(length, 1e-6)[:, None]
        inside = (pixels > RIM_PX).all(axis=1) & (pixels < np.array([width, height]) - 1 - RIM_PX).all(axis=1)
        sure = inside & (length > CHORD)  # not where a contour turns back
        points = cls(pixels[sure, 1], pixels[sure, 0], normal[sure])
        return points[wanted[points.inwards(THICK_PX)] & ~wanted[points.inwards(-2.0)]]

    def __getitem__(self, which: np.ndarray) -> _Points:
        return _Points(self.row[which], self.column[which], self.normal[which])

    def inwards(self, by_px: float | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rows and columns of the pixels so far within the contour. by_px : a number, or (N,)"""
        right, down = np.rint(np.reshape(by_px, (-1, 1)) * self.normal).astype(int).T
        return self.row - down, self.column - right

    def beside(self, look: np.ndarray) -> np.ndarray:
        """(N,) grey levels a little way outside."""
        rows, columns = self.inwards(-BESIDE_PX)
        return look[:, rows, columns].mean(axis=0)

    def edges(self, seen: np.ndarray, known: np.ndarray, near_px: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(N,) how far outwards what is seen ends, nearest to `near_px`, (N,); and where it is found, bool."""
        offsets = np.arange(-REACH_PX, REACH_PX + STEP_PX, STEP_PX)
        x, y = (
            (at[:, None] + way[:, None] * (offsets + 0.5)).astype(np.float32)
            for at, way in ((self.column, self.normal[:, 0]), (self.row, self.normal[:, 1]))
        )
        if not len(x):
            return np.zeros(0), np.zeros(0, bool)
        soft = cv2.GaussianBlur(seen.astype(np.float32), (0, 0), 0.8)
        edge_px, found, at = nearest_edges(soft, x, y, offsets, near_px)
        told = known[tuple(np.rint(axis[np.arange(len(at)), at]).astype(int) for axis in (y, x))]
        return edge_px, found & told


def _common(normals: np.ndarray, moved_px: np.ndarray) -> np.ndarray:
    """(2,) by how much most of a contour has been displaced; Tukey's weights make outliers of what has failed."""
    offset_px = np.zeros(2)
    for _ in range(ROUNDS):
        weight = (1 - np.clip((moved_px - normals @ offset_px) / OUTLIER_PX, -1, 1) ** 2) ** 2
        offset_px = np.linalg.solve(
            normals.T @ (normals * weight[:, None]) + PRIOR * np.eye(2), normals.T @ (weight * moved_px)
        )
    return offset_px


def _agreed(normals: np.ndarray, moved_px: np.ndarray) -> float:
    """Of what a stretch has moved, in squares, how much a displacement of all of it in one direction explains."""
    offset_px = np.linalg.solve(normals.T @ normals + np.eye(2), normals.T @ moved_px)
    return 1 - float(np.sum((moved_px - normals @ offset_px) ** 2) / np.sum(moved_px**2))
