"""What each pixel of a view has shown while all was well, and by how much the calibration is off."""

from __future__ import annotations

import cv2
import numpy as np

MOST_MISFIT_PX = 6  # a calibration further off than this must be done again, not explained away
SETTLING_CHECKS = 4  # good checks before the misfit is taken for known; from then on it only creeps,
CREEPING_CHECKS = 12  # by a pixel in so many, as a print grows out of the height at which it was found
NEWEST = 0.12  # weight of the newest good check in what a pixel has shown so far
LEAST_GAIN = 0.02  # of the expected pixels, by a pixel of misfit
STANDING, CHRONIC = 0.6, 0.35
LOOK_NEWEST = 0.36  # the same for its look, which follows the light
MUCH_NEARER = 0.6
UNCHANGED = 8.0  # the same within which a pixel looks as it did
CHANGED = 18.0  # grey levels in any channel by which a pixel looks unlike another time

Window = tuple  # (slice, slice): rows and columns


class Memory:
    """Fading means over the good checks of one view: whether a pixel was matter, and how it looked with and without.

    Windows are rows and columns of the observed frame: those of the expected mask, `moved` by the misfit.
    """

    def __init__(self, reference_bgr: np.ndarray | None, shape: tuple[int, int]) -> None:
        """`reference_bgr`: (H, W, 3) uint8, the bare bed in this pose; None where there is no picture of it."""
        self._matter = np.zeros(shape, np.float32)
        self._covered = np.zeros((*shape, 3), np.float32)
        self._bare = np.zeros((*shape, 3), np.float32)
        self._has_covered = np.zeros(shape, bool)
        self._has_bare = np.full(shape, reference_bgr is not None)
        if reference_bgr is not None:
            self._bare[:] = cv2.blur(reference_bgr, (3, 3))
        self._given_up = np.zeros(shape, bool)
        self._checks = 0
        self.misfit_px = (0, 0)

    def moved(self, window: Window) -> Window:
        """Where the frame shows what the expected mask has in `window`."""
        right, down = self.misfit_px
        rows, columns = window
        return slice(rows.start + down, rows.stop + down), slice(columns.start + right, columns.stop + right)

    def standing(self, there: Window) -> np.ndarray:
        """bool: pixels that have mostly been seen as matter; none before the first good check."""
        return self._matter[there] > STANDING

    def chronic(self, there: Window) -> np.ndarray:
        """bool: pixels that look like matter, or have been accepted as such, while all is well."""
        return self._matter[there] > CHRONIC

    def ever_seen(self, there: Window) -> np.ndarray:
        """bool: pixels that were matter in some good check, or of which the user said that none need come."""
        return self._has_covered[there] | self._given_up[there]

    def looks_bare(self, there: Window, look: np.ndarray, where: np.ndarray) -> np.ndarray:
        """bool: of the pixels `where`, those of which the picture bears out that nothing lies there.

        look : (h, w, 3) uint8, blurred like what is kept. Where the bare bed's look is known, it must be much more like
        that than like the matter seen there; where no matter was seen yet, like the bare bed; where only matter was
        seen, unlike it.
        """
        now = look[where].astype(np.float32)
        from_bare, from_covered = _apart(now, self._bare[there][where]), _apart(now, self._covered[there][where])
        has_bare, has_covered = self._has_bare[there][where], self._has_covered[there][where]
        like_bare = np.where(has_covered, from_bare < MUCH_NEARER * from_covered, from_bare < CHANGED)
        return _placed(where, np.where(has_bare, like_bare, ~has_covered | (from_covered > CHANGED)))

    def looks_unchanged(self, there: Window, look: np.ndarray, where: np.ndarray) -> np.ndarray:
        """bool: of the pixels `where`, those that look just as they did without matter, which was never seen there."""
        still = _apart(look[where].astype(np.float32), self._bare[there][where]) < UNCHANGED
        return _placed(where, still & self._has_bare[there][where] & ~self._has_covered[there][where])

    def looks_strange(self, there: Window, look: np.ndarray, where: np.ndarray) -> np.ndarray:
        """bool: of the pixels `where`, those that look neither like the bare bed nor like the matter seen there."""
        now = look[where].astype(np.float32)
        from_bare, from_covered = _apart(now, self._bare[there][where]), _apart(now, self._covered[there][where])
        known = self._has_bare[there][where] & self._has_covered[there][where]
        return _placed(where, known & (from_bare > 2 * CHANGED) & (from_covered > 2 * CHANGED))

    def looks_new(
        self, there: Window, look: np.ndarray, where: np.ndarray, change: float = CHANGED, unknown: bool = True
    ) -> np.ndarray:
        """bool: of the pixels `where`, those of which the picture bears out that something lies there that did not.

        change : grey levels in any channel that make a difference; unknown : what to say where the bare bed's look is not known
        """
        apart = _apart(look[where].astype(np.float32), self._bare[there][where])
        return _placed(where, np.where(self._has_bare[there][where], apart > change, unknown))

    def learn(
        self, window: Window, wanted: np.ndarray, frame_bgr: np.ndarray, observed: np.ndarray, ignored: np.ndarray
    ) -> None:
        """Take in a good check.

        window, wanted : of the expected mask, bool; frame_bgr, observed, ignored : the whole frame and its masks, uint8
        """
        self._checks += 1
        if self._checks % CREEPING_CHECKS == 0:
            self._creep(window, wanted, observed, ignored)
        there = self.moved(window)
        seen, sure = observed[there] > 0, ignored[there] == 0
        look = cv2.blur(frame_bgr[there], (3, 3))
        seen &= ~self.looks_unchanged(there, look, seen)
        matter, fresh = self._matter[there], wanted & seen & sure & ~self._has_covered[there]
        weight = max(NEWEST, 1 / (self._checks + 1))  # a plain mean at first, a fading one later
        cv2.accumulateWeighted(seen.astype(np.float32), matter, weight, sure.astype(np.uint8))
        matter[fresh] = 1.0
        for kept, has, where in (
            (self._covered[there], self._has_covered[there], seen & sure),
            (self._bare[there], self._has_bare[there], ~seen & ~wanted & sure),
        ):
            first = where & ~has
            kept[first] = look[first]
            cv2.accumulateWeighted(look, kept, LOOK_NEWEST, where.astype(np.uint8))
            has |= where

    def accept(self, window: Window, wanted: np.ndarray, frame_bgr: np.ndarray, observed: np.ndarray) -> None:
        """The user goes on with the print as it is: from now on this is how it looks, and what is missing is given up."""
        there = self.moved(window)
        seen, look = observed[there] > 0, cv2.blur(frame_bgr[there], (3, 3))
        self._matter[there] = seen
        self._covered[there][seen], self._has_covered[there][seen] = look[seen], True
        self._bare[there][~seen], self._has_bare[there][~seen] = look[~seen], True
        self._given_up[there] |= wanted & ~seen

    def given_up(self, there: Window) -> np.ndarray:
        """bool: matter that was missing when the user went on."""
        return self._given_up[there]

    def carried(self, matrix: np.ndarray) -> None:
        """The bed has moved: what a pixel showed is now seen elsewhere. matrix: (3, 3), new pixels from old ones."""
        size = self._matter.shape[::-1]

        def warp(picture: np.ndarray) -> np.ndarray:
            return cv2.warpPerspective(picture, matrix, size, flags=cv2.INTER_LINEAR)

        self._matter, self._covered, self._bare = warp(self._matter), warp(self._covered), warp(self._bare)
        for name in ("_has_covered", "_has_bare", "_given_up"):
            setattr(self, name, warp(getattr(self, name).astype(np.uint8)) > 0)

    def settle(self, window: Window, wanted: np.ndarray, observed: np.ndarray, ignored: np.ndarray) -> None:
        """Before the first good checks: find the misfit anew, as far off as may be."""
        if self._checks >= SETTLING_CHECKS or not wanted.any():
            return
        rows, columns = window
        reach = MOST_MISFIT_PX
        around = slice(rows.start - reach, rows.stop + reach), slice(columns.start - reach, columns.stop + reach)
        pays = np.where(observed[around] > 0, np.float32(1), np.float32(-1))
        pays[ignored[around] > 0] = 0
        score = cv2.matchTemplate(pays, wanted.astype(np.float32), cv2.TM_CCORR)
        down, right = np.mgrid[-reach : reach + 1, -reach : reach + 1]
        # of offsets that explain about as much, the smallest
        score -= LEAST_GAIN * np.count_nonzero(wanted) * np.hypot(right, down)
        row, column = np.unravel_index(int(np.argmax(score)), score.shape)
        self.misfit_px = (int(column) - reach, int(row) - reach)

    def _creep(self, window: Window, wanted: np.ndarray, observed: np.ndarray, ignored: np.ndarray) -> None:
        """A pixel towards the offset at which the expected mask agrees better, where that explains much."""
        here = self._disagreement(self.misfit_px, window, wanted, observed, ignored)
        best, at = 0.9 * here - 20, self.misfit_px
        for step in ((1, 0), (-1, 0), (0, 1), (0, -1)):
            offset = (self.misfit_px[0] + step[0], self.misfit_px[1] + step[1])
            if max(abs(offset[0]), abs(offset[1])) <= MOST_MISFIT_PX:
                there = self._disagreement(offset, window, wanted, observed, ignored)
                if there < best:
                    best, at = there, offset
        self.misfit_px = at

    @staticmethod
    def _disagreement(
        offset: tuple[int, int], window: Window, wanted: np.ndarray, observed: np.ndarray, ignored: np.ndarray
    ) -> int:
        right, down = offset
        rows, columns = window
        there = slice(rows.start + down, rows.stop + down), slice(columns.start + right, columns.stop + right)
        return int(np.count_nonzero((wanted != (observed[there] > 0)) & (ignored[there] == 0)))


def _apart(look: np.ndarray, other: np.ndarray) -> np.ndarray:
    """(n,) largest difference in any channel of two (n, 3)."""
    return np.abs(look - other).max(axis=1)


def _placed(where: np.ndarray, values: np.ndarray) -> np.ndarray:
    placed = np.zeros(where.shape, bool)
    placed[where] = values
    return placed
