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
UNCHANGED = 8  # the same within which a pixel looks as it did
CHANGED = 18  # grey levels in any channel by which a pixel looks unlike another time

Window = tuple  # (slice, slice): rows and columns


def planes(picture_bgr: np.ndarray) -> np.ndarray:
    """(3, H, W) uint8: blue, green and red of a picture (H, W, 3), smoothed. OpenCV is quickest with one channel at a time."""
    smoothed = np.empty((3, *picture_bgr.shape[:2]), np.uint8)
    for plane, channel in zip(smoothed, cv2.split(picture_bgr)):
        cv2.blur(channel, (3, 3), dst=plane)
    return smoothed


class Memory:
    """Fading means over the good checks of one view: whether a pixel was matter, and how it looked with and without.

    Windows are rows and columns of the observed frame: those of the expected mask, `moved` by the misfit. A `look` is
    what the whole frame shows, as `planes` gives it.
    """

    def __init__(self, reference_bgr: np.ndarray | None, shape: tuple[int, int]) -> None:
        """`reference_bgr`: (H, W, 3) uint8, the bare bed in this pose; None where there is no picture of it."""
        self._matter = np.zeros(shape, np.float32)
        self._covered = np.zeros((3, *shape), np.uint8)
        self._bare = np.zeros_like(self._covered) if reference_bgr is None else planes(reference_bgr)
        self._has_covered = np.zeros(shape, bool)
        self._has_bare = np.full(shape, reference_bgr is not None)
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

        Where the bare bed's look is known, it must be much more like that than like the matter seen there; where no
        matter was seen yet, like the bare bed; where only matter was seen, unlike it.
        """
        few = about(where)
        has_bare, has_covered = self._has_bare[there][few], self._has_covered[there][few]
        from_bare, from_covered = _apart(look, self._bare, there, few), _apart(look, self._covered, there, few)
        nearer = from_bare < np.float32(MUCH_NEARER) * from_covered
        like_bare = np.where(has_covered, nearer, from_bare < CHANGED)
        return placed(where, few, np.where(has_bare, like_bare, ~has_covered | (from_covered > CHANGED)))

    def looks_unchanged(self, there: Window, look: np.ndarray, where: np.ndarray) -> np.ndarray:
        """bool: of the pixels `where`, those that look just as they did without matter, which was never seen there."""
        few = about(where)
        still = self._has_bare[there][few] & ~self._has_covered[there][few]
        return placed(where, few, still & (_apart(look, self._bare, there, few) < UNCHANGED))

    def looks_strange(self, there: Window, look: np.ndarray, where: np.ndarray) -> np.ndarray:
        """bool: of the pixels `where`, those that look neither like the bare bed nor like the matter seen there."""
        few = about(where)
        known = self._has_bare[there][few] & self._has_covered[there][few]
        from_bare, from_covered = _apart(look, self._bare, there, few), _apart(look, self._covered, there, few)
        return placed(where, few, known & (cv2.min(from_bare, from_covered) > 2 * CHANGED))

    def looks_new(
        self, there: Window, look: np.ndarray, where: np.ndarray, change: int = CHANGED, unknown: bool = True
    ) -> np.ndarray:
        """bool: of the pixels `where`, those of which the picture bears out that something lies there that did not.

        change : grey levels in any channel that make a difference; unknown : what to say where the bare bed's look is not known
        """
        few = about(where)
        new = _apart(look, self._bare, there, few) > change
        has_bare = self._has_bare[there][few]
        return placed(where, few, new | ~has_bare if unknown else new & has_bare)

    def learn(
        self, window: Window, wanted: np.ndarray, look: np.ndarray, observed: np.ndarray, ignored: np.ndarray
    ) -> None:
        """Take in a good check.

        window, wanted : of the expected mask, bool; look, observed, ignored : of the whole frame, uint8
        """
        self._checks += 1
        if self._checks % CREEPING_CHECKS == 0:
            self._creep(window, wanted, observed, ignored)
        there = self.moved(window)
        seen, sure = observed[there] > 0, ignored[there] == 0
        seen &= ~self.looks_unchanged(there, look, seen)
        matter, fresh = self._matter[there], wanted & seen & sure & ~self._has_covered[there]
        weight = max(NEWEST, 1 / (self._checks + 1))  # a plain mean at first, a fading one later
        cv2.accumulateWeighted(seen.view(np.uint8), matter, weight, sure.view(np.uint8))
        matter[fresh] = 1.0
        for kept, has, where in (
            (self._covered, self._has_covered[there], seen & sure),
            (self._bare, self._has_bare[there], ~seen & ~wanted & sure),
        ):
            few = about(where)
            first, mask = (where & ~has)[few].view(np.uint8), np.ascontiguousarray(where[few]).view(np.uint8)
            for plane, now in zip(kept, look):
                plane, now = plane[there][few], now[there][few]
                cv2.copyTo(now, first, plane)
                cv2.copyTo(cv2.addWeighted(now, LOOK_NEWEST, plane, 1 - LOOK_NEWEST, 0), mask, plane)
            has |= where

    def accept(self, window: Window, wanted: np.ndarray, look: np.ndarray, observed: np.ndarray) -> None:
        """The user goes on with the print as it is: from now on this is how it looks, and what is missing is given up."""
        there = self.moved(window)
        seen = observed[there] > 0
        self._matter[there] = seen
        for plane in range(3):
            self._covered[plane][there][seen] = look[plane][there][seen]
            self._bare[plane][there][~seen] = look[plane][there][~seen]
        self._has_covered[there] |= seen
        self._has_bare[there] |= ~seen
        self._given_up[there] |= wanted & ~seen

    def given_up(self, there: Window) -> np.ndarray:
        """bool: matter that was missing when the user went on."""
        return self._given_up[there]

    def carried(self, matrix: np.ndarray) -> None:
        """The bed has moved: what a pixel showed is now seen elsewhere. matrix: (3, 3), new pixels from old ones."""
        size = self._matter.shape[::-1]

        def warp(picture: np.ndarray) -> np.ndarray:
            return cv2.warpPerspective(picture, matrix, size, flags=cv2.INTER_LINEAR)

        self._matter = warp(self._matter)
        for kept in (self._covered, self._bare):
            kept[:] = [warp(plane) for plane in kept]
        for name in ("_has_covered", "_has_bare", "_given_up"):
            setattr(self, name, warp(getattr(self, name).astype(np.uint8)) > 0)

    def settle(self, window: Window, wanted: np.ndarray, observed: np.ndarray, ignored: np.ndarray) -> None:
        """Before the first good checks: find the misfit anew, as far off as may be."""
        if self._checks >= SETTLING_CHECKS or not wanted.any():
            return
        few = about(wanted)
        wanted = wanted[few]
        top, left = window[0].start + few[0].start, window[1].start + few[1].start
        reach = MOST_MISFIT_PX
        around = (
            slice(top - reach, top + wanted.shape[0] + reach), slice(left - reach, left + wanted.shape[1] + reach)
        )  # fmt: skip
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


def about(where: np.ndarray) -> Window:
    """The rows and columns that hold all pixels of a bool mask, one at least; beyond, nothing needs to be worked out."""
    x, y, w, h = cv2.boundingRect(where.view(np.uint8))
    return slice(y, y + max(h, 1)), slice(x, x + max(w, 1))


def _apart(look: np.ndarray, kept: np.ndarray, there: Window, few: Window) -> np.ndarray:
    """uint8, for the `few` rows and columns of the window: the largest difference in any channel."""
    blue, green, red = (cv2.absdiff(now[there][few], then[there][few]) for now, then in zip(look, kept))
    return cv2.max(cv2.max(blue, green), red)


def placed(where: np.ndarray, few: Window, values: np.ndarray) -> np.ndarray:
    """bool, of the shape of `where`: of its pixels, those of which the bool `values` of the `few` rows and columns say so."""
    whole = np.zeros(where.shape, bool)
    np.logical_and(values, where[few], out=whole[few])
    return whole
