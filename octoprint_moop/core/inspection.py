"""The flow on one page: frame and moment in, check out. The live plugin and the replay both come through here."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Callable

import cv2
import numpy as np

from .camera import Camera
from .checks import Check, Pictures
from .decision.compare import compare
from .decision.course import Courses, Look, Ruling
from .decision.decide import CAMERA_MOVED, OK, UNUSABLE, Track, accept, pardon
from .decision.diagnose import Diagnosis, Naming
from .decision.evidence import TOLERANCE_PX, find
from .decision.findings import Findings, Sight
from .decision.telling import (
    ALIKE,
    HEAD_HIDES,
    HIDDEN,
    blocked,
    little_of,
    not_seen_px,
    seems_hidden,
    tells_apart,
    union,
    unseen_and_unmissed,
)
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
HIDDEN_CHECKS = 5  # in a row, that matter may seem to be hidden by something too small to be seen as an obstacle


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
        hidden, foreign = view.occluded(steady, observed)
        if head is not None:
            lies = in_place(observed, expected.mask, head)
            matter, either = view.clearance.free(window, moment.position_mm, head)
            doubtful = head & cv2.bitwise_not(lies | matter | (either & cv2.bitwise_not(expected.mask)))
            would_tell = expected.mask & cv2.bitwise_not(doubtful)
        ignored = union(seen.unsure, steady.outside, hidden, foreign, doubtful, expected.ignored)
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
        why = blocked(expected, hidden, foreign, doubtful, seen.unsure, comparison)
        if why:
            return self._blind(Look(comparison, UNUSABLE, why), moment)
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
        hidden_now = seems_hidden(findings)
        hidden_before = self._hidden_checks.get(moment.camera, 0)
        self._hidden_checks[moment.camera] = hidden_before + 1 if hidden_now else 0
        if hidden_now and hidden_before < HIDDEN_CHECKS:
            alike = findings.untold_px >= findings.hidden_px and not_seen_px(findings, memory) > 0
            return self._blind(Look(comparison, UNUSABLE, ALIKE if alike else HIDDEN), moment)
        if findings.moved_px > MOVED_PX * finer:
            sentence = moved_sentence(findings.moved_px * window.step)
            return self._blind(Look(comparison, CAMERA_MOVED, sentence), moment)
        if moment.camera not in self._told_apart:
            if not tells_apart(findings, memory, tolerance_px):
                view.learn(steady, moment, seen)
                return self._blind(Look(comparison, UNUSABLE, ALIKE), moment)
            self._told_apart.add(moment.camera)
        if unseen_and_unmissed(findings, memory):
            return self._blind(Look(comparison, UNUSABLE, ALIKE), moment)
        self._seen[moment.camera] = _Seen(view, moment, findings)
        memory.keep_loose(findings.window, findings.loose, findings.seen, findings.known)

        def name(ruling: Ruling) -> dict[int, Diagnosis]:
            naming = Naming(findings, sight, view.place(moment))
            return {outcome.object_id: naming.name(outcome) for outcome in ruling.outcomes if outcome.verdict != OK}

        little = HEAD_HIDES if little_of(would_tell, expected.mask) else ""
        look = Look(comparison, scopes=findings.scopes, little=little, turned=steady.turned)
        self.look, ruling = self._courses.rule(look, moment, name)
        assert ruling is not None

        def lesson() -> None:
            self._good_laid[moment.camera] = self._toolpath.laid_at(moment.file_pos)
            if head is not None:
                near, bed = findings.window, np.zeros_like(head)
                bed[near] = memory.shows_bed(near, findings.look, head[near] & ~observed[near])
                view.clearance.learn(window, moment.position_mm, lies & head, bed)
            doubtful = findings.lost | findings.stray
            memory.learn(findings.window, findings.wanted, findings.look, findings.seen, findings.known, doubtful)
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
