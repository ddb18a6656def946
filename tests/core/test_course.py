"""One print's course: looks that are taken twice, kept, and concluded from with another sensitivity."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from octoprint_moop.core.checks import Check
from octoprint_moop.core.decision.compare import Comparison
from octoprint_moop.core.decision.counts import WHOLE, Evidence
from octoprint_moop.core.decision.course import Course, Courses, Look
from octoprint_moop.core.decision.decide import (
    FAILED,
    MATTER_LIMIT_RATIO,
    OK,
    PARDON,
    SUSPECT,
    UNUSABLE,
    accept,
    pardon,
)
from octoprint_moop.core.decision.diagnose import Diagnosis
from octoprint_moop.core.header import Moment

TOTAL_PX = 20_000
LIMIT_PX = MATTER_LIMIT_RATIO * TOTAL_PX


def look(limits: float = 0.0, share: float = 1.0, objects: int = 0) -> Look:
    """So many limits of stray matter; of the fresh matter, that share is seen."""
    fresh = tuple((200 * n, int(200 * n * share)) for n in (1, 2, 4, 8))
    stray_px = int(limits * LIMIT_PX)
    scopes = tuple(
        Evidence(number, 9000, TOTAL_PX, 0, 8000, 0, stray_px, 600, 0, 0, 900, 0, stray_px, fresh)
        for number in (WHOLE, *range(objects))
    )
    return Look(Comparison(9000, 9000 + stray_px, 0, stray_px, 0, TOTAL_PX), scopes=scopes)


def course_after_good(checks: int = 10, sensitivity: str = "medium") -> Course:
    course = Course(sensitivity)
    for _ in range(checks):
        course.rule(look())
    return course


def verdict(course: Course, seen: Look, again: bool = False) -> str:
    return course.rule(seen, again).worst.verdict


def test_what_only_one_of_two_frames_shows_is_taken_back():
    course = course_after_good()
    assert verdict(course, look(5.0)) == FAILED
    assert verdict(course, look(), again=True) == OK
    # as if it had never been: two limits and a half would follow a sum of some size to a failure
    assert [verdict(course, look(1.5)) for _ in range(2)] == [SUSPECT, SUSPECT]


def test_what_both_frames_show_is_a_failure_sooner_than_what_one_shows():
    course = course_after_good()
    assert verdict(course, look(2.5)) == SUSPECT
    assert verdict(course, look(2.4), again=True) == FAILED
    assert verdict(course_after_good(), look(2.4)) == SUSPECT


def test_only_as_much_as_both_frames_show_counts():
    course = course_after_good()
    course.rule(look(9.0))
    worst = course.rule(look(1.2), again=True).worst
    assert worst.leading.size == pytest.approx(1.2, abs=0.02) and worst.verdict == SUSPECT


def test_contour_that_came_inwards_in_one_frame_alone_has_not():
    course = course_after_good()
    sunk = replace(look(), scopes=tuple(replace(scope, sunk_px=60) for scope in look().scopes))
    assert verdict(course, look(1.5)) == SUSPECT
    assert verdict(course, sunk, again=True) == OK


def test_a_weak_suspicion_looked_at_twice_counts_once():
    course = course_after_good()
    for _ in range(3):
        assert verdict(course, look(1.05)) == SUSPECT
        course.rule(look(1.05), again=True)
    twice, once = course.rule(look(1.05)), course_after_good()
    for _ in range(4):
        ruling = once.rule(look(1.05))
    assert twice.worst.cusum == pytest.approx(ruling.worst.cusum)


def test_a_second_look_at_a_good_state_teaches_nothing_new():
    course = course_after_good()
    assert course.rule(look()).teaches
    assert not course.rule(look(), again=True).teaches


def test_a_second_look_that_finds_all_well_teaches_what_the_first_could_not():
    course = course_after_good()
    assert not course.rule(look(5.0)).teaches
    assert course.rule(look(), again=True).teaches


def test_the_first_check_of_a_print_is_no_failure_however_often_it_is_looked_at():
    course = Course("medium")
    assert [verdict(course, look(9.0), again) for again in (False, True, True)] == [SUSPECT] * 3
    assert verdict(course, look(9.0)) == FAILED


def test_a_failure_whose_second_frame_cannot_be_used_is_suspect_until_the_next_layer():
    course = course_after_good()
    assert verdict(course, look(5.0)) == FAILED
    ruling = course.unconfirmed()
    assert ruling.worst.verdict == SUSPECT and {one.verdict for one in ruling.outcomes} == {SUSPECT}
    assert verdict(course, look(5.0)) == FAILED
    assert Course("medium").unconfirmed() is None


@pytest.mark.parametrize("limits", [0.5, 0.9, 1.3, 2.5])
def test_what_is_learned_does_not_depend_on_the_sensitivity(limits):
    """The very reason why looks can be kept."""
    seen = [look()] * 6 + [look(limits)] * 8 + [look()] * 3
    teaching = []
    for sensitivity in ("low", "medium", "high"):
        course = Course(sensitivity)
        teaching.append([course.rule(one).teaches for one in seen])
    assert teaching[0] == teaching[1] == teaching[2]


def test_a_more_sensitive_course_suspects_wherever_a_less_sensitive_one_does():
    """So looks that were named where the most sensitive course suspects are named wherever any does."""
    seen = [look(objects=2)] * 6 + [look(limits, objects=2) for limits in (0.4, 0.7, 0.9, 1.1, 0.2, 2.2, 0.0, 1.9, 3.5)]
    courses = {name: Course(name) for name in ("low", "medium", "high")}
    for one in seen:
        outcomes = {name: course.rule(one).outcomes for name, course in courses.items()}
        for low, medium, high in zip(outcomes["low"], outcomes["medium"], outcomes["high"]):
            order = [OK, SUSPECT, FAILED]
            assert order.index(low.verdict) <= order.index(medium.verdict) <= order.index(high.verdict)


def test_what_the_user_accepted_is_judged_anew():
    course = course_after_good()
    assert verdict(course, look(5.0)) == FAILED
    course.begin_anew(accept)
    assert verdict(course, look(), again=True) == OK  # there is nothing left that could be confirmed


def test_whatever_failed_before_the_user_said_that_it_had_not_is_less_easily_surprising_and_nothing_else():
    def with_stray(*limits: float) -> Look:
        """So many limits of stray matter beside each of the objects, and all of it beside the whole."""
        scopes = (look(sum(limits)).scopes[0], *(look(each).scopes[0] for each in limits))
        return replace(look(), scopes=tuple(replace(one, object_id=n - 1) for n, one in enumerate(scopes)))

    course = Course("medium")
    for _ in range(10):
        course.rule(with_stray(0, 0, 0))
    for limits in ((5, 0, 0), (0, 5, 0)):
        failed = {one.object_id for one in course.rule(with_stray(*limits)).outcomes if one.verdict == FAILED}
        assert failed == {WHOLE, limits.index(5)}
    course.begin_anew(pardon)
    wide = {n: track.wide for n, track in course._state.tracks.items()}
    assert wide == {WHOLE: PARDON, 0: PARDON, 1: PARDON, 2: 1.0}


def test_only_a_look_at_the_same_state_can_be_a_second_one():
    def cusum(file_pos: int) -> float:
        """Of a good look that says that it is a second one, after one that found much at 100."""
        courses = Courses("medium")
        for _ in range(10):
            courses.rule(look(), Moment("", 0, 0, (0.0, 0.0, 0.0)))
        courses.rule(look(2.0), Moment("", 100, 0, (0.0, 0.0, 0.0)))
        _, ruling = courses.rule(look(), Moment("", file_pos, 0, (0.0, 0.0, 0.0), again=True))
        return ruling.worst.cusum

    assert cusum(100) == 0 < cusum(200)


def test_matter_of_an_object_with_whose_failure_the_user_went_on_is_not_missed_from_the_whole():
    def with_dead(share: float, barren_px: int = 400) -> Look:
        """Of three objects the first gets that share of its matter, the others all of it."""
        well = look().scopes[0]
        dead = replace(look(share=share).scopes[0], object_id=0, deep_px=400, barren_px=0 if share else barren_px)
        fresh = tuple((3 * new, 2 * new + seen) for new, seen in dead.fresh)
        whole = replace(well, fresh=fresh, deep_px=1200, barren_px=dead.barren_px)
        return replace(look(), scopes=(whole, dead, *(replace(well, object_id=n, deep_px=400) for n in (1, 2))))

    course = Course("medium")
    for _ in range(10):
        course.rule(with_dead(1.0))
    assert [course.rule(with_dead(0.0)).worst.verdict for _ in range(2)][1] == FAILED
    course.begin_anew(accept)
    assert {course.rule(with_dead(0.0, 100 + 30 * n)).worst.verdict for n in range(30)} == {OK}


def test_matter_beside_a_print_that_is_hardly_seen_is_suspect_at_most():
    """A camera that is set up a little wrong shows as much, and there is nothing to tell it by."""
    course = course_after_good()
    assert {verdict(course, replace(look(9.0), little="The head.")) for _ in range(5)} == {SUSPECT}
    assert verdict(course, look(9.0)) == FAILED


def test_where_a_quarter_is_usually_not_as_expected_all_well_is_not_said_but_a_failure_is():
    """Stray pixels that are usual raise no alarm, and yet hardly anything could be told from such a picture."""
    courses = Courses("medium")

    def check(wrong_px: int, limits: float = 0.0) -> Check:
        seen = look(limits)
        seen = replace(seen, scopes=tuple(replace(scope, xor_px=wrong_px) for scope in seen.scopes))
        seen = replace(seen, names={WHOLE: Diagnosis("stray_material", "Material lies where none should be.")})
        return Check.of(Moment("", 0, 0, (0.0, 0.0, 0.0)), *courses.rule(seen, Moment("", 0, 0, (0.0, 0.0, 0.0))), [])

    checks = [check(int(0.3 * TOTAL_PX)) for _ in range(5)]
    assert [one.verdict for one in checks] == [OK] * 3 + [UNUSABLE] * 2
    assert "Calibrate the camera" in checks[-1].reason
    assert check(int(0.3 * TOTAL_PX), 9.0).verdict == FAILED
    courses.begin_anew(accept)  # with what lies about, of which the user knows
    assert [check(int(0.3 * TOTAL_PX)).verdict for _ in range(6)] == [OK] * 6


def test_a_look_survives_json():
    one = Look(look(2.0, objects=2).comparison, "", "", look(2.0, objects=2).scopes, {0: Diagnosis("warping", "Up.")})
    assert Look.from_json(json.loads(json.dumps(one.to_json()))) == one
    turned = replace(look(9.0), turned=True)
    assert Look.from_json(json.loads(json.dumps(turned.to_json()))) == turned
    blind = Look(blind="unusable", reason="black", little="The head.")
    assert Look.from_json(json.loads(json.dumps(blind.to_json()))) == blind


def after(blind: str, *seen: Look) -> list[str]:
    """Verdicts of what follows eight good looks and a blind one; a blind one among `seen` has none."""
    courses, moment = Courses("medium"), Moment("1.jpg", 10, 0, (0.0, 0.0, 0.0))
    for _ in range(8):
        courses.rule(look(), moment)
    found = [courses.rule(one, moment)[1] for one in (Look(blind=blind, reason="Why."), *seen)]
    return [ruling.worst.verdict for ruling in found if ruling is not None]


@pytest.mark.parametrize("blind", ["camera_moved", "unusable"])
def test_right_after_nothing_could_be_seen_one_look_is_not_enough_but_two_are(blind):
    assert after(blind, look(9.0), look(9.0)) == [SUSPECT, FAILED]
    assert after(blind, look(), look(9.0)) == [OK, FAILED]


def test_a_failure_between_two_obstacles_is_a_failure_and_one_between_two_knocks_may_be_the_camera():
    assert after("unusable", look(9.0), Look(blind="unusable"), look(9.0)) == [SUSPECT, FAILED]
    assert after("camera_moved", look(9.0), Look(blind="camera_moved"), look(9.0)) == [SUSPECT, SUSPECT]


def test_the_frame_in_which_the_camera_is_first_found_elsewhere_raises_no_alarm_by_itself():
    courses, moment = Courses("medium"), Moment("", 0, 0, (0.0, 0.0, 0.0))
    turned = replace(look(9.0), turned=True)
    rulings = [courses.rule(one, moment)[1] for one in (*[look()] * 8, turned, look(9.0))]
    assert [ruling.worst.verdict for ruling in rulings[-2:] if ruling] == [SUSPECT, FAILED]


def test_five_looks_through_a_hand_excuse_no_failure_longer_than_one_check():
    course = course_after_good()
    for _ in range(5):
        course.blind("unusable")
    assert [verdict(course, look(9)) for _ in range(2)] == [SUSPECT, FAILED]


def test_a_camera_that_is_blind_most_of_the_time_only_suspects_until_it_has_seen_as_much_as_it_missed():
    course = course_after_good()
    for _ in range(6):
        course.blind("unusable")
    # ten looks back, the six blind ones and four that saw; the fifth that sees leaves five of each
    assert [verdict(course, look(9)) for _ in range(5)] == [SUSPECT] * 4 + [FAILED]


def test_a_camera_that_sees_one_layer_of_three_raises_no_alarm():
    course = course_after_good()
    seen = []
    for _ in range(12):
        course.blind("unusable")
        course.blind("unusable")
        seen.append(verdict(course, look(9)))
    assert seen[3:] == [SUSPECT] * 9


def covered(share: float, turned: bool = False) -> Look:
    """All is well, but of 1,000 pixels in each window that share is covered."""
    seen = look()
    come = ((1000, round(1000 * share)),) * 4
    return replace(seen, scopes=tuple(replace(one, come=come) for one in seen.scopes), turned=turned)


def test_two_layers_of_which_nothing_is_covered_are_a_failure():
    course = Course("medium")
    assert [verdict(course, covered(0.7)) for _ in range(6)] == [OK] * 6
    assert [verdict(course, covered(0.1)), verdict(course, covered(0.0))] == [SUSPECT, FAILED]


def test_once_the_camera_stands_elsewhere_what_is_usually_covered_is_learned_anew():
    course = Course("medium")
    for _ in range(6):
        course.rule(covered(0.7))
    assert [verdict(course, covered(0.3, turned=n == 0)) for n in range(5)] == [OK] * 5
    assert verdict(course, covered(0.0)) == SUSPECT


def strange(course: Course, again: bool = False) -> str:
    """Half of the print looks otherwise, and only a hundredth of it is borne out to have gone."""
    seen = look()
    scopes = tuple(replace(one, lost_px=400, xor_px=10_000) for one in seen.scopes)
    return verdict(course, replace(seen, scopes=scopes), again)


def test_what_hardly_explains_what_differs_is_suspect_for_five_checks_and_a_failure_then():
    course = course_after_good()
    assert [strange(course) for _ in range(6)] == [SUSPECT] * 5 + [FAILED]


def test_a_second_look_at_what_is_strange_makes_the_five_checks_no_fewer():
    course = course_after_good()
    assert [(strange(course), strange(course, again=True)) for _ in range(5)] == [(SUSPECT, SUSPECT)] * 5
    assert strange(course) == FAILED


def test_what_once_was_strange_may_be_strange_again_and_the_user_who_went_on_knows():
    course = course_after_good()
    assert [strange(course) for _ in range(3)] == [SUSPECT] * 3
    for _ in range(6):
        course.rule(look())
    assert [strange(course) for _ in range(3)] == [SUSPECT] * 3
    course.begin_anew(accept)
    course.rule(look())
    assert strange(course) == FAILED


def test_what_hides_behind_the_head_teaches_nothing_so_the_first_plain_sight_of_the_print_only_suspects():
    course = Course("medium")
    for _ in range(4):
        course.rule(replace(look(), little="The print head hides the print."))
    assert [verdict(course, look(9)) for _ in range(2)] == [SUSPECT, FAILED]
