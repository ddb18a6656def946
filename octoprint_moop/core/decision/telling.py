"""Whether a look tells anything of the print: what hides it, and what cannot be told from its bed. Sentences are for people."""

from __future__ import annotations

import cv2
import numpy as np

from ..expected.views import Expected
from .compare import Comparison
from .findings import Findings
from .memory import Memory
from .spots import disc

HIDDEN_RATIO = 0.004  # of the complete print, that nothing but an obstacle explains
HIDDEN = "Something stands in the view: a hand, or a tool?"
HEAD_HIDES = "The print head hides the print. Let it park for the picture."
OUT_OF_VIEW = "Nothing of the print is in view: it is out of the picture, or the head hides it. Park the head."
ALIKE = "Filament and bed look alike here: more light, or a bed of another colour, would help."
SEEN_LEAST, EXTRA_MOST = 0.4, 1.0  # of what must be seen; until a check was within both, there is nothing to go by
MISSED_RATIO = 0.1  # of what is not seen; where less is known to be missing or out of place, the rest may be there
DRIFT_LEAST = 4.0  # grey levels by which a place where nothing came has not changed
FLOODED = 1.5  # times the complete print: so much too much matter is no print's but the bed taken for filament
LEAST_TELLING_RATIO = 0.3  # of the expected mask, that could be missed were it gone, to say that all is well
MOST_FOREIGN_RATIO = 0.05  # of the expected mask, behind what stands there for good
MOST_HIDDEN_RATIO, MOST_UNSURE_RATIO = 0.6, 0.4  # of the expected mask, to judge from the rest


def union(mask: np.ndarray, *others: np.ndarray | None) -> np.ndarray:
    """uint8: the first mask and the others, of which None stands for an empty one."""
    for other in others:
        if other is not None:
            mask = mask | other
    return mask


def blocked(
    expected: Expected,
    hidden: np.ndarray | None,
    foreign: np.ndarray | None,
    doubtful: np.ndarray | None,
    unsure: np.ndarray,
    comparison: Comparison,
) -> str:
    """Why too little of the print is seen to judge it; "" where enough is.

    A head that stands over the print hides what it hides; anything else that does is somebody's hand.
    hidden, foreign, doubtful, unsure : uint8, 255 where something has come to stand before the view, where something that
    looks like filament stands for good, where the head may stand, where filament and background look alike; None for nowhere
    """
    if hidden is not None:
        return HIDDEN
    wanted = max(cv2.countNonZero(expected.mask), 1)
    if foreign is not None and cv2.countNonZero(expected.mask & foreign) > MOST_FOREIGN_RATIO * wanted:
        return HIDDEN
    told_nothing = [mask for mask in (doubtful, expected.ignored) if mask is not None]
    if told_nothing and cv2.countNonZero(expected.mask & union(*told_nothing)) > MOST_HIDDEN_RATIO * wanted:
        return HEAD_HIDES
    if not comparison.total_px:
        return OUT_OF_VIEW
    if cv2.countNonZero(expected.mask & unsure) > MOST_UNSURE_RATIO * wanted:
        return ALIKE
    return ALIKE if comparison.extra_px > FLOODED * comparison.total_px else ""


def seems_hidden(findings: Findings) -> bool:
    """Whether what is seen no more has probably only been hidden, or nothing tells that it has gone."""
    hidden_px = max(findings.hidden_px, findings.untold_px)
    return hidden_px > max(HIDDEN_RATIO * findings.whole.total_px, 0.5 * findings.whole.lost_px)


def little_of(part: np.ndarray, whole: np.ndarray) -> bool:
    """Whether so little of the expected mask could be missed that seeing nothing wrong says nothing."""
    return cv2.countNonZero(part) < LEAST_TELLING_RATIO * cv2.countNonZero(whole)


def tells_apart(findings: Findings, memory: Memory, tolerance_px: float) -> bool:
    """Whether print and bed can be told from one another at all: most of what must be seen is, or plainly isn't there."""
    wanted, seen, near = findings.wanted & findings.known, findings.seen & findings.known, disc(tolerance_px)
    missing = wanted & (cv2.dilate(seen.view(np.uint8), near) == 0)
    extra_px = np.count_nonzero(seen & (cv2.dilate(findings.wanted.view(np.uint8), near) == 0))
    wanted_px, missing_px = np.count_nonzero(wanted), np.count_nonzero(missing)
    if extra_px > EXTRA_MOST * wanted_px:
        return False
    if missing_px <= (1 - SEEN_LEAST) * wanted_px:
        return True
    window, look = findings.window, findings.look
    if 2 * np.count_nonzero(memory.looks_bare(window, look, missing)) <= missing_px:
        return False
    # each pixel looks bare; but where filament hardly darker or brighter than the bed lies, all of them have changed a little
    far, close = (cv2.dilate(findings.wanted.view(np.uint8), disc(n * tolerance_px)) > 0 for n in (6, 2))
    return memory.drift(window, look, missing, far & ~close & findings.known & ~seen) < DRIFT_LEAST


def not_seen_px(findings: Findings, memory: Memory) -> int:
    """How many pixels of what must be seen are not, where those are most; else 0."""
    wanted = findings.wanted & findings.known & ~memory.given_up(findings.window)
    wanted_px, seen_px = np.count_nonzero(wanted), np.count_nonzero(wanted & findings.seen)
    return int(wanted_px - seen_px) if seen_px < SEEN_LEAST * wanted_px else 0


def unseen_and_unmissed(findings: Findings, memory: Memory) -> bool:
    """Whether most of what must be seen is not, and yet nothing tells that it is not there: then nothing is known of it."""
    whole = findings.whole
    missed_px = whole.lost_px + whole.stray_px + whole.unseen_px + whole.barren_px
    return missed_px < MISSED_RATIO * not_seen_px(findings, memory)
