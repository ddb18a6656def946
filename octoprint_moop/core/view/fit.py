"""How well one frame fits the reference's landmarks for any turn of the camera, and which turn near one fits better.

Differences are counted in variances of each landmark, up to a limit: the negative logarithm of a likelihood with
outliers. A frame's contrast is nobody's fault: it is estimated with each turn, since what lies beside a landmark has
less structure than the landmark, and a contrast estimated in the wrong place would make the right one fit badly.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import cv2
import numpy as np

from ..camera import Camera
from .belief import Gain
from .glance import Glance, shrunk
from .landmarks import Aim, Level, Relief, in_level

SCALES = (4, 2, 1)  # of the image pyramid, coarse to fine, against the finest: about 320 pixels across
FINEST = len(SCALES) - 1
SMALL_PX = 480  # pictures no wider are not looked at in smaller
MOST_LOSS = 9.0  # of a pixel, in variances
LEAST_CONTRAST = 0.2
STRONG = 2 * MOST_LOSS  # variances: a landmark of which nothing is seen fits as badly as any
MEDIAN, CONTRASTS = 0.5, np.array([1.0, 1.3, 1.7, 2.2, 3.0])  # times what the median of them tells
ALIGN_POINTS, LEAST_POINTS = 700, 30  # of a level
ITERATIONS, ENOUGH_PX = 12, 0.03  # px of the level
FINEST_EDGE_PX = 0.25  # px of the level: no pixel tells its place better
REACH_PX = 40.0  # at 640 pixels across: a turn by more calls for much evidence

ALL = slice(None)


class Pyramid:
    """The reliefs of a frame at each of SCALES, each made when it is asked for."""

    def __init__(self, glance: Glance) -> None:
        width_px = glance.at(1).shape[1]
        self._finest = 1 if width_px <= SMALL_PX else 2 * glance.finer
        self._greys = [cv2.cvtColor(glance.at(self._finest), cv2.COLOR_BGR2GRAY)]
        self._reliefs: dict[int, Relief] = {}
        for _ in SCALES[1:]:
            self._greys.insert(0, shrunk(self._greys[0], 2))

    def __getitem__(self, number: int) -> Relief:
        if number not in self._reliefs:
            self._reliefs[number] = Relief.of(self._greys[number])
        return self._reliefs[number]

    def grey(self, number: int) -> np.ndarray:
        return self._greys[number]

    def scale(self, number: int) -> int:
        """How many pixels of the frame one of this level is wide."""
        return SCALES[number] * self._finest


def contrast_of(seen: np.ndarray, height: np.ndarray, apart: np.ndarray) -> np.ndarray:
    """(...): by how much the contrast of landmarks seen as (..., n) differs from the reference's: a dimmed lamp is not motion.

    height, apart : (n,), of the landmarks. Only those tell it of which something must be seen. Something plain before many
    of them leaves too little contrast, something with edges too much, so what lies about it is tried as well.
    """
    if not seen.shape[-1]:
        return np.ones(seen.shape[:-1])
    strong = height**2 > STRONG * apart
    at, tried = 0.5, np.ones(1)
    if np.count_nonzero(strong) >= LEAST_POINTS:
        seen, height, apart, at, tried = seen[..., strong], height[strong], apart[strong], MEDIAN, CONTRASTS
    ratio = _quantile(np.abs(seen), at) / np.maximum(_quantile(np.abs(height), at), 1e-6)
    contrast = np.clip(ratio * np.reshape(tried, (-1, *(1,) * ratio.ndim)), LEAST_CONTRAST, 1 / LEAST_CONTRAST)
    loss = np.minimum((seen / contrast[..., None] - height) ** 2 / apart, MOST_LOSS).sum(axis=-1)
    return np.take_along_axis(contrast, loss.argmin(axis=0)[None], 0)[0]


def _quantile(values: np.ndarray, at: float) -> np.ndarray:
    """(...): of (..., n), without the care that numpy takes between two of them."""
    number = int(at * (values.shape[-1] - 1))
    return np.partition(values, number, axis=-1)[..., number]


class Fit:
    """One frame against the landmarks of `levels`. Turns are rotation vectors, as CameraTurn has them."""

    def __init__(self, camera: Camera, levels: Sequence[Level], aim: Aim, pyramid: Pyramid, px: float) -> None:
        """px : how many pixels of the frame are one at 640 across"""
        self._camera, self._levels, self._aim, self._pyramid = camera, levels, aim, pyramid
        self.px = px

    @cached_property
    def _telling(self) -> list[np.ndarray]:
        return [np.flatnonzero(level.telling) for level in self._levels]

    def apart_px(self, one: np.ndarray, other: np.ndarray) -> float:
        """About how far two turns move a pixel apart, pixels at 640 across; quicker told than `Turns.apart_px`."""
        return float(np.linalg.norm(one - other)) * float(self._camera.K[0, 0]) / self.px

    def telling(self, number: int) -> np.ndarray:
        """(n,) int: the level's landmarks that tell."""
        return self._telling[number]

    def turned_by(self, right_px: float, down_px: float, roll_px: float = 0.0) -> np.ndarray:
        """(3,) the rotation vector that moves the picture's middle by so much, and its left and right rims about it by
        roll_px, pixels at 640 across."""
        roll = roll_px * self.px / (self._camera.image_size_px[0] / 2)
        return np.array([-down_px * self.px / self._camera.K[1, 1], right_px * self.px / self._camera.K[0, 0], roll])

    def seen(self, number: int, rvec: np.ndarray, which: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Of the landmarks `which`, by how much more they show than the reference, and whether each is in the picture."""
        level = self._levels[number]
        pixels = in_level(self._camera.turned(rvec).project(self._aim.rays(number)[which]), level.scale)
        seen, inside = self._pyramid[number].at(pixels)
        height, apart = level.height[which], level.apart[which]
        return seen / contrast_of(seen[inside], height[inside], apart[inside]) - height, inside

    def losses(self, rvec: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(n,) how badly each telling landmark fits, up to MOST_LOSS, and half of that where it is out of the picture; and
        (n,) bool, whether it is in."""
        losses, insides = [], []
        for number, which in enumerate(self._telling):
            residual, inside = self.seen(number, rvec, which)
            loss = np.minimum(residual**2 / self._levels[number].apart[which], MOST_LOSS)
            losses.append(np.where(inside, loss, MOST_LOSS / 2))
            insides.append(inside)
        return np.concatenate(losses), np.concatenate(insides)

    def gain(self, before: np.ndarray, now: np.ndarray) -> Gain:
        """What the second of two turns gains against the first, by the landmarks that both have in the picture."""
        (old, seen_before), (new, seen_now) = self.losses(before), self.losses(now)
        region = np.concatenate([level.region[which] for level, which in zip(self._levels, self._telling)])
        both = seen_before & seen_now
        return Gain.of(region[both], old[both], new[both])

    def loss(self, rvec: np.ndarray) -> float:
        """The mean of `losses`."""
        losses, _ = self.losses(rvec)
        return float(losses.mean()) if len(losses) else MOST_LOSS

    def mean_losses(self, number: int, rvecs: np.ndarray, points: int) -> np.ndarray:
        """(n,) for rvecs (n, 3): the mean loss of about so many telling landmarks of one level."""
        level, which = self._levels[number], self._telling[number]
        which = which[:: max(1, len(which) // points)]
        if not len(which):
            return np.zeros(len(rvecs))
        turned = self._aim.rays(number)[which] @ _rotations(rvecs).transpose(0, 2, 1)
        pixels = in_level(self._camera.turned(np.zeros(3)).project(turned), level.scale).reshape(
            len(rvecs), len(which), 2
        )
        seen, inside = self._pyramid[number].at(pixels)
        height, apart = level.height[which], level.apart[which]
        residual = seen / contrast_of(seen, height, apart)[:, None] - height
        loss = np.minimum(residual**2 / apart, MOST_LOSS)
        return np.where(inside, loss, MOST_LOSS / 2).mean(axis=1)

    def aligned(self, rvec: np.ndarray, part: slice = ALL) -> np.ndarray:
        """(3,) Gauss-Newton from `rvec`, coarse to fine, on how far each landmark's edge has moved along its normal."""
        for number in range(len(self._levels))[part]:
            which = self._telling[number]
            which = which[:: max(1, len(which) // ALIGN_POINTS)]
            if len(which) < LEAST_POINTS:
                continue
            for _ in range(ITERATIONS):
                residual, inside = self.seen(number, rvec, which)
                step, _ = self.step(number, residual[inside], which[inside])
                rvec = rvec + step
                if np.linalg.norm(step) * self._camera.K[0, 0] < ENOUGH_PX * self._levels[number].scale:
                    break
        return rvec

    def sigma_px(self, rvec: np.ndarray) -> float:
        """The standard deviation of the turn that the finest level finds at `rvec`, pixels at 640 across, were landmarks
        independent; infinite where too few tell."""
        which = self._telling[FINEST]
        if len(which) < 2 * LEAST_POINTS:
            return np.inf
        residual, inside = self.seen(FINEST, rvec, which)
        _, covariance = self.step(FINEST, residual[inside], which[inside])
        return float(self._camera.K[0, 0] * np.sqrt(np.linalg.eigvalsh(covariance)[-1])) / self.px

    def step(self, number: int, residual: np.ndarray, which: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(3,) the turn that takes most of the residual of these landmarks away, and (3, 3) its covariance.

        A landmark counts by how well it tells where it is, but none for much more than others: a bright rod that moves by
        itself must not outweigh a dim bed that stands.
        """
        level = self._levels[number]
        slope = level.slope[which]
        sigma_px = np.maximum(np.sqrt(level.apart[which]) / slope, FINEST_EDGE_PX * level.scale)
        off = residual / slope / sigma_px
        rows = self._aim.jacobian(number)[which] / sigma_px[:, None]
        weighted = rows * _tukey(off)[:, None]
        prior = np.eye(3) * (self._camera.K[0, 0] / (REACH_PX * self.px)) ** 2
        inverse = np.linalg.inv(rows.T @ weighted + prior)
        return -inverse @ (weighted.T @ off), inverse


def _rotations(rvecs: np.ndarray) -> np.ndarray:
    """(n, 3, 3): Rodrigues' formula for all of (n, 3) at once."""
    angle = np.maximum(np.linalg.norm(rvecs, axis=1), 1e-12)[:, None, None]
    x, y, z = (rvecs / angle[:, 0]).T
    nought = np.zeros_like(x)
    cross = np.stack([nought, -z, y, z, nought, -x, -y, x, nought], axis=-1).reshape(-1, 3, 3)
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def _tukey(off: np.ndarray) -> np.ndarray:
    """Tukey's biweight, scaled by the median absolute deviation (Huber 1981) where that is more than expected."""
    scale = max(1.4826 * float(np.median(np.abs(off))), 1.0) if len(off) else 1.0
    ratio = np.clip(off / (4.685 * scale), -1, 1)
    return (1 - ratio**2) ** 2
