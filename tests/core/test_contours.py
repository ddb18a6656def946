"""Contours that have come inwards since all was well."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from octoprint_moop.core.decision.contours import Contours

SHAPE = (120, 160)
WINDOW = slice(0, SHAPE[0]), slice(0, SHAPE[1])
CORNERS = np.array([(40, 30), (120, 30), (120, 90), (40, 90)], float)
KNOWN = np.ones(SHAPE, bool)
BED = np.full((3, *SHAPE), 90, np.uint8)


def bed() -> np.ndarray:
    """Where nothing looks unlike the bed, or nothing is known of it."""
    return np.zeros(SHAPE, np.uint8)


def drawn(corners: np.ndarray) -> np.ndarray:
    """(h, w) bool: a body with these corners, to an eighth of a pixel."""
    mask = np.zeros(SHAPE, np.uint8)
    cv2.fillPoly(mask, [np.rint(corners * 8).astype(np.int32)], 1, shift=3)
    return mask > 0


def ragged(rng: np.random.Generator) -> np.ndarray:
    """The body as a noisy segmentation sees it: its edge a pixel off here and there."""
    body = drawn(CORNERS).astype(np.float32)
    return cv2.GaussianBlur(body, (0, 0), 1.0) + rng.normal(0, 0.25, SHAPE) * cv2.GaussianBlur(body, (0, 0), 2.0) > 0.5


@pytest.fixture
def known_well() -> Contours:
    contours = Contours(SHAPE)
    for _ in range(4):
        contours.learn(WINDOW, drawn(CORNERS), BED, drawn(CORNERS), KNOWN)
    return contours


def risen(by_px: float) -> np.ndarray:
    corners = CORNERS.copy()
    corners[2, 1] -= by_px
    return drawn(corners)


def test_where_a_corner_has_risen_its_foot_has_come_inwards(known_well: Contours) -> None:
    sunk = known_well.sunk(WINDOW, drawn(CORNERS), BED, risen(4.0), KNOWN, bed)
    rows, columns = np.nonzero(sunk)
    # the foot runs from (40, 90) to the corner, and has come in by more than a pixel from a quarter of it on
    assert 45 < len(columns) < 75
    assert (rows == 90).all()
    assert columns.min() > 55


def test_what_comes_inwards_all_around_is_light_and_not_the_print(known_well: Contours) -> None:
    shrunken = cv2.erode(drawn(CORNERS).astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    assert not known_well.sunk(WINDOW, drawn(CORNERS), BED, shrunken, KNOWN, bed).any()


def test_a_corner_that_rises_as_the_light_changes_is_found(known_well: Contours) -> None:
    shrunken = cv2.erode(risen(5.0).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    sunk = known_well.sunk(WINDOW, drawn(CORNERS), BED, shrunken, KNOWN, bed)
    assert np.count_nonzero(sunk[90]) > 40
    assert not np.delete(sunk, 90, axis=0).any()


def test_where_a_shadow_falls_on_both_sides_of_an_edge_nothing_has_risen(known_well: Contours) -> None:
    shade = BED.copy()
    shade[:, 85:, 70:] //= 2
    assert not known_well.sunk(WINDOW, drawn(CORNERS), shade, risen(4.0), KNOWN, bed).any()
    shade[:, 91:] = 90
    assert known_well.sunk(WINDOW, drawn(CORNERS), shade, risen(4.0), KNOWN, bed).any()


def test_a_foot_that_is_no_more_seen_but_looks_less_like_the_bed_than_the_bed_is_matter_in_shade(
    known_well: Contours,
) -> None:
    """Just outside of an edge a picture shows a mixture: that of all edges, where the bed has come into sight."""
    mixture = np.where(cv2.dilate(risen(4.0).view(np.uint8), np.ones((5, 5))) > 0, np.uint8(30), np.uint8(3))
    assert known_well.sunk(WINDOW, drawn(CORNERS), BED, risen(4.0), KNOWN, lambda: mixture).any()
    shaded = np.where(drawn(CORNERS) & ~risen(4.0), np.uint8(70), mixture)
    assert not known_well.sunk(WINDOW, drawn(CORNERS), BED, risen(4.0), KNOWN, lambda: shaded).any()


def test_what_moves_as_a_whole_is_no_corner_that_rises(known_well: Contours) -> None:
    assert not known_well.sunk(WINDOW, drawn(CORNERS), BED, drawn(CORNERS + [0, -2]), KNOWN, bed).any()


def test_edges_that_are_seen_raggedly_have_not_come_inwards() -> None:
    rng, contours = np.random.default_rng(5), Contours(SHAPE)
    for _ in range(30):
        seen = ragged(rng)
        assert not contours.sunk(WINDOW, drawn(CORNERS), BED, seen, KNOWN, bed).any()
        contours.learn(WINDOW, drawn(CORNERS), BED, seen, KNOWN)


def test_an_edge_that_was_never_seen_elsewhere_has_not_moved() -> None:
    assert not Contours(SHAPE).sunk(WINDOW, drawn(CORNERS), BED, risen(4.0), KNOWN, bed).any()


def test_an_edge_keeps_the_place_where_it_was_seen_even_if_that_is_not_where_it_is_expected() -> None:
    contours = Contours(SHAPE)
    for _ in range(4):
        contours.learn(WINDOW, drawn(CORNERS), BED, risen(4.0), KNOWN)
    assert not contours.sunk(WINDOW, drawn(CORNERS), BED, risen(4.0), KNOWN, bed).any()
    assert contours.sunk(WINDOW, drawn(CORNERS), BED, risen(8.0), KNOWN, bed).any()


def test_a_slow_rise_is_not_learned_as_it_comes(known_well: Contours) -> None:
    for by_px in np.arange(0.0, 4.0, 0.1):
        known_well.learn(WINDOW, drawn(CORNERS), BED, risen(by_px), KNOWN)
    assert np.count_nonzero(known_well.sunk(WINDOW, drawn(CORNERS), BED, risen(4.0), KNOWN, bed)) > 20


def test_what_is_hidden_has_not_moved(known_well: Contours) -> None:
    known = KNOWN.copy()
    known[80:] = False
    assert not known_well.sunk(WINDOW, drawn(CORNERS), BED, risen(4.0), known, bed).any()


def test_lines_that_are_thin_come_and_go(known_well: Contours) -> None:
    wanted, half = drawn(CORNERS), drawn(CORNERS)
    wanted[100:104, 30:130] = half[100:102, 30:130] = True
    for _ in range(4):
        known_well.learn(WINDOW, wanted, BED, wanted, KNOWN)
    assert not known_well.sunk(WINDOW, wanted, BED, half, KNOWN, bed).any()


def test_a_bed_that_moves_carries_its_contours_along(known_well: Contours) -> None:
    known_well.carried(np.array([[1, 0, 10], [0, 1, 5], [0, 0, 1]], float), SHAPE)
    there = np.roll(risen(4.0), (5, 10), axis=(0, 1))
    sunk = known_well.sunk(WINDOW, drawn(CORNERS + [10, 5]), BED, there, KNOWN, bed)
    assert np.count_nonzero(sunk) > 45


def test_once_the_user_went_on_the_contours_are_where_they_are_seen_next(known_well: Contours) -> None:
    known_well.forget()
    for _ in range(2):
        known_well.learn(WINDOW, drawn(CORNERS), BED, risen(4.0), KNOWN)
    assert not known_well.sunk(WINDOW, drawn(CORNERS), BED, risen(4.0), KNOWN, bed).any()
