"""What is concluded from a frame and from a print: the lines of `moop replay --json`, and what people are shown with them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .calibration.selfcheck import Fit
from .decision.compare import Comparison
from .decision.course import Look, Ruling
from .decision.decide import FAILED, OK, UNUSABLE
from .header import Moment

UNLIKE = (
    "The print is seen badly: so much of the picture is not as expected, good as it may be, that little could be told from it. "
    "Calibrate the camera anew, see that the lamp lights the print, or clear away what has the filament's colour."
)
BADLY_SEEN = (
    0.25  # the E that is usual, though nothing is wrong: of so little that is right no one would tell what fails
)


@dataclass(frozen=True)
class Check:
    """What was concluded from one frame: a line of checks.jsonl and of `moop replay --json`."""

    moment: Moment
    verdict: str
    comparison: Comparison | None = None
    limit: float | None = None
    mode: str | None = None
    reason: str = ""
    objects: tuple[dict[str, Any], ...] = ()
    ms: float = 0.0
    fit: Fit | None = None

    @classmethod
    def of(cls, moment: Moment, look: Look, ruling: Ruling | None, objects: Sequence[str]) -> Check:
        """What follows from a look and the ruling on it, None where nothing could be judged. objects: their names."""
        if ruling is None:
            return cls(moment, look.blind, look.comparison, reason=look.reason)
        worst = ruling.worst
        if worst.verdict == OK and look.little:
            return cls(moment, UNUSABLE, look.comparison, limit=ruling.limit, reason=look.little)
        if worst.verdict == OK and ruling.unlike > BADLY_SEEN:
            return cls(moment, UNUSABLE, look.comparison, limit=ruling.limit, reason=UNLIKE)
        named = look.names.get(worst.object_id) if worst.verdict != OK else None
        who = f"{objects[worst.object_id]}: " if worst.object_id >= 0 else ""
        return cls(
            moment,
            worst.verdict,
            look.comparison,
            limit=ruling.limit,
            mode=named.mode if named and worst.verdict == FAILED else None,
            reason=who + named.sentence if named else "",
            objects=tuple(
                {
                    "name": objects[outcome.object_id],
                    "E": round(evidence.error_ratio, 6),
                    "verdict": outcome.verdict,
                    "mode": look.names[outcome.object_id].mode if outcome.verdict == FAILED else None,
                }
                for evidence, outcome in zip(look.scopes[1:], ruling.outcomes[1:])
            ),
        )

    def to_json(self) -> dict[str, Any]:
        """The check line of FORMATS.md, section 4. Counts are null where nothing could be compared."""
        seen = self.comparison
        counts = ("xor_px", "missing_px", "extra_px", "expected_px", "observed_px", "ignored_px", "total_px")
        return {
            "type": "check",
            "frame": self.moment.frame,
            "layer": self.moment.layer,
            "file_pos": self.moment.file_pos,
            "E": None if seen is None else round(seen.error_ratio, 6),
            **{name: None if seen is None else getattr(seen, name) for name in counts},
            "verdict": self.verdict,
            "mode": self.mode,
            "reason": self.reason,
            "objects": list(self.objects),
            "limit": None if self.limit is None else round(self.limit, 6),
            "calibration_error_px": None if self.fit is None else round(self.fit.error_px, 2),
            "calibration": "" if self.fit is None else self.fit.told,
            "ms": round(self.ms, 2),
        }


@dataclass(frozen=True, eq=False)
class Pictures:
    """What a check looked at, for people: frame (H, W, 3) uint8 BGR; masks (H, W) uint8, 0 or 255, in its pixels."""

    frame: np.ndarray
    observed: np.ndarray
    expected: np.ndarray
    ignored: np.ndarray


@dataclass(frozen=True)
class Summary:
    """What a whole print came to: the last line of a replay."""

    checks: int
    first_suspect_layer: int | None
    first_failed_layer: int | None
    mode: str | None
    failed_objects: tuple[str, ...]
    action: str
    ms_p50: float
    ms_p95: float

    @classmethod
    def of(cls, checks: list[Check], action_when_failed: str = "pause") -> Summary:
        failed = next((check for check in checks if check.verdict == FAILED), None)
        suspect = next((check for check in checks if check.verdict in ("suspect", FAILED)), None)
        times_ms = np.array([check.ms for check in checks] or [0.0])
        return cls(
            checks=len(checks),
            first_suspect_layer=suspect.moment.layer if suspect else None,
            first_failed_layer=failed.moment.layer if failed else None,
            mode=failed.mode if failed else None,
            failed_objects=tuple(o["name"] for o in failed.objects if o["verdict"] == FAILED) if failed else (),
            action=action_when_failed if failed else "none",
            ms_p50=round(float(np.percentile(times_ms, 50)), 2),
            ms_p95=round(float(np.percentile(times_ms, 95)), 2),
        )

    def to_json(self) -> dict[str, Any]:
        return {"type": "summary", **self.__dict__, "failed_objects": list(self.failed_objects)}
