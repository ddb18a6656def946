"""Silhouettes drawn twice, the second time displaced by what is known: is it found again?"""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from octoprint_moop.core.decision import align
from octoprint_moop.core.decision.memory import Memory

SHAPE = (200, 260)
MIDDLE, FINE = np.array([130.0, 100.0]), 16
PARTS = (
    [(60, 60), (110, 52), (118, 120), (66, 132)],
    [(140, 70), (200, 80), (190, 95), (165, 92), (160, 140), (138, 136)],
)


def drawn(offset=(0.0, 0.0), turn_deg=0.0, scale=1.0, parts=PARTS) -> np.ndarray:
    """(H, W) bool: the parts, their corners turned and scaled about MIDDLE and offset, to a sixteenth of a pixel."""
    angle = np.radians(turn_deg)
    matrix = scale * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    picture = np.zeros(SHAPE, np.uint8)
    for part in parts:
        corners = (np.array(part, float) - MIDDLE) @ matrix.T + MIDDLE + offset
        cv2.fillPoly(picture, [np.round(corners * FINE).astype(np.int32)], 255, cv2.LINE_AA, 4)
    return picture > 127


def fitted(observed: np.ndarray, known: np.ndarray | None = None, start=(0.0, 0.0), wanted=None) -> align.Fit | None:
    wanted = drawn() if wanted is None else wanted
    begin = align.Alignment(start, middle_px=tuple(MIDDLE), reach_px=75.0)
    return align.fit(wanted, 0, 0, observed, np.ones(SHAPE, bool) if known is None else known, begin)


CORNERS = np.array([corner for part in PARTS for corner in part], float)


@pytest.mark.parametrize("offset", [(0.0, 0.0), (0.5, -0.3), (2.4, 1.7), (-3.0, 0.0)])
def test_an_offset_is_found_to_the_fraction_of_a_pixel_that_masks_can_hold(offset):
    found = fitted(drawn(offset)).alignment
    assert found.at(CORNERS) == pytest.approx(np.tile(offset, (len(CORNERS), 1)), abs=0.4)
    assert found.offset_px == pytest.approx(offset, abs=0.35)


@pytest.mark.parametrize(("turn_deg", "scale"), [(1.0, 1.0), (0.0, 1.02), (-0.8, 0.985)])
def test_a_turn_and_a_change_of_scale_are_found(turn_deg, scale):
    angle = np.radians(turn_deg)
    matrix = scale * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    truth = (CORNERS - MIDDLE) @ matrix.T + MIDDLE - CORNERS
    assert fitted(drawn(turn_deg=turn_deg, scale=scale)).alignment.at(CORNERS) == pytest.approx(truth, abs=0.35)


def test_a_halo_all_around_moves_nothing_and_is_told():
    wide = cv2.dilate(drawn((1.0, 0.0)).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    found = fitted(wide)
    assert found.alignment.offset_px == pytest.approx((1.0, 0.0), abs=0.1)
    assert found.halo_px == pytest.approx(1.0, abs=0.2)


def test_a_part_that_has_come_off_does_not_draw_the_rest_along():
    away = drawn((1.5, 0.0), parts=PARTS[:1]) | drawn((14.0, 9.0), parts=PARTS[1:])
    wanted = drawn() | drawn((0.0, 40.0), parts=PARTS[:1])
    away |= drawn((1.5, 40.0), parts=PARTS[:1])
    found = fitted(away, wanted=wanted)
    assert found.alignment.at(CORNERS[:4]) == pytest.approx(np.tile((1.5, 0.0), (4, 1)), abs=0.5)


def test_contours_that_are_hidden_have_no_say():
    known = np.ones(SHAPE, bool)
    known[:, 130:] = False
    seen = drawn((2.0, -1.0), parts=PARTS[:1])  # of the hidden part nothing is seen
    found = fitted(seen, known=known)
    assert found is None or found.alignment.offset_px == pytest.approx((2.0, -1.0), abs=0.3)


def test_where_nothing_is_seen_nothing_is_said():
    assert fitted(np.zeros(SHAPE, bool)) is None
    assert fitted(drawn(), wanted=np.zeros(SHAPE, bool)) is None


def test_the_coarse_search_finds_whole_pixels_and_prefers_none_where_it_cannot_tell():
    wanted = drawn()[20:180, 20:240]
    known = np.ones(SHAPE, bool)
    for offset in ((0, 0), (7, -4), (-12, 15)):
        assert align.coarse(wanted, drawn(offset), known, 20) == offset
    assert align.coarse(wanted, drawn((7, -4)), ~known, 20) == (0, 0)


def test_laying_a_picture_upon_the_expected_mask_takes_the_displacement_out():
    found = align.Alignment((3.0, -2.0), (0.0, -1.3, 1.3, 0.0), tuple(MIDDLE), 75.0)  # a turn of one degree
    matrix = found.inverse_map(20, 10)
    aligned = cv2.warpAffine(
        drawn((3.0, -2.0), turn_deg=1.0).astype(np.uint8) * 255, matrix, (200, 150),
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
    )  # fmt: skip
    assert np.count_nonzero((aligned > 127) != drawn()[10:160, 20:220]) < 0.02 * np.count_nonzero(drawn())


def test_a_step_towards_another_alignment_is_no_longer_than_allowed():
    here = align.Alignment(middle_px=(1, 1), reach_px=10.0)
    there = align.Alignment((3.0, 4.0), (0.0, 0.0, 0.0, 0.0), (1, 1), 10.0)
    assert here.towards(there, 0.5).offset_px == pytest.approx((0.3, 0.4))
    assert here.towards(there, 50.0).offset_px == pytest.approx((3.0, 4.0))
    assert there.within(1.0).most_px == pytest.approx(1.0) and there.within(6.0) == there


def test_labels_are_displaced_to_where_the_picture_shows_them():
    labels = drawn(parts=PARTS[:1]).astype(np.uint32) + 70_000 * drawn(parts=PARTS[1:])
    there = fitted(drawn((2.4, -1.7), 1.0)).alignment.displaced(labels.astype(np.uint32))
    for part, label in ((PARTS[:1], 1), (PARTS[1:], 70_000)):
        true = drawn((2.4, -1.7), 1.0, parts=part)
        assert np.count_nonzero(true != (there == label)) < 0.03 * np.count_nonzero(true)
    assert set(np.unique(there)) == {0, 1, 70_000}


def test_a_misfit_goes_along_with_a_print_that_is_seen_elsewhere_because_its_bed_has_moved():
    memory = Memory(None, (200, 300))
    memory.misfit.alignment = align.Alignment((1.0, -0.5), (0.6, 0.2, -0.3, 0.4), (80.0, 60.0), 40.0)
    before, points = memory.misfit.alignment, np.array([[60.0, 40.0], [100.0, 80.0], [80.0, 60.0]])
    moved = np.array([[1.5, 0, 40.0], [0, 1.5, -10.0], [0, 0, 1]])
    memory.carried(moved, (200, 300))
    assert memory.misfit.alignment.at(points * 1.5 + [40, -10]) == pytest.approx(before.at(points))


LINE = [(30, 40), (31, 40), (71, 180), (70, 180)]  # a line with which the nozzle was primed, left of all else


def test_a_line_that_is_hardly_seen_says_nothing_of_where_the_print_lies():
    """Of the line only its upper third is seen, and that two pixels too far left: where pixels cross a threshold by chance."""
    low = [[(100, 150), (150, 146), (152, 164), (102, 168)]]
    wanted, body = drawn(parts=[*low, LINE]), drawn(parts=low)
    strand = drawn(offset=(-2.5, 0.0), parts=[LINE])
    strand[85:] = False
    told = fitted(body | strand, wanted=wanted).alignment
    assert told.at(np.array(low[0], float)) == pytest.approx(np.zeros((4, 2)), abs=0.3)
    whole = fitted(drawn(offset=(-2.0, 0.0), parts=[*low, LINE]), wanted=wanted).alignment
    assert whole.at(np.array(LINE, float)) == pytest.approx(np.tile((-2.0, 0.0), (4, 1)), abs=0.4)
