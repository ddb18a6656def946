"""The sequential rule, on figures made by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from octoprint_moop.core.decision.counts import WHOLE, Evidence
from octoprint_moop.core.decision.decide import (
    CONFIRMED,
    CUSUM_FAILED,
    FAILED,
    MATTER_LIMIT_RATIO,
    OK,
    SUSPECT,
    Track,
    accept,
    blame,
    judge,
    learn,
    pardon,
)  # fmt: skip

TOTAL_PX = 20_000
LIMIT_PX = int(MATTER_LIMIT_RATIO * TOTAL_PX)


def evidence(lost=0, stray=0, unseen=0, object_id=WHOLE, share=1.0, barren=0, rim=0, dim=0):
    fresh = tuple((200 * n, int(200 * n * share)) for n in (1, 2, 4, 8))
    return Evidence(
        object_id, 9000, TOTAL_PX, dim, 8000, lost, stray, 600, rim, unseen, 900, barren, lost + stray, fresh
    )


def after_good(checks=20, track=None, **figures):
    track = track or Track()
    for _ in range(checks):
        track = learn(track, evidence(**figures))
    return track


def verdicts(track, *seen):
    found = []
    for one in seen:
        outcome, track = judge(track, one, "medium")
        found.append(outcome.verdict)
    return found


def test_nothing_wrong_is_ok_for_ever():
    assert set(verdicts(after_good(), *[evidence()] * 500)) == {OK}


@pytest.mark.parametrize("missing", [{"share": 0.0}, {"barren": 900}, {"unseen": 12 * LIMIT_PX}])
def test_what_one_look_shows_to_have_not_come_may_be_a_picture_from_before_two_looks_tell(missing):
    late = evidence(**missing)
    assert verdicts(after_good(), late, evidence(), evidence()) == [SUSPECT, OK, OK]
    assert verdicts(after_good(), late, late) == [SUSPECT, FAILED]
    begun = evidence(unseen=int(0.4 * LIMIT_PX))
    assert verdicts(after_good(unseen=1), begun, late) == [OK, FAILED]
    assert judge(after_good(), late, "medium", decisive=CONFIRMED)[0].verdict == FAILED
    assert verdicts(after_good(), evidence(**missing, lost=4 * LIMIT_PX)) == [FAILED]


def test_one_odd_frame_is_suspect_and_fades_away():
    odd = evidence(stray=int(1.3 * LIMIT_PX))
    assert verdicts(after_good(), odd, evidence(), evidence(), odd)[1:3] == [OK, OK]
    assert FAILED not in verdicts(after_good(), odd, *[evidence()] * 6, odd)


def test_two_in_a_row_are_a_failure():
    odd = evidence(stray=int(1.8 * LIMIT_PX))
    assert verdicts(after_good(), odd, odd) == [SUSPECT, FAILED]


def test_one_that_is_strong_needs_no_second():
    assert verdicts(after_good(), evidence(lost=4 * LIMIT_PX)) == [FAILED]


def test_the_first_check_of_a_print_is_never_a_failure_but_the_second_may_be():
    strong = evidence(stray=20 * LIMIT_PX)
    assert verdicts(Track(), strong, strong) == [SUSPECT, FAILED]


def test_weak_evidence_that_stays_becomes_a_failure():
    """Nine tenths of a limit, check after check: Page's sum grows by 0.9 less the slack each time."""
    found = verdicts(after_good(), *[evidence(lost=int(0.9 * LIMIT_PX))] * 25)
    assert found[0] == OK and found[-1] == FAILED


def test_what_was_so_while_all_was_well_is_no_evidence():
    usual = {"stray": 3 * LIMIT_PX, "lost": LIMIT_PX}
    assert set(verdicts(after_good(**usual), *[evidence(**usual)] * 50)) == {OK}


def test_a_share_of_fresh_matter_is_compared_with_its_own_past():
    poor = after_good(share=0.4)
    assert verdicts(poor, evidence(share=0.35)) == [OK]
    assert verdicts(after_good(share=0.95), *[evidence(share=0.3)] * 2)[-1] == FAILED


def test_light_along_the_edges_counts_by_their_length():
    """The same pixels are a shift along short edges and a change of light along long ones."""
    usual = after_good(rim=10)
    along = int(0.1 * 5000)
    assert verdicts(usual, replace(evidence(rim=along), edge_px=5000)) == [OK]
    assert verdicts(usual, replace(evidence(rim=along), edge_px=600)) == [FAILED]


def test_before_there_is_a_past_only_barren_matter_tells_of_a_clog():
    assert verdicts(Track(), evidence(share=0.0)) == [OK]
    assert verdicts(Track(), *[evidence(barren=800)] * 2) == [SUSPECT, FAILED]


@pytest.mark.parametrize(("sensitivity", "verdict"), [("low", OK), ("medium", SUSPECT), ("high", SUSPECT)])
def test_sensitivity_scales_the_limits(sensitivity, verdict):
    outcome, _ = judge(after_good(), evidence(stray=int(1.2 * LIMIT_PX)), sensitivity)
    assert outcome.verdict == verdict


def test_after_accept_the_sum_starts_again_and_missing_matter_is_learned_anew():
    _, failed = judge(after_good(), evidence(share=0.0, lost=5 * LIMIT_PX), "medium")
    track = accept(failed)
    for _ in range(8):
        outcome, track = judge(track, evidence(share=0.0), "medium")
        assert outcome.verdict == OK
        track = learn(track, evidence(share=0.0))
    assert judge(track, evidence(lost=5 * LIMIT_PX), "medium")[0].verdict == FAILED


def test_a_pardon_makes_the_same_scope_less_easily_surprised():
    odd = evidence(stray=int(3.5 * LIMIT_PX))
    assert verdicts(after_good(), odd) == [FAILED]
    assert verdicts(pardon(after_good()), odd) == [SUSPECT]


def test_only_the_object_that_lost_matter_is_named_for_what_lies_beside_others():
    outcomes = [
        judge(after_good(), evidence(lost=900, stray=900), "medium")[0],
        judge(after_good(), evidence(lost=900, object_id=0), "medium")[0],
        judge(after_good(), evidence(stray=700, object_id=1), "medium")[0],
    ]
    assert [outcome.verdict for outcome in blame(outcomes)] == [FAILED, FAILED, SUSPECT]


def test_two_objects_that_both_lost_matter_are_both_named():
    outcomes = [judge(after_good(), evidence(lost=900, object_id=number), "medium")[0] for number in (0, 1)]
    assert [outcome.verdict for outcome in blame(outcomes)] == [FAILED, FAILED]


def test_noise_of_half_a_limit_gives_no_false_alarm_in_20_000_checks():
    rng = np.random.default_rng(5)
    track = after_good()
    for stray in np.abs(rng.normal(0, 0.25 * LIMIT_PX, 20_000)).astype(int):
        outcome, track = judge(track, evidence(stray=int(stray)), "medium")
        assert outcome.verdict != FAILED
        assert outcome.cusum < CUSUM_FAILED
