"""Where a camera may have turned: near where it stood at first, and where that fits badly, far and wide.

Alignment finds the bottom of the valley that it starts in, and a head that stands before the landmarks bends the valleys
of the coarse scales, where every pixel sees something of it. So the wide search asks the likelihood itself, to which an
outlier is one whatever its size, on grids that become finer; alignment has but the last step.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np

from .fit import FINEST, LEAST_POINTS, Fit
from .turns import STILL

MIDDLE = FINEST - 1
GOOD = 2.0  # mean loss: a turn near the last one that fits so well needs no rival
NOTICEABLE_PX = 0.4  # at 640 pixels across
# pixels at 640 across: how far, and in which steps, of the middle and of the rims
SEARCH_PX, SEARCH_STEP_PX, ROLL_PX, ROLL_STEP_PX = 64.0, 8.0, 16.0, 8.0
SEARCH_POINTS, REFINE_POINTS = 150, 400
RIVAL_PX, RIVAL_RATIO = 2.0, 0.1  # pixels at 640 across, and against the turn
STEPS, LEAST_GAIN = 4, 0.01  # at the end, each for so much of the mean loss
GUESSES, FINALISTS = 12, 6
FINER = ((MIDDLE, 4.0), (FINEST, 2.0))  # levels, and the steps by which a guess is bettered on each


def best_turn(fit: Fit, last: np.ndarray) -> tuple[np.ndarray, list[np.ndarray]]:
    """(3,) the turn under which the frame fits best, and its rivals: others, well away from it and one another, under which
    it fits better than about them. last : where the camera last stood
    """
    near = min((last, fit.aligned(last), fit.aligned(last, slice(MIDDLE, None))), key=fit.loss)
    good = fit.loss(near) < GOOD
    if good and fit.apart_px(near, last) < NOTICEABLE_PX:
        return near, []
    starts = [near] if good else [near, STILL.rvec, *_guesses(fit, last)]
    for number, step_px in FINER:
        bettered = [_bettered(fit, start, number, step_px) for start in starts]
        starts = _distinct(fit, sorted([*starts, *bettered], key=fit.loss), step_px)[:FINALISTS]
    ended = [near, *starts, *(fit.aligned(start, slice(FINEST, None)) for start in starts)]
    best = min(ended, key=fit.loss)
    for _ in range(STEPS):
        further = fit.aligned(_bettered(fit, best, *FINER[-1]), slice(FINEST, None))
        if fit.loss(further) > fit.loss(best) - LEAST_GAIN:
            break
        best = further
    best, *rivals = _distinct(fit, [best, *sorted(ended, key=fit.loss)], RIVAL_PX)
    return best, [rival for rival in rivals if fit.apart_px(rival, best) > RIVAL_RATIO * fit.apart_px(best, last)]


def _guesses(fit: Fit, last: np.ndarray) -> Iterator[np.ndarray]:
    """A few turns, on a coarse grid about the last one, that fit better than those about them."""
    if len(fit.telling(MIDDLE)) < LEAST_POINTS:
        return
    side = np.arange(-SEARCH_PX, SEARCH_PX + 1, SEARCH_STEP_PX)
    roll = np.arange(-ROLL_PX, ROLL_PX + 1, ROLL_STEP_PX)
    rvecs = np.array([last + fit.turned_by(*offset) for offset in itertools.product(side, side, roll)])
    chosen: list[np.ndarray] = []
    for number in np.argsort(fit.mean_losses(MIDDLE, rvecs, SEARCH_POINTS)):
        if all(fit.apart_px(rvecs[number], other) > 1.9 * SEARCH_STEP_PX for other in chosen):
            chosen.append(rvecs[number])
            yield rvecs[number]
            if len(chosen) == GUESSES:
                return


def _distinct(fit: Fit, rvecs: list[np.ndarray], apart_px: float) -> list[np.ndarray]:
    """Those that are not close to one before them."""
    kept: list[np.ndarray] = []
    for rvec in rvecs:
        if all(fit.apart_px(rvec, other) > apart_px for other in kept):
            kept.append(rvec)
    return kept


def _bettered(fit: Fit, rvec: np.ndarray, number: int, step_px: float) -> np.ndarray:
    """The best of the turns one step about this one, and itself."""
    steps = (0.0, -step_px, step_px)
    rvecs = np.array([rvec + fit.turned_by(*offset) for offset in itertools.product(steps, steps, steps)])
    return np.asarray(rvecs[int(np.argmin(fit.mean_losses(number, rvecs, REFINE_POINTS)))])
