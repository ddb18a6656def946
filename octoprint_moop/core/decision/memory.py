"""What each pixel of a view has shown while all was well."""

from __future__ import annotations

import cv2
import numpy as np

from .contours import Contours
from .misfit import SETTLING_CHECKS, Misfit
from .spots import Window, about, placed

SURROUNDINGS_EVERY = 4  # good checks
NEWEST = 0.12  # weight of the newest good check in what a pixel has shown so far
DOUBTFUL = 0.25  # so much less where it shows what is out of place
STANDING, CHRONIC = 0.6, 0.35
LOOK_NEWEST = 0.36  # the same for its look, which follows the light
MUCH_NEARER = 0.6
MOSTLY_GONE = 0.4
SHINING = 6.0  # grey levels above the bed, of all channels
SHADE_LEAST, SHADE_TINT = 0.25, 0.2
UNCHANGED = 8  # the same within which a pixel looks as it did
BED_SIDE_PX = 7  # by so many pixels together, since noise alone changes one
BED_LEAST_PX, BED_CLEARLY = 60, 0.8
LOOSE_LEFT = 0.25  # of loose matter; where less is seen, somebody has taken it away
CHANGED = 18  # grey levels in any channel by which a pixel looks unlike another time


def planes(picture_bgr: np.ndarray) -> np.ndarray:
    """(3, H, W) uint8: blue, green and red of a picture (H, W, 3 or more), smoothed.

    One channel at a time they are quickest to work with.
    """
    smoothed, apart = cv2.blur(picture_bgr, (3, 3)), np.empty((3, *picture_bgr.shape[:2]), np.uint8)
    for number, plane in enumerate(apart):
        cv2.extractChannel(smoothed, number, dst=plane)
    return apart


class Memory:
    """Fading means over the good checks of one view: whether a pixel was matter, and how it looked with and without.

    Windows are rows and columns of the expected mask; frames are laid upon it by `misfit` and cut to the window before
    they come in here. A `look` is what such a frame shows, as `planes` gives it.
    """

    def __init__(
        self, reference_bgr: np.ndarray | None, shape: tuple[int, int], known: np.ndarray | None = None
    ) -> None:
        """reference_bgr : (H, W, 3) uint8, the bare bed in this pose; None where there is no picture of it
        known : (H, W) bool, where that picture shows it; None for everywhere
        """
        self._matter = np.zeros(shape, np.float32)
        self._covered = np.zeros((3, *shape), np.uint8)
        self._bare = np.zeros_like(self._covered) if reference_bgr is None else planes(reference_bgr)
        self._has_covered = np.zeros(shape, bool)
        self._has_bare = np.full(shape, reference_bgr is not None) if known is None else known
        self._given_up = np.zeros(shape, bool)
        self._loose = np.zeros(shape, bool)
        self._compared: tuple[np.ndarray | None, Window | None, dict[str, np.ndarray]] = (None, None, {})
        self._checks = 0
        self.misfit = Misfit()
        self.contours = Contours(shape)

    @property
    def is_young(self) -> bool:
        """Whether too few good checks have shown what matter may look like: dull at one layer, shining at the next."""
        return self._checks < SETTLING_CHECKS

    def standing(self, window: Window) -> np.ndarray:
        """bool: pixels that have mostly been seen as matter; none before the first good check."""
        return self._matter[window] > STANDING

    def chronic(self, window: Window) -> np.ndarray:
        """bool: pixels that look like matter, or have been accepted as such, while all is well."""
        return self._matter[window] > CHRONIC

    def ever_seen(self, window: Window) -> np.ndarray:
        """bool: pixels that were matter in some good check, or of which the user said that none need come."""
        return self._has_covered[window] | self._given_up[window]

    def looks_bare(self, window: Window, look: np.ndarray, where: np.ndarray) -> np.ndarray:
        """bool: of the pixels `where`, those of which the picture bears out that nothing lies there.

        Where the bare bed's look is known, it must be much more like that than like the matter seen there, and clearly
        unlike the latter: filament that looks like the bed is neither seen to come nor to go. Where no matter was seen
        yet, it must be like the bare bed; where only matter was seen, unlike it.
        """
        if not where.any():
            return where
        few = about(where)
        has_bare, has_covered = self._has_bare[window][few], self._has_covered[window][few]
        from_bare, from_covered = self._from_bare(window, look)[few], self._from_covered(window, look)[few]
        nearer = (from_bare < np.float32(MUCH_NEARER) * from_covered) & (from_covered > CHANGED)
        like_bare = np.where(has_covered, nearer, from_bare < CHANGED)
        return placed(where, few, np.where(has_bare, like_bare, ~has_covered | (from_covered > CHANGED)))

    def looks_covered(self, window: Window, look: np.ndarray, where: np.ndarray) -> np.ndarray:
        """bool: of the pixels `where`, those of which the picture bears out that the matter seen there still lies there."""
        if not where.any():
            return where
        few = about(where)
        known = self._has_bare[window][few] & self._has_covered[window][few]
        from_bare, from_covered = self._from_bare(window, look)[few], self._from_covered(window, look)[few]
        nearer = (from_covered < np.float32(MUCH_NEARER) * from_bare) & (from_bare > CHANGED)
        return placed(where, few, known & nearer)

    def looks_unchanged(self, window: Window, look: np.ndarray, where: np.ndarray) -> np.ndarray:
        """bool: of the pixels `where`, those that look just as they did without matter, which was never seen there."""
        if not where.any():
            return where
        few = about(where)
        still = self._has_bare[window][few] & ~self._has_covered[window][few]
        return placed(where, few, still & (self._from_bare(window, look)[few] < UNCHANGED))

    def all_bare(self, window: Window, look: np.ndarray, where: np.ndarray, beside: np.ndarray) -> bool:
        """Whether the pixels `where`, all together, look like the bare bed rather than like the matter that was seen there.

        Of the difference that matter made to the look, by least squares, a lesser part is left than MOSTLY_GONE, and what
        is left is not more than a bed may change by. What light has changed is taken from those `beside`. Never before
        enough good checks have shown what matter may look like: dull at one layer, shining at the next.
        """
        known = self._has_bare[window]
        if self.is_young:
            return False
        where, beside = where & known & self._has_covered[window], beside & known
        if not (where.any() and beside.any()):
            return False
        left = made = changed = 0.0
        for now, bare, covered in zip(look, self.bare(window), self._covered):
            light = float(now[beside].mean()) - float(bare[beside].mean())
            change = now[where].astype(np.float32) - bare[where] - light
            matter = covered[window][where].astype(np.float32) - bare[where]
            left, made, changed = left + change @ matter, made + matter @ matter, changed + change @ change
        return left < MOSTLY_GONE * made and changed < CHANGED**2 * len(look) * np.count_nonzero(where)

    def shows_bed(self, window: Window, look: np.ndarray, where: np.ndarray) -> np.ndarray:
        """uint8, 0 or 255: of the pixels `where`, 0 or 255, those about which the picture shows the bare bed."""
        if not where.any():
            return where
        few = about(where)
        shows = np.zeros_like(where)
        shows[few][(self._bed_apart(window, look, few) < UNCHANGED) & self._has_bare[window][few]] = 255
        return shows & where

    def bed_changed(self, window: Window, look: np.ndarray, where: np.ndarray, change: int) -> np.ndarray:
        """bool: of the pixels `where`, those about which the bed looks otherwise by more than so many grey levels."""
        if not where.any():
            return where
        few = about(where)
        return placed(where, few, (self._bed_apart(window, look, few) > change) & self._has_bare[window][few])

    def _bed_apart(self, window: Window, look: np.ndarray, few: Window) -> np.ndarray:
        """uint8, of `few` rows and columns: the largest difference from the bare bed in any channel, of pixels together."""
        side = (BED_SIDE_PX, BED_SIDE_PX)
        now, then = (np.stack([cv2.blur(plane[few], side) for plane in kept]) for kept in (look, self.bare(window)))
        return _most_apart(now, then)

    def drift(self, window: Window, look: np.ndarray, where: np.ndarray, beside: np.ndarray) -> float:
        """Grey levels by which the pixels `where` have changed since they were bare, on average, less what those `beside` have.

        Of the channel that has changed most. What noise hides in one pixel, hundreds of them show.
        """
        has_bare = self._has_bare[window]
        where, beside = where & has_bare, beside & has_bare
        if not (where.any() and beside.any()):
            return 0.0
        changes = [now.astype(np.float32) - bare for now, bare in zip(look, self.bare(window))]
        return max(abs(float(change[where].mean() - change[beside].mean())) for change in changes)

    def looks_unlike_bed(self, window: Window, look: np.ndarray, where: np.ndarray, bed: np.ndarray) -> np.ndarray:
        """bool: of the pixels `where`, those that look bare only because the bed beside them, `bed`, lies in another light now.

        Light is undone by what is around the print in the whole picture, which a dark bed need not follow.
        """
        bed = bed & self._has_bare[window]
        if np.count_nonzero(bed) < BED_LEAST_PX:
            return np.zeros_like(where)
        changes = [float(np.median(now[bed]) - np.median(then[bed])) for now, then in zip(look, self.bare(window))]
        if max(abs(change) for change in changes) < CHANGED / 2:
            return np.zeros_like(where)
        undone = np.stack([np.clip(now - change + 0.5, 0, 255).astype(np.uint8) for now, change in zip(look, changes)])
        return self.looks_new(window, undone, where, CHANGED // 2, unknown=False)

    def shines(self, window: Window, look: np.ndarray, where: np.ndarray, beside: np.ndarray) -> bool:
        """Whether the pixels `where`, of which dark matter was seen on a brighter bed, are brighter than it now, on average
        and against those `beside`: solid lines shine or not as they lie to the lamp, a bed from which they came off does not.
        """
        has_bare = self._has_bare[window]
        where, beside = where & has_bare & self._has_covered[window], beside & has_bare
        if not (where.any() and beside.any()):
            return False
        for now, bare, covered in zip(look, self.bare(window), self._covered):
            there, around = now[where].mean() - bare[where].mean(), now[beside].mean() - bare[beside].mean()
            if there - around < SHINING or covered[window][where].mean() > bare[where].mean() - CHANGED:
                return False
        return True

    def looks_strange(self, window: Window, look: np.ndarray, where: np.ndarray) -> np.ndarray:
        """bool: of the pixels `where`, those that look neither like the bare bed nor like the matter seen there."""
        if not where.any():
            return where
        few = about(where)
        known = self._has_bare[window][few] & self._has_covered[window][few]
        from_bare, from_covered = self._from_bare(window, look)[few], self._from_covered(window, look)[few]
        return placed(where, few, known & (cv2.min(from_bare, from_covered) > 2 * CHANGED))

    def looks_otherwise(self, window: Window, look: np.ndarray, where: np.ndarray) -> np.ndarray:
        """bool: of the pixels `where`, those that look otherwise than the matter seen there did."""
        if not where.any():
            return where
        few = about(where)
        other = self._from_covered(window, look)[few] > CHANGED // 2
        return placed(where, few, other & self._has_covered[window][few])

    def looks_new(
        self, window: Window, look: np.ndarray, where: np.ndarray, change: int = CHANGED, unknown: bool = True
    ) -> np.ndarray:
        """bool: of the pixels `where`, those of which the picture bears out that something lies there that did not.

        change : grey levels in any channel that make a difference; unknown : what to say where the bare bed's look is not known
        """
        if not where.any():
            return where
        few = about(where)
        new = self._from_bare(window, look)[few] > change
        has_bare = self._has_bare[window][few]
        return placed(where, few, new | ~has_bare if unknown else new & has_bare)

    def looks_shaded(self, window: Window, look: np.ndarray, where: np.ndarray) -> np.ndarray:
        """bool: of the pixels `where`, those that look like the bare bed with less light on it."""
        if not where.any():
            return where
        few = about(where)
        ratios = np.array(
            [(now[few] + 1.0) / (then[window][few] + 1.0) for now, then in zip(look, self._bare)], np.float32
        )
        darkest, brightest = ratios.min(axis=0), ratios.max(axis=0)
        shaded = (brightest < 1.0) & (darkest > SHADE_LEAST) & (brightest - darkest < SHADE_TINT * brightest)
        return placed(where, few, shaded & self._has_bare[window][few])

    def _from_bare(self, window: Window, look: np.ndarray) -> np.ndarray:
        """uint8, of the window's shape: the largest difference from the bare bed in any channel."""
        return self._apart("bare", self._bare, window, look)

    def _from_covered(self, window: Window, look: np.ndarray) -> np.ndarray:
        """The same from the matter that was seen."""
        return self._apart("covered", self._covered, window, look)

    def _apart(self, name: str, kept: np.ndarray, window: Window, look: np.ndarray) -> np.ndarray:
        """Many ask the same of one look, so it is worked out once."""
        if self._compared[0] is not look or self._compared[1] != window:
            self._compared = look, window, {}
        known = self._compared[2]
        if name not in known:
            known[name] = _most_apart(look, kept[:, window[0], window[1]])
        return known[name]

    def _forget_compared(self) -> None:
        self._compared = None, None, {}

    def has_bare(self, window: Window) -> np.ndarray:
        """bool: where it is known how the bed looks without matter."""
        return self._has_bare[window]

    def unlike_bare(self, window: Window, look: np.ndarray) -> np.ndarray:
        """(h, w) uint8: by how many grey levels a pixel looks unlike the bare bed; 0 where that is not known."""
        return np.where(self._has_bare[window], self._from_bare(window, look), np.uint8(0))

    def bare(self, window: Window) -> np.ndarray:
        """(3, h, w) uint8: how the bed looks without matter, where that is known."""
        return self._bare[:, window[0], window[1]]

    def learn(
        self, window: Window, wanted: np.ndarray, look: np.ndarray, observed: np.ndarray, known: np.ndarray,
        doubtful: np.ndarray | None = None,
    ) -> None:  # fmt: skip
        """Take in a good check. wanted, observed, known, doubtful : bool

        doubtful : out of place, but not enough for a suspicion; a fault that grows slowly must not be learned as it comes
        """
        self._checks += 1
        seen = observed & ~self.looks_unchanged(window, look, observed)
        matter, fresh = self._matter[window], wanted & seen & known & ~self._has_covered[window]
        weight = max(NEWEST, 1 / (self._checks + 1))  # a plain mean at first, a fading one later
        sure = known if doubtful is None else known & ~doubtful
        if self.misfit.settled(self._checks):
            self.contours.learn(window, wanted, look, observed, known)
        cv2.accumulateWeighted(seen.view(np.uint8), matter, weight, sure.view(np.uint8))
        if doubtful is not None and doubtful.any():
            cv2.accumulateWeighted(seen.view(np.uint8), matter, DOUBTFUL * weight, (known & doubtful).view(np.uint8))
        matter[fresh] = 1.0
        for kept, has, where in (
            (self._covered, self._has_covered[window], seen & known),
            (self._bare, self._has_bare[window], ~seen & ~wanted & known),
        ):
            few = about(where)
            first, mask = (where & ~has)[few].view(np.uint8), np.ascontiguousarray(where[few]).view(np.uint8)
            some_first = first.any()
            for plane, now in zip(kept, look):
                plane, now = plane[window][few], now[few]
                if some_first:
                    cv2.copyTo(now, first, plane)
                cv2.copyTo(cv2.addWeighted(now, LOOK_NEWEST, plane, 1 - LOOK_NEWEST, 0), mask, plane)
            has |= where
        self._forget_compared()

    def accept(
        self, window: Window, wanted: np.ndarray, look: np.ndarray, observed: np.ndarray, stray: np.ndarray
    ) -> None:
        """The user goes on with the print as it is: from now on this is how it looks, what is missing is given up, and
        what hangs loose may go on growing and moving.
        """
        self.contours.forget()
        self._loose[window] |= stray
        self._matter[window] = observed
        for plane in range(3):
            self._covered[plane][window][observed] = look[plane][observed]
            self._bare[plane][window][~observed] = look[plane][~observed]
        self._has_covered[window] |= observed
        self._has_bare[window] |= ~observed
        self._given_up[window] |= wanted & ~observed
        self._forget_compared()

    def loose(self, window: Window) -> np.ndarray:
        """bool: matter out of place with which the user went on, and what has grown from it since."""
        return self._loose[window]

    def keep_loose(self, window: Window, loose: np.ndarray, seen: np.ndarray, known: np.ndarray) -> None:
        """In a check that could be judged, what hangs loose has spread to `loose`; where hardly any of it is seen, it was
        taken away. What is not known, behind a head perhaps, may still hang there. All bool.
        """
        self._loose[window] |= loose
        asked = self._loose[window] & known
        asked_px = np.count_nonzero(asked)
        if asked_px and np.count_nonzero(asked & seen) < LOOSE_LEFT * asked_px:
            self._loose[:] = False

    def given_up(self, window: Window) -> np.ndarray:
        """bool: matter that was missing when the user went on."""
        return self._given_up[window]

    def carried(self, matrix: np.ndarray, shape: tuple[int, int]) -> None:
        """The bed or the view has moved: what a pixel showed is now seen elsewhere.

        matrix : (3, 3), new pixels from old ones; shape : (height, width) of the new pictures
        """

        def warp(picture: np.ndarray) -> np.ndarray:
            return cv2.warpPerspective(picture, matrix, shape[::-1], flags=cv2.INTER_LINEAR)

        self._matter = warp(self._matter)
        self._covered, self._bare = (np.stack([warp(plane) for plane in kept]) for kept in (self._covered, self._bare))
        for name in ("_has_covered", "_has_bare", "_given_up", "_loose"):
            setattr(self, name, warp(getattr(self, name).view(np.uint8)) > 0)
        self.misfit.carried(matrix)
        self.contours.carried(matrix, shape)
        self._forget_compared()

    def recalibrated(self, matrix: np.ndarray, shape: tuple[int, int]) -> None:
        """The print is expected elsewhere from now on, where it was seen to be. As `carried`."""
        self.carried(matrix, shape)
        self.contours.forget()
        self.misfit.begin_anew(self._checks)

    @property
    def wants_surroundings(self) -> bool:
        """Whether it is time to see more than the print: what is around it must be known when something comes to lie there."""
        return self._checks < SETTLING_CHECKS or self._checks % SURROUNDINGS_EVERY == 0

    def settle(self, window: Window, wanted: np.ndarray, observed: np.ndarray, ignored: np.ndarray) -> None:
        """Have the misfit found, or followed; see `Misfit.settle`."""
        self.misfit.settle(self._checks, window, wanted, observed, ignored)

    def bed_moved(self, window: Window, still: np.ndarray, moved: np.ndarray, off_print: np.ndarray) -> bool | None:
        """Whether the bed agrees that the picture has moved; None where it shows too little to tell.

        still, moved : looks of the frame as it was aligned and as it would have to be
        off_print    : (h, w) bool, where nothing of the print is, nor its shadow
        """
        told = off_print & self._has_bare[window] & (_most_apart(still, moved) > CHANGED // 2)
        if np.count_nonzero(told) < BED_LEAST_PX:
            return None
        apart_still, apart_moved = (float(_most_apart(look, self.bare(window))[told].mean()) for look in (still, moved))
        if min(apart_still, apart_moved) > BED_CLEARLY * max(apart_still, apart_moved):
            return None
        return apart_moved < apart_still


def _most_apart(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """(h, w) uint8: the largest difference of two (3, h, w) in any of the three channels."""
    blue, green, red = (cv2.absdiff(now, then) for now, then in zip(one, other))
    return cv2.max(cv2.max(blue, green), red)
