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
from .decision.compare import Comparison, compare
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
from .view.view import MOVED_PX, SteadyFrame, View, moved_sentence
from .view.window import Window

NEAR_PX = 16  # how far about all that is expected and seen edges are looked for, and a little more
LEARN_AT_FIRST, LEARN_EVERY = 6, 4  # good checks
HIDDEN_CHECKS = 5  # in a row, that matter may seem to be hidden by something too small to be seen as an obstacle


@dataclass(eq=False)
class _Watched:
    """What was learned of this print through one camera.

    good_laid     : beads that lay at the last good check
    hidden_checks : so many in a row in which matter seemed to be hidden
    told_apart    : whether filament and bed have once been told from one another
    judged        : the last look that could be
    """

    view: View
    good_checks: int = 0
    good_laid: int = 0
    hidden_checks: int = 0
    told_apart: bool = False
    judged: tuple[Moment, Findings] | None = None

    def accept(self) -> None:
        """What was last seen through it is how the print looks from now on."""
        if self.judged is not None:
            moment, findings = self.judged
            memory = self.view.memory(moment)
            memory.accept(findings.window, findings.wanted, findings.look, findings.seen, findings.stray)


@dataclass(frozen=True, eq=False)
class _Compared:
    """E, counted in the picture's own pixels, where there is anything to count: in the window `close`, uint8."""

    comparison: Comparison
    close: Window
    expected: Expected
    observed: np.ndarray
    ignored: np.ndarray

    @classmethod
    def of(cls, steady: SteadyFrame, observed: np.ndarray, ignored: np.ndarray) -> _Compared:
        near = box_about(steady.expected.complete | observed, NEAR_PX)
        close = steady.window.within(*near)
        expected = close.sharp().expected(steady.whole)
        sharp_observed, sharp_ignored = close.enlarged(observed[near]), close.enlarged(ignored[near])
        comparison = compare(expected.mask, sharp_observed, close.cut(steady.whole.complete), sharp_ignored)
        comparison = replace(comparison, ignored_px=cv2.countNonZero(ignored) * steady.window.step**2)
        return cls(comparison, close.sharp(), expected, sharp_observed, sharp_ignored)


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
        self._watched: dict[str | None, _Watched] = {}
        self._courses = Courses(settings.sensitivity)
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
        return self._through(moment.camera).view.take_reference(frame_bgr, moment)

    def draw_ahead(self) -> None:
        """Draw what the first camera's first look will need: some seconds for millions of beads, which need not pass
        while a printer waits. Raises RenderError."""
        if len(self._toolpath):
            self._through(None).view.draw_ahead()

    def accept(self) -> None:
        """The user goes on with the print as it is: what the last check saw is the new baseline, only what changes
        from there on is a failure."""
        self._begin_anew(accept)

    def pardon(self) -> None:
        """The user says that it was no failure: as `accept`, and what looked like one is less easily surprising."""
        self._begin_anew(pardon)

    def _begin_anew(self, of: Callable[[Track], Track]) -> None:
        self.learn()
        for watched in self._watched.values():
            watched.accept()
        self._courses.begin_anew(of)

    def expected(self, moment: Moment) -> Expected:
        """What must be seen at that moment, by that moment's camera, in the frame's own pixels."""
        self.learn()
        return self._through(moment.camera).view.expected(moment)

    def camera(self, moment: Moment) -> Camera:
        """The camera of that moment as this print has shown it to stand: the header's, corrected where that was safe."""
        self.learn()
        return self._through(moment.camera).view.selfcheck.camera

    def check(self, frame_bgr: np.ndarray, moment: Moment) -> Check:
        """Compare one frame with what must be seen. A frame that cannot be used is a verdict, not an error.

        Raises RenderError where the expected mask cannot be drawn.
        """
        self.learn()
        began_s = time.perf_counter()
        self._shown = None
        check = self._check(frame_bgr, moment)
        return replace(
            check, ms=(time.perf_counter() - began_s) * 1000, fit=self._through(moment.camera).view.selfcheck.fit
        )

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
        watched = self._through(moment.camera)
        view = watched.view
        try:
            steady = view.steady(frame_bgr, moment)
        except FrameError as error:
            return self._blind(Look(blind=UNUSABLE, reason=str(error)), moment)
        if steady.moved:
            return self._blind(Look(blind=CAMERA_MOVED, reason=steady.moved), moment)
        window, expected = steady.window, steady.expected
        seen = view.observe(steady, moment)
        observed = seen.mask
        head, lies, doubtful = expected.volume, None, None
        hidden, foreign = view.occluded(steady, observed)
        if head is not None:
            lies, doubtful = view.clearance.behind(window, moment.position_mm, observed, expected.mask, head)
        ignored = union(seen.unsure, steady.outside, hidden, foreign, doubtful, expected.ignored)
        self._shown = lambda: Pictures(
            steady.picture(), window.placed(observed), steady.whole.mask, window.placed(ignored)
        )  # fmt: skip
        compared = _Compared.of(steady, observed, ignored)
        comparison = compared.comparison
        why = blocked(expected, hidden, foreign, doubtful, seen.unsure, comparison)
        if why:
            return self._blind(Look(comparison, UNUSABLE, why), moment)
        view.accept(steady)
        memory = view.memory(moment)
        if steady.turned and steady.sure:
            memory.misfit.turn_is_found()
        laid, layer = watched.good_laid, self._toolpath.layer_at(moment.file_pos)
        finer = max(1.0, window.size_px[0] / 640) / window.step
        tolerance_px = view.selfcheck.band_px(TOLERANCE_PX * finer * window.step) / window.step
        sight = Sight(
            steady.frame, observed, ignored, expected, view.print_map(moment), layer, tolerance_px, finer,
            lambda: view.laid_px(moment, laid) / window.step**2, steady.sure,
        )  # fmt: skip
        findings = find(sight, memory)
        watched.hidden_checks = watched.hidden_checks + 1 if seems_hidden(findings) else 0
        if 0 < watched.hidden_checks <= HIDDEN_CHECKS:
            alike = findings.untold_px >= findings.hidden_px and not_seen_px(findings, memory) > 0
            return self._blind(Look(comparison, UNUSABLE, ALIKE if alike else HIDDEN), moment)
        if findings.moved_px > MOVED_PX * finer:
            sentence = moved_sentence(findings.moved_px * window.step)
            return self._blind(Look(comparison, CAMERA_MOVED, sentence), moment)
        watched.told_apart = watched.told_apart or tells_apart(findings, memory, tolerance_px)
        if not watched.told_apart:
            view.learn(steady, moment, seen)
            return self._blind(Look(comparison, UNUSABLE, ALIKE), moment)
        if unseen_and_unmissed(findings, memory):
            return self._blind(Look(comparison, UNUSABLE, ALIKE), moment)
        watched.judged = moment, findings
        memory.keep_loose(findings.window, findings.loose, findings.seen, findings.known)

        def name(ruling: Ruling) -> dict[int, Diagnosis]:
            naming = Naming(findings, sight, view.place(moment))
            return {outcome.object_id: naming.name(outcome) for outcome in ruling.outcomes if outcome.verdict != OK}

        would_tell = expected.mask if doubtful is None else expected.mask & cv2.bitwise_not(doubtful)
        little = HEAD_HIDES if little_of(would_tell, expected.mask) else ""
        look = Look(comparison, scopes=findings.scopes, little=little, turned=steady.turned)
        self.look, ruling = self._courses.rule(look, moment, name)
        assert ruling is not None

        def lesson() -> None:
            watched.good_laid = self._toolpath.laid_at(moment.file_pos)
            if head is not None and lies is not None:
                near, bed = findings.window, np.zeros_like(head)
                bed[near] = memory.shows_bed(near, findings.look, head[near] & ~observed[near])
                view.clearance.learn(window, moment.position_mm, lies & head, bed)
            doubtful = findings.lost | findings.stray
            memory.learn(findings.window, findings.wanted, findings.look, findings.seen, findings.known, doubtful)
            watched.good_checks += 1
            # what a print looks like changes slowly: learning it anew at every layer would cost more than looking
            if watched.good_checks <= LEARN_AT_FIRST or watched.good_checks % LEARN_EVERY == 0:
                view.learn(steady, moment, seen)
            view.check_calibration(moment, compared.close, compared.expected, compared.observed, compared.ignored)

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

    def _through(self, camera: str | None) -> _Watched:
        if camera not in self._watched:
            first = camera is None or camera == self._header.cameras[0][0]
            view = View(
                self._header.camera(camera), self._header.printer, self._toolpath, self._renderer,
                self._header.material, self._settings.segmentation, self._reference_bgr if first else None,
                self._head(), self._header.reference_mm,
            )  # fmt: skip
            self._watched[camera] = _Watched(view)
        return self._watched[camera]


def conclude(looks: Iterable[tuple[Look, Moment]], sensitivity: str, objects: Sequence[str]) -> Iterator[Check]:
    """The checks that an Inspector of that sensitivity would have made of looks, in time order, without their pictures.

    The looks must have been named wherever this sensitivity suspects anything, as those of a more sensitive one are.
    objects : the labelled objects' names
    """
    courses = Courses(sensitivity)
    for look, moment in looks:
        yield Check.of(moment, *courses.rule(look, moment), objects)
