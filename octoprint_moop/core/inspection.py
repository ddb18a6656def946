"""The flow on one page: frame and moment in, check out. The live plugin and the replay both come through here."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from statistics import median
from typing import Any, Callable

import cv2
import numpy as np

from .decision.compare import Comparison, compare
from .decision.decide import (
    CAMERA_MOVED,
    FAILED,
    GOOD_CHECKS,
    OK,
    SUSPECT,
    UNUSABLE,
    Outcome,
    Track,
    accept,
    blame,
    judge,
    learn,
    matter_limit,
    pardon,
)
from .decision.diagnose import Diagnosis, diagnose
from .decision.evidence import WHOLE, Findings, Sight, find
from .errors import FrameError, SegmentationError
from .expected.hardware import HeadModel
from .expected.views import Expected, MaskRenderer
from .header import Header, Moment
from .settings import Settings
from .toolpath import Toolpath
from .view.view import View

# what calibration and segmentation may be off without a word; JPEG alone blurs colours by as much, however small the picture
TOLERANCE_PX = 2.0  # at up to 640 pixels across
LEARN_AT_FIRST, LEARN_EVERY = 6, 4  # good checks
HIDDEN_RATIO = 0.004  # of the complete print, that nothing but an obstacle explains
HIDDEN = "Something stands in the view: a hand, or a tool?"
MOST_HIDDEN_RATIO, MOST_UNSURE_RATIO = 0.6, 0.4  # of the expected mask, to judge from the rest
SEVERITY = {OK: 0, SUSPECT: 1, FAILED: 2}


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
            "ms": round(self.ms, 2),
        }


@dataclass(frozen=True, eq=False)
class Pictures:
    """What a check looked at, for people: frame (H, W, 3) uint8 BGR; masks (H, W) uint8, 0 or 255, in its pixels."""

    frame: np.ndarray
    observed: np.ndarray
    expected: np.ndarray
    ignored: np.ndarray


@dataclass
class _Past:
    """What one camera has seen of this print so far; two cameras see two different usual errors."""

    tracks: dict[int, Track] = field(default_factory=dict)
    good_checks: int = 0
    good_errors: tuple[float, ...] = ()
    failed_scopes: set[int] = field(default_factory=set)
    last: tuple[View, Moment, Sight, Findings] | None = None  # the last check that was judged


class Inspector:
    """Looks at one print, frame by frame, in time order. Keeps what it learned of this print so far."""

    def __init__(
        self,
        header: Header,
        toolpath: Toolpath,
        renderer: MaskRenderer,
        settings: Settings = Settings(),
        reference_bgr: np.ndarray | None = None,
    ) -> None:
        if header.material is None and settings.segmentation == "thresholds":
            raise SegmentationError("The filament's colour is not set. Click on it in the set-up.")
        self._header, self._toolpath, self._renderer = header, toolpath, renderer
        self._settings = settings
        self._reference_bgr = reference_bgr
        self._views: dict[str | None, View] = {}
        self._pasts: dict[str | None, _Past] = {}
        self.pictures: Pictures | None = None

    def accept(self) -> None:
        """The user goes on with the print as it is: what the last check saw is the new baseline, only what changes
        from there on is a failure."""
        self._begin_anew(accept)

    def pardon(self) -> None:
        """The user says that it was no failure: as `accept`, and what looked like one is less easily surprising."""
        self._begin_anew(pardon)

    def _begin_anew(self, of: Callable[[Track], Track]) -> None:
        for past in self._pasts.values():
            if past.last is None:
                continue
            view, moment, sight, findings = past.last
            view.memory(moment).accept(findings.window, findings.wanted, sight.frame_bgr, sight.observed)
            failed = past.failed_scopes or set(past.tracks)
            past.tracks = {
                scope: of(track) if scope in failed else accept(track) for scope, track in past.tracks.items()
            }
            past.failed_scopes = set()

    def expected(self, moment: Moment) -> Expected:
        """What must be seen at that moment, by that moment's camera, in the frame's own pixels."""
        return self._view(moment).expected(moment)

    def check(self, frame_bgr: np.ndarray, moment: Moment) -> Check:
        """Compare one frame with what must be seen. A frame that cannot be used is a verdict, not an error.

        Raises RenderError where the expected mask cannot be drawn.
        """
        began_s = time.perf_counter()
        check = self._check(frame_bgr, moment)
        return replace(check, ms=(time.perf_counter() - began_s) * 1000)

    def _check(self, frame_bgr: np.ndarray, moment: Moment) -> Check:
        view = self._view(moment)
        try:
            steady = view.steady(frame_bgr, moment)
        except FrameError as error:
            return Check(moment, UNUSABLE, reason=str(error))
        if steady.moved:
            return Check(moment, CAMERA_MOVED, reason=steady.moved)
        expected = view.expected(moment)
        seen = view.observe(steady, expected)
        observed = seen.mask
        hidden = view.occluded(steady, observed | expected.mask | expected.ignored | expected.head)
        # within the head's reach what shines like filament may be a nozzle: only matter in its place counts there
        doubtful = expected.head & cv2.bitwise_not(observed & expected.mask)
        ignored = steady.outside | hidden | doubtful | seen.unsure | expected.ignored
        comparison = compare(expected.mask, observed, expected.complete, ignored)
        self.pictures = Pictures(steady.frame, observed, expected.mask, ignored)
        blocked = self._blocked(expected, hidden, doubtful, seen.unsure)
        if blocked:
            return Check(moment, UNUSABLE, comparison, reason=blocked)
        view.accept(steady)
        check = self._judge(view, moment, steady.frame, expected, observed, ignored, comparison)
        if check.verdict == OK:
            past = self._past(moment)
            past.good_checks += 1
            # what a print looks like changes slowly: learning it anew at every layer would cost more than looking
            if past.good_checks <= LEARN_AT_FIRST or past.good_checks % LEARN_EVERY == 0:
                view.learn(steady, expected, seen)
        return check

    @staticmethod
    def _blocked(expected: Expected, hidden: np.ndarray, doubtful: np.ndarray, unsure: np.ndarray) -> str:
        """Why too little of the print is seen to judge it; "" where enough is.

        A head that stands over the print hides what it hides; anything else that does is somebody's hand.
        """
        if hidden.any():
            return HIDDEN
        wanted = max(cv2.countNonZero(expected.mask), 1)
        if cv2.countNonZero(expected.mask & (doubtful | expected.ignored)) > MOST_HIDDEN_RATIO * wanted:
            return "The print head hides the print. Let it park for the picture."
        if cv2.countNonZero(expected.mask & unsure) > MOST_UNSURE_RATIO * wanted:
            return "Filament and bed look alike here: more light, or a bed of another colour, would help."
        return ""

    def _judge(
        self, view: View, moment: Moment, frame_bgr: np.ndarray, expected: Expected, observed: np.ndarray,
        ignored: np.ndarray, comparison: Comparison,
    ) -> Check:  # fmt: skip
        """Weigh what differs, for the whole print and for each object, and learn from it where all is well."""
        memory = view.memory(moment)
        layer = self._toolpath.layer_at(moment.file_pos)
        tolerance_px = TOLERANCE_PX * max(1.0, observed.shape[1] / 640)
        sight = Sight(frame_bgr, observed, ignored, expected, view.print_map(moment), layer, tolerance_px)
        findings = find(sight, memory)
        if findings.hidden_px > max(HIDDEN_RATIO * findings.whole.total_px, 0.5 * findings.whole.lost_px):
            return Check(moment, UNUSABLE, comparison, reason=HIDDEN)
        past = self._past(moment)
        past.last = (view, moment, sight, findings)
        outcomes = []
        for evidence in findings.scopes:
            track = past.tracks.get(evidence.object_id, Track())
            outcome, past.tracks[evidence.object_id] = judge(track, evidence, self._settings.sensitivity)
            outcomes.append(outcome)
        outcomes = blame(outcomes)
        worst = max(outcomes, key=_weight)
        past.failed_scopes |= {outcome.object_id for outcome in outcomes if outcome.verdict == FAILED}
        if worst.verdict == OK:
            memory.learn(findings.window, findings.wanted, frame_bgr, observed, ignored)
            for evidence in findings.scopes:
                past.tracks[evidence.object_id] = learn(past.tracks[evidence.object_id], evidence)
        diagnoses = {
            outcome.object_id: diagnose(outcome, findings, sight, view.place(moment))
            for outcome in outcomes
            if outcome.verdict != OK
        }
        objects = [
            {
                "name": self._toolpath.objects[outcome.object_id],
                "E": round(evidence.error_ratio, 6),
                "verdict": outcome.verdict,
                "mode": diagnoses[outcome.object_id].mode if outcome.verdict == FAILED else None,
            }
            for evidence, outcome in zip(findings.scopes[1:], outcomes[1:])
        ]
        named = diagnoses.get(worst.object_id)
        return Check(
            moment,
            worst.verdict,
            comparison,
            limit=self._limit(past, comparison, worst.verdict),
            mode=named.mode if named and worst.verdict == FAILED else None,
            reason=self._sentence(worst, named),
            objects=tuple(objects),
        )

    def _limit(self, past: _Past, comparison: Comparison, verdict: str) -> float:
        """The E that is usual in this print, its spread, and as much lost or stray matter as is tolerated.

        For the plot: the decision weighs pixels and does not ask for E itself.
        """
        errors = past.good_errors or (comparison.error_ratio,)
        usual = median(errors)
        spread = 1.4826 * median(abs(error - usual) for error in errors) if len(errors) >= 5 else 0.0
        if verdict == OK:
            past.good_errors = (*past.good_errors, comparison.error_ratio)[-GOOD_CHECKS:]
        track = past.tracks.get(WHOLE, Track())
        return usual + 3 * spread + matter_limit(track, comparison.total_px, self._settings.sensitivity)

    def _sentence(self, worst: Outcome, named: Diagnosis | None) -> str:
        if named is None:
            return ""
        who = f"{self._toolpath.objects[worst.object_id]}: " if worst.object_id >= 0 else ""
        return who + named.sentence

    def _past(self, moment: Moment) -> _Past:
        return self._pasts.setdefault(moment.camera, _Past())

    def _view(self, moment: Moment) -> View:
        if moment.camera not in self._views:
            first = moment.camera is None or moment.camera == self._header.cameras[0][0]
            self._views[moment.camera] = View(
                self._header.camera(moment.camera), self._header.printer, self._toolpath, self._renderer,
                self._header.material, self._settings.segmentation, self._reference_bgr if first else None,
                HeadModel.from_text(self._settings.head, self._header.printer.width_mm),
            )  # fmt: skip
        return self._views[moment.camera]


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


def _weight(outcome: Outcome) -> tuple[int, bool, float]:
    """Which outcome speaks for the check: the worst, an object's before the whole's, the most surprising first."""
    return SEVERITY[outcome.verdict], outcome.object_id >= 0, outcome.leading.size
