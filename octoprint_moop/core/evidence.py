"""What a frame says about the print: where matter is missing, where there is too much, and since when.

E alone mixes a camera that is a pixel off with a print that fails. So differences are weighed by what this print has
shown so far, pixel by pixel: matter that was seen in earlier checks and is gone is *lost*; matter that lies where none
was expected, and did not lie there while all was well, is *stray*; and of the matter that the last layers should have
added, the *fresh*, the share that is seen is compared with what it was. All three leave out a band of a few pixels
around every expected edge (`tolerance_px`), within which neither calibration nor segmentation is trusted.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from .expected import Expected, PrintMap

WINDOWS = (1, 2, 4, 8)  # layers back over which fresh matter is counted
SETTLED_LAYERS = 2  # matter of these last layers is fresh, older matter is established
MEMORY = 0.12  # weight of the newest good check in what a pixel has shown so far
SEEN_BEFORE, STRAY_BEFORE = 0.6, 0.35
WHOLE = -1


@dataclass(frozen=True)
class Evidence:
    """Pixel counts of one scope: one labelled object, or the WHOLE print.

    expected_px, total_px : of the expected mask now and of the complete one
    standing_px : established matter that was seen in earlier checks; lost_px : of it, what is seen no more
    stray_px    : matter where none is expected, new since all was well
    fresh       : for each of WINDOWS, pixels that its layers newly cover, and how many of them are seen
    """

    object_id: int
    expected_px: int
    total_px: int
    standing_px: int
    lost_px: int
    stray_px: int
    xor_px: int
    fresh: tuple[tuple[int, int], ...]

    @property
    def error_ratio(self) -> float:
        return self.xor_px / max(self.total_px, 1)


@dataclass(frozen=True, eq=False)
class Findings:
    """The pictures behind the evidence: (H, W) bool; and the evidence of the whole (first) and of each object."""

    lost: np.ndarray
    stray: np.ndarray
    scopes: tuple[Evidence, ...]

    @property
    def whole(self) -> Evidence:
        return self.scopes[0]


class Memory:
    """What each pixel of one pose of the bed has shown while all was well."""

    def __init__(self, shape: tuple[int, int]) -> None:
        self._seen = np.zeros(shape, np.float32)
        self._stray = np.zeros(shape, np.float32)
        self._checks = 0

    def established(self, expected: np.ndarray) -> np.ndarray:
        """(H, W) bool: expected pixels that have mostly been seen as matter; before the first good check, none."""
        return (self._seen > SEEN_BEFORE) & expected

    def chronic(self) -> np.ndarray:
        """(H, W) bool: pixels that look like matter though none is expected, while all is well (a mirror image)."""
        return self._stray > STRAY_BEFORE

    def learn(self, expected: np.ndarray, observed: np.ndarray, known: np.ndarray) -> None:
        """Take in a good check, all (H, W) bool: expected and observed matter, and where both are known."""
        self._checks += 1
        weight = max(MEMORY, 1 / self._checks)  # a plain mean at first, a fading one later
        fresh = expected & (self._seen == 0) & observed & known
        cv2.accumulateWeighted((observed & expected).astype(np.float32), self._seen, weight, known.astype(np.uint8))
        self._seen[fresh] = 1.0
        cv2.accumulateWeighted((observed & ~expected).astype(np.float32), self._stray, weight, known.astype(np.uint8))


def find(
    print_map: PrintMap,
    expected: Expected,
    layer: int,
    observed: np.ndarray,
    ignored: np.ndarray,
    memory: Memory,
    tolerance_px: float,
) -> Findings:
    """Weigh one frame. observed, ignored: (H, W) uint8, 0 or 255, in the pixels of `expected`.

    layer : the last layer of which something lies
    """
    kernel = disc(tolerance_px)
    matter = expected.mask
    near_matter = cv2.dilate(matter, kernel) > 0
    near_observed = cv2.dilate(observed, kernel) > 0
    known, seen, wanted = ignored == 0, observed > 0, matter > 0
    # a lone line of a bead's width is seen or not as the light falls: only what is wider can be lost
    wide = cv2.morphologyEx(matter, cv2.MORPH_OPEN, kernel) > 0
    established = memory.established(wanted) & wide & known
    lost = established & ~near_observed
    stray = seen & ~near_matter & known & ~memory.chronic()
    stray = _without_specks(stray)

    scopes = [WHOLE, *range(print_map.objects)] if print_map.objects > 1 else [WHOLE]
    counts = _Counts(print_map, len(scopes))
    expected_px = counts.of(wanted & known)
    total_px = counts.of((expected.birth > 0) & known)
    standing_px, lost_px = counts.of(established), counts.of(lost)
    stray_px = counts.near(stray)
    xor_px = counts.of(wanted & ~seen & known) + counts.near(seen & ~wanted & known)
    fresh = []
    layer_of = print_map.layer
    for window in WINDOWS:
        new = wanted & known & (layer_of > layer - window) & (layer_of <= layer)
        fresh.append((counts.of(new), counts.of(new & seen)))
    evidence = tuple(
        Evidence(
            scope, int(expected_px[n]), int(total_px[n]), int(standing_px[n]), int(lost_px[n]), int(stray_px[n]),
            int(xor_px[n]), tuple((int(new[n]), int(new_seen[n])) for new, new_seen in fresh),
        )
        for n, scope in enumerate(scopes)
    )  # fmt: skip
    return Findings(lost, stray, evidence)


class _Counts:
    """Counts pixels for the whole print and for each object at once."""

    def __init__(self, print_map: PrintMap, scopes: int) -> None:
        self._map, self._scopes = print_map, scopes

    def of(self, mask: np.ndarray) -> np.ndarray:
        """(scopes,) pixels of the mask; an object's are those that only it can cover."""
        return self._count(mask, self._map.owner)

    def near(self, mask: np.ndarray) -> np.ndarray:
        """(scopes,) pixels of the mask; an object's are those to which it is the nearest."""
        return self._count(mask, self._map.nearest)

    def _count(self, mask: np.ndarray, owner: np.ndarray) -> np.ndarray:
        counts = np.zeros(self._scopes, np.int64)
        counts[0] = np.count_nonzero(mask)
        if self._scopes > 1 and counts[0]:
            owners = owner[mask]
            counts[1:] = np.bincount(owners[owners >= 0], minlength=self._scopes - 1)[: self._scopes - 1]
        return counts


def disc(radius_px: float) -> np.ndarray:
    """A round structuring element, uint8."""
    side = 2 * int(np.ceil(radius_px)) + 1
    y, x = np.mgrid[:side, :side] - side // 2
    return (x * x + y * y <= radius_px * radius_px + 0.5).astype(np.uint8)


def _without_specks(mask: np.ndarray, least_px: int = 6) -> np.ndarray:
    """The mask without spots of fewer pixels: noise comes in specks, strands do not."""
    if not mask.any():
        return mask
    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=8)
    keep = stats[:, cv2.CC_STAT_AREA] >= least_px
    keep[0] = False
    return keep[labels]
