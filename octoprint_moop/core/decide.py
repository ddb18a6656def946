"""Has the print failed? A jump rule on E: the first honest one, after the paper's Figure 6."""

from __future__ import annotations

from dataclasses import dataclass, replace
from statistics import median

OK, SUSPECT, FAILED, UNUSABLE, CAMERA_MOVED = "ok", "suspect", "failed", "unusable", "camera_moved"

BASELINE_CHECKS = 15


@dataclass(frozen=True)
class History:
    """What the checks so far say about this print.

    good     : E of the last checks in which all was well; their median is the baseline
    suspects : how many checks in a row have been above the limit
    """

    good: tuple[float, ...] = ()
    suspects: int = 0

    @property
    def baseline(self) -> float:
        return median(self.good) if self.good else 0.0


@dataclass(frozen=True)
class Decision:
    """verdict: ok, suspect or failed; limit: the E above which this check was suspect; reason: for the user."""

    verdict: str
    limit: float
    reason: str


def decide(history: History, error_ratio: float, jump_ratio: float) -> tuple[Decision, History]:
    """The decision on one check, and the history with it.

    A check is suspect when E exceeds this print's own baseline by `jump_ratio`; the second suspect check in a row, or
    one by three times as much, is a failure.
    """
    limit = history.baseline + jump_ratio
    if error_ratio <= limit:
        good = (*history.good, error_ratio)[-BASELINE_CHECKS:]
        return Decision(OK, limit, ""), History(good)
    suspects = history.suspects + 1
    history = replace(history, suspects=suspects)
    jump = error_ratio - history.baseline
    if suspects < 2 and jump < 3 * jump_ratio:
        return Decision(SUSPECT, limit, f"The error rose to {error_ratio:.3f} (limit {limit:.3f})."), history
    return (
        Decision(FAILED, limit, f"The error jumped from {history.baseline:.3f} to {error_ratio:.3f}."),
        history,
    )
