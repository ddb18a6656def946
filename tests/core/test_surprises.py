"""The figures of the rule of docs/decision.md, worked out by hand: limits, surprises, sums, what is learned, and blame."""

from __future__ import annotations

from dataclasses import FrozenInstanceError, replace

import pytest

from octoprint_moop.core.decision.counts import WHOLE, Evidence
from octoprint_moop.core.decision.decide import (
    FAILED,
    OK,
    SUSPECT,
    Outcome,
    Surprise,
    Track,
    accept,
    accounts,
    blame,
    judge,
    learn,
    matter_limit,
    pardon,
    surprises,
)

NOTHING_NEW = ((0, 0),) * 4
# of 20,000 px; the limit of lost and stray matter is 80 px
PLAIN = Evidence(WHOLE, 9000, 20_000, 0, 8000, 0, 0, 600, 0, 0, 900, 0, 0, NOTHING_NEW)


def size(kind: str, track: Track = Track(), sensitivity: str = "medium", **figures) -> float:
    return {one.kind: one.size for one in surprises(track, replace(PLAIN, **figures), sensitivity)}[kind]


def track_of(**past: float | tuple[float, ...]) -> Track:
    """Four good checks, alike where one number is given."""
    return Track(**{name: values if isinstance(values, tuple) else (values,) * 4 for name, values in past.items()})


# --- limits -----------------------------------------------------------------------------------------------------------


def test_what_is_tolerated_is_four_thousandths_of_the_silhouette_and_thirty_pixels_at_least():
    assert matter_limit(Track(), 20_000, "medium") == 0.004
    assert matter_limit(Track(), 3000, "medium") == pytest.approx(30 / 3000)
    assert matter_limit(Track(), 1, "medium") == matter_limit(Track(), 0, "medium") == 30


def test_low_sensitivity_tolerates_twice_as_much_and_high_six_tenths():
    assert matter_limit(Track(), 20_000, "low") == pytest.approx(0.008)
    assert matter_limit(Track(), 20_000, "high") == pytest.approx(0.0024)


def test_a_pardon_widens_limits_by_half_each_time_and_going_on_keeps_them():
    assert matter_limit(pardon(Track()), 20_000, "medium") == pytest.approx(0.006)
    assert pardon(pardon(pardon(Track()))).wide == pytest.approx(3.375)
    assert accept(pardon(Track())).wide == 1.5


def test_where_a_tenth_of_what_stands_is_usually_not_seen_limits_are_nearly_twice_as_wide():
    assert matter_limit(track_of(dim=0.1), 20_000, "medium") == pytest.approx(0.004 * 1.8)


# --- surprises --------------------------------------------------------------------------------------------------------


def test_lost_and_stray_matter_surprise_by_what_is_above_the_usual_and_together_by_their_sum():
    track = track_of(lost=0.002, stray=0.001)
    figures = {"lost_px": 160, "stray_px": 60}
    assert size("lost", track, **figures) == pytest.approx((0.008 - 0.002) / 0.004)
    assert size("stray", track, **figures) == pytest.approx((0.003 - 0.001) / 0.004)
    assert size("all", track, **figures) == pytest.approx(1.5 + 0.5)
    outcome, _ = judge(track, replace(PLAIN, **figures), "medium")
    assert outcome.leading.kind == "all" and outcome.size("stray") == pytest.approx(0.5)


def test_a_view_without_any_of_the_print_is_no_division_by_nothing():
    assert size("lost", total_px=0, lost_px=6) == pytest.approx(6 / 30)
    assert size("fresh", total_px=0, deep_px=0, barren_px=3) == pytest.approx(3 / 30)


@pytest.mark.parametrize("figure", ["rim", "unseen"])
def test_what_is_never_nothing_must_exceed_its_usual_by_four_spreads(figure):
    past = (0.010, 0.012, 0.008, 0.010, 0.011)  # median 0.010, median distance from it 0.001
    above = 0.02 - 0.010 - 4 * 1.4826 * 0.001
    seen = {f"{figure}_px": 400}
    assert size("all", track_of(**{figure: past}), **seen) == pytest.approx(above / 0.004)
    assert size("all", track_of(**{figure: past[:3]}), **seen) == 0  # too few to know what is usual
    assert size("all", track_of(**{figure: past[:4]}), **seen) > 0
    assert size("all", track_of(**{figure: past}), **{f"{figure}_px": 20}) == 0


def test_the_rim_is_measured_by_the_length_of_the_edges_as_wide_as_the_limits_are():
    track = track_of(rim=0.0)
    assert size("all", track, rim_px=500, edge_px=5000) == pytest.approx(0.025 / 0.025)
    assert size("all", pardon_kept(track), rim_px=500, edge_px=5000) == pytest.approx(0.025 / (1.5 * 0.025))
    assert size("all", track, "low", rim_px=500, edge_px=5000) == pytest.approx(0.025 / (2 * 0.025))


def test_fourteen_pixels_of_contour_that_has_come_inwards_are_tolerated_and_more_where_the_print_is_seen_badly():
    track = track_of(sunk=0.0)
    assert size("all", track, sunk_px=14) == pytest.approx(1)
    assert size("all", Track(), sunk_px=14) == 0  # too few to know what is usual
    assert size("all", replace(track, dim=(0.125,) * 4), sunk_px=14) == pytest.approx(0.5)
    assert size("all", replace(track, unlike=(0.1,) * 4), sunk_px=14) == pytest.approx(0.5)
    assert size("all", pardon_kept(track), "low", sunk_px=14) == pytest.approx(1 / 3)
    usual = track_of(sunk=(6.0, 6.0, 8.0, 4.0))
    assert size("all", usual, sunk_px=14) == pytest.approx((8 - 4 * 1.4826) / 14)


def pardon_kept(track: Track) -> Track:
    return replace(track, wide=1.5)


def test_barren_matter_is_let_pass_by_a_third_until_four_checks_have_told_what_is_usual():
    seen = {"barren_px": 800, "deep_px": 900}
    prior = 0.3 * 900 / 20_000
    assert size("fresh", **seen) == pytest.approx((0.04 - prior) / 0.004)
    assert size("fresh", track_of(barren=(0.001,) * 3), **seen) == pytest.approx((0.04 - prior) / 0.004)
    assert size("fresh", track_of(barren=(0.02,) * 3), **seen) == pytest.approx((0.04 - 0.02) / 0.004)
    for checks in (4, 6):
        known = track_of(barren=(0.001,) * checks)
        assert size("fresh", known, **seen) == pytest.approx((0.04 - 0.001) / 0.004)


def fresh(share: float, past: tuple[float, ...], sensitivity: str = "medium", new_px: int = 1000) -> float:
    """The surprise of one window in which that share of the new matter is seen."""
    track = Track(seen=((), past, (), ()))
    shown = ((0, 0), (new_px, round(share * new_px)), (0, 0), (0, 0))
    return size("fresh", track, sensitivity, fresh=shown)


def test_new_matter_that_is_seen_less_than_usual_surprises_in_parts_of_its_limit():
    few = 0.25 / (1000 / 10) ** 0.5
    assert fresh(0.3, (0.9,) * 4) == pytest.approx(0.6 / (0.35 + few))
    assert fresh(0.1, (0.4,) * 4) == pytest.approx(0.3 / (0.6 * 0.4 + few))  # where little is seen anyway
    assert fresh(0.3, (0.9,) * 4, "low") == pytest.approx(0.6 / (1.3 * 0.35 + few))  # never much wider
    assert fresh(0.3, (0.9,) * 4, "high") == pytest.approx(0.6 / (0.6 * 0.35 + few))
    spread = 1.4826 * 0.1
    assert fresh(0.1, (0.6, 0.7, 0.8, 0.8, 0.6)) == pytest.approx(0.6 / (5 * spread + few))  # where it varies
    assert fresh(1.0, (0.5,) * 4) == 0


def test_a_share_of_few_new_pixels_or_without_a_past_says_nothing():
    assert fresh(0.0, (0.9,) * 3) == 0
    assert fresh(0.0, (0.9,) * 4, new_px=39) == 0
    assert fresh(0.0, (0.9,) * 4, new_px=40) == pytest.approx(0.9 / (0.35 + 0.25 / 4**0.5))


def test_while_the_user_has_just_gone_on_missing_matter_is_not_asked_after():
    track = replace(track_of(unseen=0.0, barren=0.0), seen=((0.9,) * 4,) * 4, quiet=1)
    figures = {"unseen_px": 400, "barren_px": 800, "fresh": ((1000, 0),) * 4}
    assert (size("fresh", track, **figures), size("all", track, **figures)) == (0, 0)
    assert size("fresh", replace(track, quiet=0), **figures) > 1 < size("all", replace(track, quiet=0), **figures)


# --- the sum ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("limits", "before", "verdict", "after"),
    [
        (10, 0.0, FAILED, 3.0),  # no one check adds more than 3.6 less the slack of 0.6
        (3, 0.0, FAILED, 2.4),
        (2.5, 0.0, SUSPECT, 1.9),
        (1, 1.6, FAILED, 2.0),
        (1, 1.5, SUSPECT, 1.9),
        (0.5, 3.0, SUSPECT, 2.9),
        (0.75, 4.85, FAILED, 5.0),
        (0.75, 4.75, SUSPECT, 4.9),
        (0.5, 6.0, SUSPECT, 5.9),
        (1, 0.0, SUSPECT, 0.4),
        (0.875, 0.75, SUSPECT, 1.025),
        (0.6, 5.0, FAILED, 5.0),
        (0.75, 0.85, SUSPECT, 1.0),
        (0.75, 0.75, OK, 0.9),
        (0, 0.25, OK, 0.0),
    ],
)
def test_surprises_add_up_less_a_slack_to_a_verdict(limits, before, verdict, after):
    track = replace(track_of(lost=0.0), cusum=before)
    outcome, later = judge(track, replace(PLAIN, stray_px=round(80 * limits)), "medium")
    assert outcome.cusum == later.cusum == pytest.approx(after)
    assert outcome.verdict == verdict


def test_what_was_seen_twice_is_decisive_sooner():
    twice = replace(PLAIN, stray_px=160)
    assert judge(track_of(lost=0.0), twice, "medium", decisive=2.0)[0].verdict == FAILED
    assert judge(track_of(lost=0.0), twice, "medium")[0].verdict == SUSPECT


# --- what is learned --------------------------------------------------------------------------------------------------


def test_a_good_check_teaches_each_figure_in_parts_of_what_it_is_of():
    seen = replace(
        PLAIN, lost_px=20, stray_px=40, rim_px=60, unseen_px=80, barren_px=100, dim_px=90,
        fresh=((39, 39), (40, 10), (100, 50), (0, 0)),
    )  # fmt: skip
    track = learn(Track(), seen)
    assert (track.lost, track.stray, track.rim) == ((0.001,), (0.002,), (0.003,))
    assert (track.unseen, track.barren, track.dim) == ((0.004,), (0.005,), (0.01,))
    assert learn(Track(), replace(PLAIN, sunk_px=7)).sunk == (7,)
    assert track.seen == ((), (0.25,), (0.5,), ())
    empty = learn(Track(), replace(seen, total_px=0, expected_px=0))
    assert (empty.lost, empty.dim) == ((20,), (90,))


def test_the_last_twenty_five_good_checks_are_the_past():
    track = Track()
    for number in range(30):
        track = learn(track, replace(PLAIN, lost_px=20 * number))
    assert track.lost == tuple(number / 1000 for number in range(5, 30))


@pytest.mark.parametrize(
    ("shown", "comes"),
    [
        (((40, 25), (0, 0), (0, 0), (0, 0)), True),
        (((0, 0), (100, 61), (0, 0), (0, 0)), True),
        (((40, 24), (100, 60), (0, 0), (0, 0)), False),  # six tenths must be exceeded
        (((39, 39), (0, 0), (0, 0), (0, 0)), False),
        (((0, 0), (0, 0), (100, 100), (100, 100)), False),  # of earlier layers: says nothing of now
    ],
)
def test_missing_matter_is_asked_after_again_when_it_has_come_for_eight_layers(shown, comes):
    track = accept(Track())
    assert track.quiet == pardon(Track()).quiet == 8
    later = learn(track, replace(PLAIN, fresh=shown))
    assert later.quiet == (7 if comes else 8)
    assert learn(replace(track, quiet=0), replace(PLAIN, fresh=shown)).quiet == 0


def test_a_new_past_knows_nothing_and_what_was_judged_stays_as_it_was():
    assert (Track().cusum, Track().teaching_cusum, Track().lost) == (0, 0, ())
    for one, name in ((Track(), "wide"), (Surprise("lost", 1.0), "size"), (outcome(0, OK), "verdict")):
        with pytest.raises(FrozenInstanceError):
            setattr(one, name, 2)


# --- who is to blame --------------------------------------------------------------------------------------------------


def outcome(object_id: int, verdict: str, lost: float = 0.0, fresh: float = 0.0, stray: float = 0.0) -> Outcome:
    return Outcome(
        object_id, verdict, (Surprise("stray", stray), Surprise("lost", lost), Surprise("fresh", fresh)), 0.0
    )


def blamed(*outcomes: Outcome) -> list[str]:
    return [one.verdict for one in blame(outcomes)]


@pytest.mark.parametrize("order", [(0, 1), (1, 0), (2, 5)])
@pytest.mark.parametrize("cause", [{"lost": 1.0}, {"fresh": 1.0}, {"lost": 4.0}])
def test_an_object_beside_which_another_ones_matter_lies_is_only_suspect(order, cause):
    source, beside = order
    whole, near = outcome(WHOLE, FAILED, stray=3), outcome(beside, FAILED, lost=0.9, stray=3)
    assert blamed(whole, outcome(source, FAILED, **cause), near) == [FAILED, FAILED, SUSPECT]


def test_each_object_that_lost_matter_itself_is_named():
    assert blamed(outcome(0, FAILED, lost=1.0), outcome(1, FAILED, lost=1.5)) == [FAILED, FAILED]


def test_where_nobody_lost_matter_nobody_is_excused():
    assert blamed(outcome(0, FAILED, stray=3), outcome(1, FAILED, stray=3)) == [FAILED, FAILED]
    assert blamed(outcome(WHOLE, FAILED, lost=3), outcome(0, FAILED, stray=3)) == [FAILED, FAILED]
    assert blamed(outcome(0, SUSPECT, lost=3), outcome(1, FAILED, stray=3)) == [SUSPECT, FAILED]


def test_an_object_that_is_well_stays_well():
    assert blamed(outcome(0, FAILED, lost=3), outcome(1, OK)) == [FAILED, OK]


# --- fresh matter -----------------------------------------------------------------------------------------------------


def covering(share: float) -> tuple[tuple[int, int], ...]:
    """1,000 pixels in each window tell how far they are covered."""
    return ((1000, round(1000 * share)),) * 4


def coming(*past: float) -> Track:
    """So far such shares of fresh matter were covered; all else was nothing."""
    return replace(track_of(unseen=0.0, lost=0.0, barren=0.0), come=(past,) * 4)


FEW = 0.25 / (1000 / 10) ** 0.5


def test_less_covered_than_usual_surprises_in_parts_of_a_fifth_or_of_five_spreads():
    assert size("fresh", coming(*(0.7,) * 4), come=covering(0.1)) == pytest.approx(0.6 / (0.2 + FEW))
    assert size("fresh", coming(0.6, 0.7, 0.7, 0.8), come=covering(0.1)) == pytest.approx(
        0.6 / (5 * 1.4826 * 0.05 + FEW)
    )
    assert size("fresh", coming(*(0.7,) * 4), come=covering(0.9)) == 0


def test_what_two_windows_do_not_agree_on_or_has_no_past_or_few_pixels_does_not_tell_that_less_is_covered():
    steady = coming(*(0.7,) * 4)
    assert size("fresh", steady, come=((0, 0), (1000, 0), (1000, 700), (1000, 700))) == 0
    assert size("fresh", steady, come=((0, 0), (1000, 0), (1000, 350), (1000, 700))) == pytest.approx(
        0.35 / (0.2 + FEW)
    )
    assert size("fresh", coming(*(0.7,) * 3), come=covering(0.1)) == 0
    assert size("fresh", steady, come=((39, 0),) * 4) == 0


def test_where_only_one_window_tells_it_is_believed():
    alone = ((9, 9), (19, 19), (1000, 100), (1000, 100))
    assert size("fresh", coming(*(0.7,) * 4), come=alone) == pytest.approx(0.6 / (0.2 + FEW))


@pytest.mark.parametrize(("older_share", "fall"), [(0.7, 0.6), (0.9, 0.6), (0.5, 0.4), (0.1, 0.0)])
def test_by_as_much_as_older_layers_have_fallen_it_is_light(older_share, fall):
    """Four layers cover 1,000 pixels, four older ones 1,000 more; of both 0.7 were covered so far."""
    come = ((1000, 100), (1000, 100), (1000, 100), (2000, 100 + round(1000 * older_share)))
    assert size("fresh", coming(*(0.7,) * 4), come=come) == pytest.approx(fall / (0.2 + FEW), abs=1e-6)


def test_where_coverage_tells_masks_are_not_asked():
    seen = replace(coming(*(0.7,) * 4), seen=((0.9,) * 4,) * 4)
    shown = ((1000, 100),) * 4
    assert size("fresh", seen, fresh=shown, come=covering(0.7)) == 0
    assert size("fresh", seen, fresh=shown) > 1


@pytest.mark.parametrize(("limits", "borne_out"), [(0.0, 0.0), (0.25, 0.5), (0.5, 1.0), (3.0, 1.0)])
def test_what_looks_bare_counts_as_far_as_coverage_bears_it_out(limits, borne_out):
    steady, share = coming(*(0.7,) * 4), 0.7 - limits * (0.2 + FEW)
    come = ((1000, 700), (1000, 700), (1000, round(1000 * share)), (1000, round(1000 * share)))
    assert size("all", steady, unseen_px=160, come=come) == pytest.approx(2 * borne_out, abs=0.01)
    assert size("fresh", steady, barren_px=160, come=come) == pytest.approx(2 * borne_out, abs=0.01)
    learned = learn(steady, replace(PLAIN, unseen_px=160, barren_px=160, come=come))
    assert learned.unseen[-1] * 20_000 == learned.barren[-1] * 20_000 == pytest.approx(160 * borne_out, abs=1)


def test_until_checks_have_told_a_half_that_is_covered_bears_nothing_out():
    anew = track_of(unseen=0.0, lost=0.0)
    assert size("all", anew, unseen_px=160, come=covering(0.5)) == 0
    assert size("all", anew, unseen_px=160, come=covering(0.2)) == 2


def test_where_nothing_tells_how_far_it_is_covered_all_that_looks_bare_counts():
    assert size("all", track_of(unseen=0.0, lost=0.0), unseen_px=160, come=((39, 39),) * 4) == 2


def test_a_check_in_which_most_of_what_differs_is_not_explained_is_not_accounted_for():
    good = track_of(unlike=0.01)
    strange = replace(PLAIN, xor_px=200 + 4000)
    assert not accounts(good, replace(strange, lost_px=1100))
    for explained in (
        {"lost_px": 1200},
        {"stray_px": 1200},
        {"rim_px": 600, "stray_px": 600},
        {"unseen_px": 1200},
        {"come": ((0, 0),) * 3 + ((2000, 800),)},
    ):
        assert accounts(good, replace(strange, **explained))
    assert accounts(good, replace(PLAIN, xor_px=200 + 500))  # a fortieth of the print: no more than may be
    assert accounts(Track(), strange)  # nothing is known of what is usual
