"""The flow on one page: frame and moment in, check out. The live plugin and the replay both come through here."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Callable

import cv2
import numpy as np

from .calibration.selfcheck import Fit
from .camera import Camera
from .decision.compare import Comparison, compare
from .decision.course import Courses, Look, Ruling
from .decision.decide import CAMERA_MOVED, FAILED, OK, UNUSABLE, Track, accept, pardon
from .decision.diagnose import Diagnosis, diagnose
from .decision.evidence import TOLERANCE_PX, Findings, Sight, find
from .decision.memory import Memory
from .decision.spots import disc
from .errors import FrameError, SegmentationError
from .expected.views import Expected, MaskRenderer, box_about
from .head import HeadModel
from .header import Header, Moment
from .settings import Settings
from .toolpath import Toolpath
from .view.clearance import in_place
from .view.view import MOVED_PX, View, moved_sentence

NEAR_PX = 16  # how far about all that is expected and seen edges are looked for, and a little more
LEARN_AT_FIRST, LEARN_EVERY = 6, 4  # good checks
HIDDEN_RATIO = 0.004  # of the complete print, that nothing but an obstacle explains
HIDDEN_CHECKS = 5  # in a row, that matter may seem to be hidden by something too small to be seen as an obstacle
HIDDEN = "Something stands in the view: a hand, or a tool?"
HEAD_HIDES = "The print head hides the print. Let it park for the picture."
ALIKE = "Filament and bed look alike here: more light, or a bed of another colour, would help."
UNLIKE = (
    "The print is seen badly: so much of the picture is not as expected, good as it may be, that little could be told from it. "
    "Calibrate the camera anew, see that the lamp lights the print, or clear away what has the filament's colour."
)
BADLY_SEEN = (
    0.25  # the E that is usual, though nothing is wrong: of so little that is right no one would tell what fails
)
SEEN_LEAST, EXTRA_MOST = 0.4, 1.0  # of what must be seen; until a check was within both, there is nothing to go by
MISSED_RATIO = 0.1  # of what is not seen; where less is known to be missing or out of place, the rest may be there
DRIFT_LEAST = 4.0  # grey levels by which a place where nothing came has not changed
FLOODED = 1.5  # times the complete print: so much too much matter is no print's but the bed taken for filament
LEAST_TELLING_RATIO = 0.3  # of the expected mask, that could be missed were it gone, to say that all is well
MOST_HIDDEN_RATIO, MOST_UNSURE_RATIO = 0.6, 0.4  # of the expected mask, to judge from the rest


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


@dataclass(frozen=True, eq=False)
class _Seen:
    """A frame that can be judged, and what was found in it."""

    view: View
    moment: Moment
    findings: Findings


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
        self._courses = Courses(settings.sensitivity)
        self._seen: dict[str | None, _Seen] = {}
        self._good_checks: dict[str | None, int] = {}
        self._good_laid: dict[str | None, int] = {}
        self._hidden_checks: dict[str | None, int] = {}
        self._told_apart: set[str | None] = set()
        self._shown: Callable[[], Pictures] | None = None
        self._lesson: Callable[[], None] | None = None
        self.look: Look | None = None
        """What the last frame showed, whatever the sensitivity; named where it was not ok at this one."""

    @property
    def pictures(self) -> Pictures | None:
        """What the last check looked at; None where nothing could be compared. Made when asked for."""
        return None if self._shown is None else self._shown()

    def take_reference(self, frame_bgr: np.ndarray, moment: Moment) -> bool:
        """Look at the bed just before anything lies on it; to be called before the first check.

        True where this picture is the reference from now on, False where the head hides too much of the print's place.
        Raises FrameError where the picture cannot be used, RenderError where drawing fails.
        """
        return self._view(moment).take_reference(frame_bgr, moment)

    def draw_ahead(self) -> None:
        """Draw what the first camera's first look will need: some seconds for millions of beads, which need not pass
        while a printer waits. Raises RenderError."""
        if len(self._toolpath):
            self._view(Moment("", 0, 0, (0.0, 0.0, 0.0))).draw_ahead()

    def accept(self) -> None:
        """The user goes on with the print as it is: what the last check saw is the new baseline, only what changes
        from there on is a failure."""
        self._begin_anew(accept)

    def pardon(self) -> None:
        """The user says that it was no failure: as `accept`, and what looked like one is less easily surprising."""
        self._begin_anew(pardon)

    def _begin_anew(self, of: Callable[[Track], Track]) -> None:
        self.learn()
        for seen in self._seen.values():
            findings = seen.findings
            memory = seen.view.memory(seen.moment)
            memory.accept(findings.window, findings.wanted, findings.look, findings.seen, findings.stray)
        self._courses.begin_anew(of)

    def expected(self, moment: Moment) -> Expected:
        """What must be seen at that moment, by that moment's camera, in the frame's own pixels."""
        self.learn()
        return self._view(moment).expected(moment)

    def camera(self, moment: Moment) -> Camera:
        """The camera of that moment as this print has shown it to stand: the header's, corrected where that was safe."""
        self.learn()
        return self._view(moment).selfcheck.camera

    def check(self, frame_bgr: np.ndarray, moment: Moment) -> Check:
        """Compare one frame with what must be seen. A frame that cannot be used is a verdict, not an error.

        Raises RenderError where the expected mask cannot be drawn.
        """
        self.learn()
        began_s = time.perf_counter()
        self._shown = None
        check = self._check(frame_bgr, moment)
        return replace(check, ms=(time.perf_counter() - began_s) * 1000, fit=self._view(moment).selfcheck.fit)

    def learn(self) -> None:
        """Take in what the last check has taught: no printer need wait for that. Whatever is asked next does it first, where
        nobody has. Raises RenderError where drawing fails.
        """
        lesson, self._lesson = self._lesson, None
        if lesson is not None:
            lesson()

    def confirm(self, frame_bgr: np.ndarray, moment: Moment) -> Check:
        """A second look at what the last check judged: another frame of the same print in the same hold.

        It takes the last check's place and counts no second time. What only passed by is taken back; what both
        frames show is a failure sooner than what one has shown. Where this frame cannot be used the last check stands,
        but for a failure, which is suspect until the next layer tells. Raises RenderError as `check`.
        """
        return self.check(frame_bgr, replace(moment, again=True))

    def _check(self, frame_bgr: np.ndarray, moment: Moment) -> Check:
        view = self._view(moment)
        try:
            steady = view.steady(frame_bgr, moment)
        except FrameError as error:
            return self._blind(Look(blind=UNUSABLE, reason=str(error)), moment)
        if steady.moved:
            return self._blind(Look(blind=CAMERA_MOVED, reason=steady.moved), moment)
        window, expected = steady.window, steady.expected
        seen = view.observe(steady, moment)
        observed = seen.mask
        head, doubtful, would_tell = expected.volume, None, expected.mask
        hidden = view.occluded(steady, _union(observed, expected.mask, expected.ignored, head))
        if head is not None:
            lies = in_place(observed, expected.mask, head)
            matter, either = view.clearance.free(window, moment.position_mm, head)
            doubtful = head & cv2.bitwise_not(lies | matter | (either & cv2.bitwise_not(expected.mask)))
            would_tell = expected.mask & cv2.bitwise_not(doubtful)
        ignored = _union(seen.unsure, steady.outside, hidden, doubtful, expected.ignored)
        self._shown = lambda: Pictures(
            steady.picture(), window.placed(observed), steady.whole.mask, window.placed(ignored)
        )  # fmt: skip
        # E is counted in the picture's own pixels, where there is anything to count
        near = box_about(expected.complete | observed, NEAR_PX)
        close = window.within(*near)
        sharp, sharp_observed, sharp_ignored = (
            close.sharp().expected(steady.whole), close.enlarged(observed[near]), close.enlarged(ignored[near])
        )  # fmt: skip
        comparison = compare(sharp.mask, sharp_observed, close.cut(steady.whole.complete), sharp_ignored)
        comparison = replace(comparison, ignored_px=cv2.countNonZero(ignored) * window.step**2)
        blocked = self._blocked(expected, hidden, doubtful, seen.unsure)
        if not blocked and comparison.extra_px > FLOODED * comparison.total_px:
            blocked = ALIKE
        if blocked:
            return self._blind(Look(comparison, UNUSABLE, blocked), moment)
        view.accept(steady)
        memory = view.memory(moment)
        layer = self._toolpath.layer_at(moment.file_pos)
        finer = max(1.0, window.size_px[0] / 640) / window.step
        tolerance_px = view.selfcheck.band_px(TOLERANCE_PX * finer * window.step) / window.step
        laid = self._good_laid.get(moment.camera, 0)
        sight = Sight(
            steady.frame, observed, ignored, expected, view.print_map(moment), layer, tolerance_px, finer,
            lambda: view.laid_px(moment, laid) / window.step**2, steady.sure,
        )  # fmt: skip
        findings = find(sight, memory)
        hidden_px = max(findings.hidden_px, findings.untold_px)
        hidden_now = hidden_px > max(HIDDEN_RATIO * findings.whole.total_px, 0.5 * findings.whole.lost_px)
        hidden_before = self._hidden_checks.get(moment.camera, 0)
        self._hidden_checks[moment.camera] = hidden_before + 1 if hidden_now else 0
        if hidden_now and hidden_before < HIDDEN_CHECKS:
            alike = findings.untold_px >= findings.hidden_px and _not_seen_px(findings, memory) > 0
            return self._blind(Look(comparison, UNUSABLE, ALIKE if alike else HIDDEN), moment)
        if findings.moved_px > MOVED_PX * finer:
            sentence = moved_sentence(findings.moved_px * window.step)
            return self._blind(Look(comparison, CAMERA_MOVED, sentence), moment)
        if moment.camera not in self._told_apart:
            if not _tells_apart(findings, memory, tolerance_px):
                view.learn(steady, moment, seen)
                return self._blind(Look(comparison, UNUSABLE, ALIKE), moment)
            self._told_apart.add(moment.camera)
        if _unseen_and_unmissed(findings, memory):
            return self._blind(Look(comparison, UNUSABLE, ALIKE), moment)
        self._seen[moment.camera] = _Seen(view, moment, findings)
        memory.keep_loose(findings.window, findings.loose, findings.seen)

        def name(ruling: Ruling) -> dict[int, Diagnosis]:
            return {
                outcome.object_id: diagnose(outcome, findings, sight, view.place(moment))
                for outcome in ruling.outcomes
                if outcome.verdict != OK
            }

        little = HEAD_HIDES if _little_of(would_tell, expected.mask) else ""
        look = Look(comparison, scopes=findings.scopes, little=little, turned=steady.turned)
        self.look, ruling = self._courses.rule(look, moment, name)
        assert ruling is not None

        def lesson() -> None:
            self._good_laid[moment.camera] = self._toolpath.laid_at(moment.file_pos)
            if head is not None:
                near, bed = findings.window, np.zeros_like(head)
                bed[near] = memory.shows_bed(near, findings.look, head[near] & ~observed[near])
                view.clearance.learn(window, moment.position_mm, lies & head, bed)
            memory.learn(findings.window, findings.wanted, findings.look, findings.seen, findings.known)
            good_checks = self._good_checks[moment.camera] = self._good_checks.get(moment.camera, 0) + 1
            # what a print looks like changes slowly: learning it anew at every layer would cost more than looking
            if good_checks <= LEARN_AT_FIRST or good_checks % LEARN_EVERY == 0:
                view.learn(steady, moment, seen)
            view.check_calibration(moment, close.sharp(), sharp, sharp_observed, sharp_ignored)

        self._lesson = lesson if ruling.teaches else None
        return Check.of(moment, self.look, ruling, self._toolpath.objects)

    def _blind(self, look: Look, moment: Moment) -> Check:
        self.look = look
        shown, ruling = self._courses.rule(look, moment)
        return Check.of(moment, shown, ruling, self._toolpath.objects)

    @staticmethod
    def _blocked(expected: Expected, hidden: np.ndarray | None, doubtful: np.ndarray | None, unsure: np.ndarray) -> str:
        """Why too little of the print is seen to judge it; "" where enough is.

        A head that stands over the print hides what it hides; anything else that does is somebody's hand.
        """
        if hidden is not None:
            return HIDDEN
        wanted = max(cv2.countNonZero(expected.mask), 1)
        told_nothing = [mask for mask in (doubtful, expected.ignored) if mask is not None]
        if told_nothing and cv2.countNonZero(expected.mask & _union(*told_nothing)) > MOST_HIDDEN_RATIO * wanted:
            return HEAD_HIDES
        if cv2.countNonZero(expected.mask & unsure) > MOST_UNSURE_RATIO * wanted:
            return ALIKE
        return ""

    def _head(self) -> HeadModel:
        """The printer's own, else that of the settings, else a common one."""
        printer = self._header.printer
        return printer.head or HeadModel.from_text(self._settings.head, printer.width_mm, printer.bed_low_mm[0])

    def _view(self, moment: Moment) -> View:
        if moment.camera not in self._views:
            first = moment.camera is None or moment.camera == self._header.cameras[0][0]
            self._views[moment.camera] = View(
                self._header.camera(moment.camera), self._header.printer, self._toolpath, self._renderer,
                self._header.material, self._settings.segmentation, self._reference_bgr if first else None,
                self._head(), self._header.reference_mm,
            )  # fmt: skip
        return self._views[moment.camera]


def conclude(looks: Iterable[tuple[Look, Moment]], sensitivity: str, objects: Sequence[str]) -> Iterator[Check]:
    """The checks that an Inspector of that sensitivity would have made of looks, in time order, without their pictures.

    The looks must have been named wherever this sensitivity suspects anything, as those of a more sensitive one are.
    objects : the labelled objects' names
    """
    courses = Courses(sensitivity)
    for look, moment in looks:
        yield Check.of(moment, *courses.rule(look, moment), objects)


def _union(mask: np.ndarray, *others: np.ndarray | None) -> np.ndarray:
    """uint8: the first mask and the others, of which None stands for an empty one."""
    for other in others:
        if other is not None:
            mask = mask | other
    return mask


def _little_of(part: np.ndarray, whole: np.ndarray) -> bool:
    """Whether so little of the expected mask could be missed that seeing nothing wrong says nothing."""
    return cv2.countNonZero(part) < LEAST_TELLING_RATIO * cv2.countNonZero(whole)


def _tells_apart(findings: Findings, memory: Memory, tolerance_px: float) -> bool:
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


def _not_seen_px(findings: Findings, memory: Memory) -> int:
    """How many pixels of what must be seen are not, where those are most; else 0."""
    wanted = findings.wanted & findings.known & ~memory.given_up(findings.window)
    wanted_px, seen_px = np.count_nonzero(wanted), np.count_nonzero(wanted & findings.seen)
    return int(wanted_px - seen_px) if seen_px < SEEN_LEAST * wanted_px else 0


def _unseen_and_unmissed(findings: Findings, memory: Memory) -> bool:
    """Whether most of what must be seen is not, and yet nothing tells that it is not there: then nothing is known of it."""
    whole = findings.whole
    missed_px = whole.lost_px + whole.stray_px + whole.unseen_px + whole.barren_px
    return missed_px < MISSED_RATIO * _not_seen_px(findings, memory)


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
