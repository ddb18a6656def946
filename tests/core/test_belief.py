"""When a turn of the camera is believed, from losses that are made up: what they should lead to is plain."""

from __future__ import annotations

import numpy as np
import pytest

from octoprint_moop.core.view.belief import AT_ONCE, TWICE, Gain
from octoprint_moop.core.view.fit import contrast_of

SURE_PX, UNRIVALLED = 0.1, np.inf


def losses(rng: np.random.Generator, fits: np.ndarray) -> np.ndarray:
    """About 1 where a landmark fits, nearly 9 where it does not."""
    return np.where(fits, rng.uniform(0, 2, fits.size), rng.uniform(6.5, 9, fits.size))


def gain(speaking: int, silent: int, against: int, points: tuple[int, int, int] = (40, 40, 40)) -> Gain:
    """Of a picture with so many regions, of so many landmarks each: in the silent ones chance decides, one by one."""
    rng = np.random.default_rng(3)
    kind = np.repeat([0, 1, 2], (speaking, silent, against))
    region, kind = np.repeat(np.arange(len(kind)), np.array(points)[kind]), np.repeat(kind, np.array(points)[kind])
    coin = rng.random((2, region.size)) < 0.5
    old, new = np.where(kind == 1, coin[0], kind == 2), np.where(kind == 1, coin[1], kind == 0)
    return Gain.of(region, losses(rng, old), losses(rng, new))


def test_a_turn_that_half_of_the_picture_speaks_for_is_believed():
    assert gain(speaking=10, silent=0, against=0).meets(AT_ONCE, 20, SURE_PX, UNRIVALLED)


def test_regions_in_which_chance_decides_have_no_say_against_a_turn():
    told = gain(speaking=8, silent=16, against=0, points=(40, 12, 40))
    assert (told.mean < -1).any()
    assert told.meets(TWICE, 20, SURE_PX, UNRIVALLED)


@pytest.mark.parametrize("against", [2, 4])
def test_regions_that_plainly_speak_against_it_outweigh_more_that_speak_for_it(against):
    assert not gain(speaking=9, silent=0, against=against, points=(200, 40, 30)).meets(AT_ONCE, 20, SURE_PX, UNRIVALLED)


def test_chance_alone_is_no_turn():
    told = gain(speaking=0, silent=48, against=0)
    assert not told.likely
    assert not told.meets(TWICE, 20, SURE_PX, UNRIVALLED)


def test_a_turn_that_is_not_told_to_a_pixel_is_not_believed_unless_it_is_far():
    told = gain(speaking=12, silent=0, against=0)
    assert not told.meets(AT_ONCE, 10, 0.25, UNRIVALLED)
    assert told.meets(AT_ONCE, 40, 0.25, UNRIVALLED)


def test_contrast_is_told_by_what_is_seen_however_much_is_hidden():
    rng = np.random.default_rng(5)
    height = rng.normal(0, 20, 300)
    seen, apart = 0.6 * height + rng.normal(0, 1, 300), np.full(300, 4.0)
    seen[:120] = rng.normal(0, 1, 120)  # a plain head stands before them
    assert contrast_of(seen, height, apart) == pytest.approx(0.6, rel=0.2)


def test_a_turn_that_another_fits_as_well_is_not_believed():
    told = gain(speaking=12, silent=0, against=0)
    assert not told.meets(AT_ONCE, 20, SURE_PX, 1.0)
    assert told.meets(TWICE, 20, SURE_PX, 1.0)
    assert not told.meets(TWICE, 20, SURE_PX, 0.2)
