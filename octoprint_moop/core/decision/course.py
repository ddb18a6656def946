"""The course of one print before one camera: what each frame showed, what was concluded, what was learned from it.

What a frame shows (`Look`), and whether it teaches what is usual, does not depend on the sensitivity that the user
chose: a frame teaches where the rule at medium sensitivity finds nothing in it. So looks can be kept, and concluded from
again with another sensitivity, without a picture being looked at.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from statistics import median
from typing import Any, Callable

from ..header import Moment
from .compare import Comparison
from .counts import WHOLE, Evidence, Windows
from .decide import (
    CAMERA_MOVED,
    CONFIRMED,
    DECISIVE,
    FAILED,
    FRESH_CHECKS,
    GOOD_CHECKS,
    OK,
    SUSPECT,
    Outcome,
    Track,
    accept,
    accounts,
    blame,
    judge,
    learn,
    matter_limit,
    seen_from_elsewhere,
)
from .diagnose import Diagnosis

TEACHES = "medium"  # a frame in which the rule finds nothing at this sensitivity teaches what is usual
SEVERITY = {OK: 0, SUSPECT: 1, FAILED: 2}
RECENT_LOOKS = 10
MOST_STRANGE = 5  # in a row; what stands before a camera goes away
MOST_BLIND = 5  # of the recent looks; what spoils more of them spoils the others too, and less plainly


@dataclass(frozen=True)
class Look:
    """What one frame showed, before anyone asks how much of it is too much.

    blind  : `unusable` or `camera_moved` where it could not be judged, with the reason; "" where it could
    scopes : the evidence of the whole (first) and of each object; empty where blind
    names  : what the failure would be called, by object, for each scope that may be asked
    little : why nothing wrong would mean nothing, where so little is seen that a failure need not show; "" where it would
    turned : the camera was just found to stand elsewhere than in the frame before: no failure follows from this one alone
    """

    comparison: Comparison | None = None
    blind: str = ""
    reason: str = ""
    scopes: tuple[Evidence, ...] = ()
    names: Mapping[int, Diagnosis] = field(default_factory=dict)
    little: str = ""
    turned: bool = False

    def to_json(self) -> dict[str, Any]:
        return {
            "comparison": None if self.comparison is None else asdict(self.comparison),
            "blind": self.blind,
            "reason": self.reason,
            "scopes": [asdict(scope) for scope in self.scopes],
            "names": [[number, name.mode, name.sentence] for number, name in self.names.items()],
            "little": self.little,
            "turned": self.turned,
        }

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Look:
        """Raises KeyError, TypeError or ValueError where this is none."""
        return cls(
            None if data["comparison"] is None else Comparison(**data["comparison"]),
            str(data["blind"]),
            str(data["reason"]),
            tuple(
                Evidence(
                    **{**scope, **{name: tuple((new, seen) for new, seen in scope[name]) for name in ("fresh", "come")}}
                )
                for scope in data["scopes"]
            ),
            {int(number): Diagnosis(mode, sentence) for number, mode, sentence in data["names"]},
            str(data["little"]),
            bool(data["turned"]),
        )


@dataclass(frozen=True)
class Ruling:
    """The verdicts that follow from a look, the whole's first.

    worst   : the outcome that speaks for the check
    limit   : the E that is usual, its spread, and as much matter out of place as is tolerated: for the plot, since the
    decision weighs pixels and does not ask for E itself
    teaches : all is well, and this was not known of this layer yet
    unlike  : the E, once the misfit is taken out, of checks in which all was well; 0 until enough have told
    """

    outcomes: tuple[Outcome, ...]
    worst: Outcome
    limit: float
    teaches: bool
    unlike: float = 0.0


@dataclass(frozen=True)
class _State:
    tracks: Mapping[int, Track] = field(default_factory=dict)
    errors: tuple[float, ...] = ()
    failed: frozenset[int] = frozenset()


class Course:
    """Looks go in, in time order; rulings come out."""

    def __init__(self, sensitivity: str) -> None:
        self._sensitivity = sensitivity
        self._state = self._before = _State()
        self._last: tuple[Look, Ruling] | None = None
        self._shaken = False
        self._went_on = False  # the user has, with things out of place: from then on E says nothing of how well is seen
        self._recent_blind: tuple[bool, ...] = ()
        self._strange = 0

    def blind(self, verdict: str) -> None:
        """A look could not be judged, so the next one that can only suspects: the camera that was moved may be looked
        through at a place where it does not stand, what stood in the view may not be quite gone. Where the last one that
        could be judged suspected already, obstacles excuse nothing. Where more of the recent looks could not be judged
        than could, the others only suspect as well.
        """
        self._recent_blind = (*self._recent_blind, True)[-RECENT_LOOKS:]
        suspected = self._last is not None and self._last[1].worst.verdict != OK
        self._shaken |= verdict == CAMERA_MOVED or not suspected

    def rule(self, look: Look, again: bool = False) -> Ruling:
        """What follows from a look in which something could be judged.

        again : a second look at the state that the last one judged. It takes the last one's place: only what both saw
        counts, so that what merely passed by is taken back, and a smaller surprise is enough since it was seen twice.
        """
        known = again and self._last is not None
        if known:
            assert self._last is not None
            self._state = self._before
            look = replace(look, scopes=_in_both(self._last[0].scopes, look.scopes))
        else:
            self._recent_blind = (*self._recent_blind, bool(look.little))[-RECENT_LOOKS:]
        self._before = self._state
        tracks, outcomes, alarmed = dict(self._state.tracks), [], False
        if look.turned:
            tracks = {scope: seen_from_elsewhere(track) for scope, track in tracks.items()}
        quiet = {number for number, track in tracks.items() if track.quiet}
        scopes = tuple(_without_fresh_of(look.scopes, quiet))
        for evidence in scopes:
            track = tracks.get(evidence.object_id, Track())
            outcome, tracks[evidence.object_id], good = self._judge(track, evidence, CONFIRMED if known else DECISIVE)
            outcomes.append(outcome)
            alarmed |= not good
        outcomes = blame(outcomes)
        if look.little:  # the print itself is too little seen to tell where it stands in the picture
            outcomes = [
                one if max(one.size("lost"), one.size("fresh")) >= 1 else _only_suspect(one) for one in outcomes
            ]
        strange = not (self._went_on or accounts(tracks[WHOLE], scopes[0]))
        self._strange = self._strange + (not known) if strange else 0  # a second look counts no second time
        if (strange and self._strange <= MOST_STRANGE) or self._shaken or sum(self._recent_blind) > MOST_BLIND:
            outcomes = [_only_suspect(outcome) for outcome in outcomes]
        self._shaken = False
        worst = max(outcomes, key=_weight)
        failed = self._state.failed | {outcome.object_id for outcome in outcomes if outcome.verdict == FAILED}
        errors = self._state.errors
        limit = self._limit(tracks[WHOLE], look.comparison)
        if not alarmed and not look.little:  # what is hidden shows nothing wrong, and nothing usual
            tracks = {scope.object_id: learn(tracks[scope.object_id], scope) for scope in scopes}
            if look.comparison is not None:
                errors = (*errors, look.comparison.error_ratio)[-GOOD_CHECKS:]
        taught = known and self._last is not None and self._last[1].teaches
        unlike = tracks[WHOLE].unlike
        unlike_ratio = 0.0 if self._went_on or len(unlike) < FRESH_CHECKS else median(unlike)
        ruling = Ruling(tuple(outcomes), worst, limit, teaches=not alarmed and not taught, unlike=unlike_ratio)
        self._state = _State(tracks, errors, failed)
        self._last = look, ruling
        return ruling

    def _judge(self, track: Track, evidence: Evidence, decisive: float) -> tuple[Outcome, Track, bool]:
        """The outcome, the track with its sums, and whether the look teaches as far as this scope goes."""
        outcome, after = judge(track, evidence, self._sensitivity, decisive)
        if self._sensitivity == TEACHES:
            return outcome, replace(after, teaching_cusum=after.cusum), outcome.verdict == OK
        teaching, plain = judge(replace(track, cusum=track.teaching_cusum), evidence, TEACHES, decisive)
        return outcome, replace(after, teaching_cusum=plain.cusum), teaching.verdict == OK

    def unconfirmed(self) -> Ruling | None:
        """The last ruling where a second look could not be used: it says neither yes nor no, so nothing has failed yet."""
        if self._last is None:
            return None
        look, ruling = self._last
        outcomes = tuple(_only_suspect(one) for one in ruling.outcomes)
        ruling = replace(ruling, outcomes=outcomes, worst=max(outcomes, key=_weight), teaches=False)
        self._state = replace(self._state, failed=self._before.failed)
        self._last = look, ruling
        return ruling

    def begin_anew(self, of: Callable[[Track], Track]) -> None:
        """The user goes on with the print as it is. of: `accept` or `pardon`, for the scopes that had failed."""
        failed = self._state.failed or frozenset(self._state.tracks)
        tracks = {scope: (of if scope in failed else accept)(track) for scope, track in self._state.tracks.items()}
        self._state = self._before = _State(tracks, self._state.errors)
        self._last, self._went_on = None, True

    def _limit(self, track: Track, comparison: Comparison | None) -> float:
        now = (comparison.error_ratio,) if comparison is not None else (0.0,)
        errors = self._state.errors or now
        usual = median(errors)
        spread = 1.4826 * median(abs(error - usual) for error in errors) if len(errors) >= 5 else 0.0
        total_px = 0 if comparison is None else comparison.total_px
        return usual + 3 * spread + matter_limit(track, total_px, self._sensitivity)


class Courses:
    """One course before each camera: what was usual for the one would be a surprise for the other."""

    def __init__(self, sensitivity: str) -> None:
        self._sensitivity = sensitivity
        self._courses: dict[str | None, Course] = {}
        self._judged: dict[str | None, tuple[int, Look]] = {}

    def rule(
        self, look: Look, moment: Moment, name: Callable[[Ruling], Mapping[int, Diagnosis]] | None = None
    ) -> tuple[Look, Ruling | None]:
        """What follows from the next look; None where nothing could be judged. And the look that it follows from.

        name : what failures would be called, for a look that does not know it yet
        Where a second look is blind, the first stands unconfirmed.
        """
        course = self._courses.setdefault(moment.camera, Course(self._sensitivity))
        file_pos, before = self._judged.get(moment.camera, (None, look))
        again = moment.again and file_pos == moment.file_pos
        if look.blind:
            if not again:
                course.blind(look.blind)
            ruling = course.unconfirmed() if again else None
            return (look, None) if ruling is None else (before, ruling)
        if look.turned and not again:
            course.blind(CAMERA_MOVED)
        ruling = course.rule(look, again)
        if name is not None:
            look = replace(look, names=name(ruling))
        self._judged[moment.camera] = (moment.file_pos, look)
        return look, ruling

    def begin_anew(self, of: Callable[[Track], Track]) -> None:
        """See `Course.begin_anew`; of all cameras that have judged anything."""
        for course in self._courses.values():
            course.begin_anew(of)


def _without_fresh_of(scopes: Sequence[Evidence], quiet: Collection[int]) -> Iterator[Evidence]:
    """The scopes, where of the whole it is not asked whether matter came to objects of which the user went on without it."""
    for scope in scopes:
        if scope.object_id == WHOLE:
            for part in scopes:
                if part.object_id in quiet and part.object_id != WHOLE:
                    scope = replace(
                        scope,
                        unseen_px=max(scope.unseen_px - part.unseen_px, 0),
                        deep_px=max(scope.deep_px - part.deep_px, 0),
                        barren_px=max(scope.barren_px - part.barren_px, 0),
                        fresh=_less(scope.fresh, part.fresh),
                        come=_less(scope.come, part.come),
                    )
        yield scope


def _less(windows: Windows, others: Windows) -> Windows:
    return tuple(
        (max(new - its_new, 0), max(seen - its_seen, 0)) for (new, seen), (its_new, its_seen) in zip(windows, others)
    )


def _in_both(first: Sequence[Evidence], second: Sequence[Evidence]) -> tuple[Evidence, ...]:
    """What two looks at one state agree on: the lesser figures of the two."""
    by_id = {evidence.object_id: evidence for evidence in first}
    return tuple(_lesser(by_id.get(evidence.object_id, evidence), evidence) for evidence in second)


def _lesser(one: Evidence, other: Evidence) -> Evidence:
    wrong = ("lost_px", "stray_px", "rim_px", "unseen_px", "barren_px", "sunk_px")
    fresh, come = _more(one.fresh, other.fresh), _more(one.come, other.come)
    least = {name: min(getattr(one, name), getattr(other, name)) for name in wrong}
    return replace(other, fresh=fresh, come=come, **least)


def _more(before: Windows, windows: Windows) -> Windows:
    """The windows, with the larger share of both."""
    return tuple(
        (new_px, max(seen_px, min(round(before_seen_px * new_px / max(before_px, 1)), new_px)))
        for (before_px, before_seen_px), (new_px, seen_px) in zip(before, windows)
    )


def _only_suspect(outcome: Outcome) -> Outcome:
    return replace(outcome, verdict=SUSPECT) if outcome.verdict == FAILED else outcome


def _weight(outcome: Outcome) -> tuple[int, bool, float]:
    """Which outcome speaks for the check: the worst, an object's before the whole's, the most surprising first."""
    return SEVERITY[outcome.verdict], outcome.object_id >= 0, outcome.leading.size
