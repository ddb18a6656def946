"""Masks that are moved about, against what plain NumPy makes of them."""

from __future__ import annotations

import numpy as np
import pytest

from octoprint_moop.core.decision.shapes import best_place, displaced, middle_of


@pytest.mark.parametrize("offset_px", [(0, 0), (3, 2), (-4, 5), (7, -6), (-19, 0), (25, 3), (0, -40)])
def test_a_mask_is_displaced_by_whole_pixels_and_what_leaves_the_picture_is_gone(offset_px):
    mask = np.random.default_rng(1).random((18, 24)) > 0.6
    right, down = offset_px
    wide = np.zeros((118, 124), bool)
    wide[50:68, 50:74] = mask
    assert np.array_equal(displaced(mask, offset_px), np.roll(wide, (down, right), (0, 1))[50:68, 50:74])


def test_the_middle_of_a_mask_is_the_mean_of_its_pixels_and_of_none_the_corner():
    mask = np.zeros((30, 40), bool)
    assert middle_of(mask).tolist() == [0, 0]
    mask[12:19, 20:33] = np.random.default_rng(2).random((7, 13)) > 0.5
    assert middle_of(mask) == pytest.approx(np.argwhere(mask).mean(axis=0)[::-1])


def test_a_part_is_found_where_it_was_put_and_not_beyond_its_reach():
    part = np.zeros((60, 80), bool)
    part[20:30, 30:42] = np.random.default_rng(3).random((10, 12)) > 0.3
    pays = np.where(displaced(part, (9, -6)), np.float32(1), np.float32(-1))
    assert best_place(part, pays) == best_place(part, pays, reach_px=9) == (9, -6)
    assert max(np.abs(best_place(part, pays, reach_px=5))) <= 5
