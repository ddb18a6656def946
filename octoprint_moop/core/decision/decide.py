"""Has the print failed? A sequential rule on evidence that is measured against this print's own past.

Each check gives, for the whole print and for every labelled object, three figures in parts of the complete
silhouette: lost matter, stray matter, and fresh matter that is not seen. Each is compared with what it was while all
was well (median and spread of the good checks, with floors that stand in until there are enough of them), which makes
*surprises*: how many limits it lies above that. A surprise of 1 is suspect. Surprises add up over checks as in Page's
cumulative sum (1954), so that two weak ones or one strong one make a failure, and one odd frame fades away.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from statistics import median

from .counts import WINDOWS, Evidence, Windows

OK, SUSPECT, FAILED, UNUSABLE, CAMERA_MOVED = "ok", "suspect", "failed", "unusable", "camera_moved"

GOOD_CHECKS = 25  # how many good checks make the baseline
CUSUM_FAILED = 2.0  # sum of surprises above SLACK at which a print has failed
SLACK = 0.6
DECISIVE = 3.0  # one check this far above its limits needs no second
QUIET = 0.3  # of a surprise: less is nothing
CONFIRMED = 2.0  # the same, where a second frame of the same state has shown it too
MATTER_LIMIT_RATIO = 0.004  # lost or stray matter, in parts of the complete silhouette, at medium sensitivity
MATTER_LIMIT_PX = 30
DIM_WIDENS = 8.0  # by how much all limits grow with the share of standing matter that is usually not seen
UNLIKE_WIDENS = 10.0  # by how much that for contours grows with the E that is usual, once the misfit is taken out
SUNK_LIMIT_PX = 14  # of contour that has come inwards
RIM_LIMIT = 0.1  # the same along expected edges, in parts of their length
FRESH_LEAST_PX = 40
FRESH_LIMIT = 0.35  # how far the seen share of fresh matter may fall below its baseline
UNCOVERED_LIMIT = 0.2  # the same of the share that is covered
COVERED_PRIOR = 0.5  # of fresh matter, as long as too few checks have told
BORNE_OUT = 2.0  # times the surprise that less is covered: from a half of a limit on, all that looks bare counts
ACCOUNTED, ACCOUNTED_LEAST = 0.3, 0.03  # of what has come to differ, and of the complete silhouette
FRESH_CHECKS = 4  # so many good checks before shares are compared; until then only barren matter counts
BARREN_PRIOR = 0.3  # share of barren matter that is let pass until then
CUSUM_ALONE = 5.0  # so much weak evidence needs no strong one
PARDON = 1.5  # how much wider a scope's limits become where the user says that it was no failure
SENSITIVITIES = {"low": 2.0, "medium": 1.0, "high": 0.6}


@dataclass(frozen=True)
class Surprise:
    """One figure of one scope, in limits above its baseline: 1 is as much as is tolerated."""

    kind: str  # "lost", "stray", "fresh", or "all" of these together
    size: float


@dataclass(frozen=True)
class Track:
    """What the good checks of one scope have shown, and the sum of surprises since.

    last  : the surprise of the last check
    cusum : the sum at the sensitivity that the user chose; teaching_cusum : at that which decides what is learned
    wide  : scales all its limits
    quiet : for so many checks in which new matter comes, its absence is not asked after: the user went on without it
    """

    lost: tuple[float, ...] = ()
    stray: tuple[float, ...] = ()
    rim: tuple[float, ...] = ()
    sunk: tuple[float, ...] = ()
    unseen: tuple[float, ...] = ()
    barren: tuple[float, ...] = ()
    dim: tuple[float, ...] = ()
    unlike: tuple[float, ...] = ()
    seen: tuple[tuple[float, ...], ...] = field(default_factory=lambda: tuple(() for _ in WINDOWS))
    come: tuple[tuple[float, ...], ...] = field(default_factory=lambda: tuple(() for _ in WINDOWS))
    last: float = 0.0
    cusum: float = 0.0
    teaching_cusum: float = 0.0
    wide: float = 1.0
    quiet: int = 0


@dataclass(frozen=True)
class Outcome:
    """The verdict on one scope in one check, and the figures behind it, largest surprise first."""

    object_id: int
    verdict: str
    surprises: tuple[Surprise, ...]
    cusum: float

    @property
    def leading(self) -> Surprise:
        return self.surprises[0]

    def size(self, kind: str) -> float:
        return next(surprise.size for surprise in self.surprises if surprise.kind == kind)


def matter_limit(track: Track, total_px: int, sensitivity: str) -> float:
    """How much lost or stray matter is tolerated, in parts of the complete silhouette."""
    return _widened(track, sensitivity) * max(MATTER_LIMIT_RATIO, MATTER_LIMIT_PX / max(total_px, 1))


def _widened(track: Track, sensitivity: str) -> float:
    """How many times as much as usual is tolerated."""
    return SENSITIVITIES[sensitivity] * track.wide * (1 + DIM_WIDENS * _usual(track.dim))


def surprises(track: Track, evidence: Evidence, sensitivity: str) -> tuple[Surprise, ...]:
    """How far each figure lies above what this print has shown, largest first. Pure."""
    wide = SENSITIVITIES[sensitivity] * track.wide
    total = max(evidence.total_px, 1)
    limit = matter_limit(track, total, sensitivity)
    lost = (evidence.lost_px / total - _usual(track.lost)) / limit
    stray = (evidence.stray_px / total - _usual(track.stray)) / limit
    # a pixel's width of light along the edges comes and goes; a shift shows along a good part of them
    faint = _above(track.rim, evidence.rim_px / total) / max(limit, wide * RIM_LIMIT * evidence.edge_px / total)
    # the contours of what is badly seen wander
    wandering = 1 + UNLIKE_WIDENS * _usual(track.unlike)
    faint += _above(track.sunk, evidence.sunk_px) / (_widened(track, sensitivity) * wandering * SUNK_LIMIT_PX)
    fresh = 0.0
    if not track.quiet:
        borne_out = _borne_out(track, evidence, wide)
        faint += _above(track.unseen, borne_out * evidence.unseen_px / total) / limit
        fresh = max(_barren(track, evidence, limit, borne_out), _not_come(track, evidence, wide))
    found = [
        Surprise("lost", lost),
        Surprise("stray", stray),
        Surprise("fresh", fresh),
        Surprise("all", lost + stray + faint),
    ]
    return tuple(sorted(found, key=lambda surprise: -surprise.size))


def _barren(track: Track, evidence: Evidence, limit: float, borne_out: float) -> float:
    """The surprise that matter well inside the last layers' outline was never seen."""
    total = max(evidence.total_px, 1)
    usual = _usual(track.barren)
    if len(track.barren) < FRESH_CHECKS:
        usual = max(usual, BARREN_PRIOR * evidence.deep_px / total)
    return (borne_out * evidence.barren_px / total - usual) / limit


def _borne_out(track: Track, evidence: Evidence, wide: float) -> float:
    """How far what is covered bears out that fresh matter is missing, 0 to 1: single pixels of it may look like the bed in
    the shade of what grows about them, or shine like it. 1 where nothing tells, or nothing looks bare."""
    if not (evidence.unseen_px or evidence.barren_px):
        return 1.0
    fallen = (fall / limit for fall, limit in _uncovered(track, evidence, wide, COVERED_PRIOR) if limit)
    return min(1.0, BORNE_OUT * max(fallen, default=1.0))


def _not_come(track: Track, evidence: Evidence, wide: float) -> float:
    """The surprise that fresh matter has not come: that less of it is covered, as two windows agree where two can tell, else
    that less is seen.

    By as much as older layers have fallen it is light, or the camera: what has come stays.
    """
    *newer, (older_fall, _) = _uncovered(track, evidence, wide)
    sizes = [max(fall - older_fall, 0.0) / limit for fall, limit in newer if limit]
    return max([min(pair) for pair in zip(sizes, sizes[1:])] or sizes or _fresh(track, evidence, wide))


def _uncovered(track: Track, evidence: Evidence, wide: float, prior: float | None = None) -> list[tuple[float, float]]:
    """By how much less is covered than usual of what the newest layers should have covered, and of what older ones should
    (see `_told`), each with its limit, 0 where nothing tells.

    prior : the share that is usual before enough checks have told; None where nothing is until then
    """
    found = []
    for past, (told_px, covered_px) in zip(track.come, _told(evidence)):
        known = len(past) >= FRESH_CHECKS
        usual = _usual(past) if known else prior
        if told_px < FRESH_LEAST_PX or usual is None:
            found.append((0.0, 0.0))
            continue
        limit = max(UNCOVERED_LIMIT, 5 * _spread(past)) if known else UNCOVERED_LIMIT
        found.append((max(usual - covered_px / told_px, 0.0), _limit_of_share(limit, told_px, wide)))
    return found


def _told(evidence: Evidence) -> Windows:
    """Pixels that can tell how far they are covered, and how many covered ones that is worth: of the last layers, for each
    of WINDOWS but the last, and of those that only the last has."""
    *newer, (within_px, within_covered_px), (all_px, covered_px) = evidence.come
    return (*newer, (within_px, within_covered_px), (all_px - within_px, covered_px - within_covered_px))


def _above(past: tuple[float, ...], value: float) -> float:
    """By how much a figure that is never nothing lies above all that is usual; 0 until enough checks have told."""
    if len(past) < FRESH_CHECKS or value <= _usual(past):
        return 0.0
    return max(value - _usual(past) - 4 * _spread(past), 0.0)


def _fresh(track: Track, evidence: Evidence, wide: float) -> list[float]:
    """The surprise that fresh matter is not seen, for each window with enough of it."""
    found = [0.0]
    for past, (new_px, seen_px) in zip(track.seen, evidence.fresh):
        if new_px < FRESH_LEAST_PX or len(past) < FRESH_CHECKS:
            continue
        usual = _usual(past)
        limit = max(min(FRESH_LIMIT, 0.6 * usual), 5 * _spread(past))
        found.append(max(usual - seen_px / new_px, 0.0) / _limit_of_share(limit, new_px, wide))
    return found


def _limit_of_share(limit: float, pixels: int, wide: float) -> float:
    """By how much a share of so many pixels may be less than usual: few pixels lie about in few places, so their share is as
    uncertain as that of a tenth as many coins."""
    return limit * min(wide, 1.3) + 0.25 / (pixels / 10) ** 0.5


def judge(track: Track, evidence: Evidence, sensitivity: str, decisive: float = DECISIVE) -> tuple[Outcome, Track]:
    """The verdict on one scope, and its track with this check's sum; `learn` is for checks that were good.

    decisive : the surprise that needs no second check
    """
    found = surprises(track, evidence, sensitivity)
    size = found[0].size
    if size > CONFIRMED and track.last < QUIET and surprises(track, _as_if_come(evidence), sensitivity)[0].size < 1:
        size = CONFIRMED  # a picture from before the last layer shows just that: it takes a second look to tell
    cusum = max(0.0, track.cusum + min(size, DECISIVE + SLACK) - SLACK)
    # a first check has nothing to be compared with: a camera that is set up wrongly looks just like a failure then
    first = not track.lost and track.cusum == 0
    enough = size >= decisive or (size >= 1 and cusum >= CUSUM_FAILED) or (size >= SLACK and cusum >= CUSUM_ALONE)
    if enough and not first:
        verdict = FAILED
    elif size >= 1 or cusum >= 1:
        verdict = SUSPECT
    else:
        verdict = OK
    return Outcome(evidence.object_id, verdict, found, cusum), replace(track, cusum=cusum, last=found[0].size)


def accounts(track: Track, evidence: Evidence) -> bool:
    """Whether what is found wrong accounts for what has come to differ from what is expected.

    A failure can be told pixel by pixel; where much has changed and hardly any of it is borne out to be lost, stray or
    missing, something else has changed: what stands before the camera, or the light.
    """
    grown_px = evidence.xor_px - _usual(track.unlike) * evidence.total_px
    if not track.unlike or grown_px < ACCOUNTED_LEAST * evidence.total_px:
        return True
    told_px, covered_px = evidence.come[-1]
    missing_px = max(evidence.unseen_px, evidence.barren_px, told_px - covered_px)
    return evidence.lost_px + evidence.stray_px + evidence.rim_px + missing_px >= ACCOUNTED * grown_px


def _as_if_come(evidence: Evidence) -> Evidence:
    """The evidence, were all that the last layers should have added seen."""
    fresh, come = (tuple((new_px, new_px) for new_px, _ in windows) for windows in (evidence.fresh, evidence.come))
    return replace(evidence, unseen_px=0, barren_px=0, fresh=fresh, come=come)


def blame(outcomes: Sequence[Outcome]) -> list[Outcome]:
    """Name only whose failure it is: what has come off one object, or was not laid on it, may lie beside another."""
    sources = {
        outcome.object_id
        for outcome in outcomes
        if outcome.object_id >= 0
        and outcome.verdict == FAILED
        and max(outcome.size("lost"), outcome.size("fresh")) >= 1
    }
    return [
        replace(outcome, verdict=SUSPECT)
        if sources - {outcome.object_id}
        and outcome.object_id >= 0
        and outcome.verdict == FAILED
        and max(outcome.size("lost"), outcome.size("fresh")) < 1
        else outcome
        for outcome in outcomes
    ]


def learn(track: Track, evidence: Evidence) -> Track:
    """The track with a good check taken into its baseline."""
    total, borne_out = max(evidence.total_px, 1), _borne_out(track, evidence, 1.0)
    return replace(
        track,
        quiet=max(track.quiet - _comes(evidence), 0),
        lost=_with(track.lost, evidence.lost_px / total),
        stray=_with(track.stray, evidence.stray_px / total),
        rim=_with(track.rim, evidence.rim_px / total),
        sunk=_with(track.sunk, evidence.sunk_px),
        unseen=_with(track.unseen, borne_out * evidence.unseen_px / total),
        barren=_with(track.barren, borne_out * evidence.barren_px / total),
        unlike=_with(track.unlike, evidence.error_ratio),
        dim=_with(track.dim, evidence.dim_px / max(evidence.expected_px, 1)),
        seen=tuple(
            _with(past, seen_px / new_px) if new_px >= FRESH_LEAST_PX else past
            for past, (new_px, seen_px) in zip(track.seen, evidence.fresh)
        ),
        come=tuple(
            _with(past, covered_px / told_px) if told_px >= FRESH_LEAST_PX else past
            for past, (told_px, covered_px) in zip(track.come, _told(evidence))
        ),
    )


def accept(track: Track) -> Track:
    """The track where the user goes on with the print as it is: a new past begins."""
    return Track(wide=track.wide, quiet=WINDOWS[-1])


def seen_from_elsewhere(track: Track) -> Track:
    """The track where the camera was found to stand elsewhere: what is usually covered of new lines is learned anew."""
    return replace(track, come=Track().come)


def pardon(track: Track) -> Track:
    """The track where the user says that it was no failure: as `accept`, and this scope is less easily surprised."""
    return Track(wide=track.wide * PARDON, quiet=WINDOWS[-1])


def _comes(evidence: Evidence) -> bool:
    """Whether most of what the last layers should have added is seen."""
    return any(new_px >= FRESH_LEAST_PX and seen_px > 0.6 * new_px for new_px, seen_px in evidence.fresh[:2])


@lru_cache(maxsize=1024)  # a check asks the same past many times over
def _usual(past: tuple[float, ...]) -> float:
    return median(past) if past else 0.0


@lru_cache(maxsize=1024)
def _spread(past: tuple[float, ...]) -> float:
    """Of the past about its median, as a standard deviation."""
    usual = _usual(past)
    return 1.4826 * median(abs(value - usual) for value in past)


def _with(past: tuple[float, ...], value: float) -> tuple[float, ...]:
    return (*past, value)[-GOOD_CHECKS:]
