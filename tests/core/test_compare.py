"""E to the letter, against counts made pixel by pixel in plain Python."""

from __future__ import annotations

from dataclasses import FrozenInstanceError

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from octoprint_moop.core.decision.compare import compare

MASKS = arrays(np.uint8, (5, 7), elements=st.sampled_from([0, 255]))


@given(MASKS, MASKS, MASKS, MASKS)
def test_every_count_is_that_of_a_plain_loop_over_pixels(expected, observed, complete, ignored):
    counts = dict.fromkeys(("expected", "observed", "missing", "extra", "ignored", "total"), 0)
    for row in range(5):
        for column in range(7):
            if ignored[row, column]:
                counts["ignored"] += 1
                continue
            wanted, seen = bool(expected[row, column]), bool(observed[row, column])
            counts["expected"] += wanted
            counts["observed"] += seen
            counts["missing"] += wanted and not seen
            counts["extra"] += seen and not wanted
            counts["total"] += bool(complete[row, column])
    found = compare(expected, observed, complete, ignored)
    assert (found.expected_px, found.observed_px) == (counts["expected"], counts["observed"])
    assert (found.missing_px, found.extra_px) == (counts["missing"], counts["extra"])
    assert (found.ignored_px, found.total_px) == (counts["ignored"], counts["total"])
    assert found.xor_px == counts["missing"] + counts["extra"]
    assert found.error_ratio == pytest.approx(found.xor_px / max(counts["total"], 1))


def test_e_is_in_parts_of_the_complete_object_not_of_what_stands_now():
    expected, observed, complete = (np.zeros((10, 10), np.uint8) for _ in range(3))
    expected[:2], observed[:1], complete[:] = 255, 255, 255
    found = compare(expected, observed, complete)
    assert found.error_ratio == 0.1 and found.ignored_px == 0
    with pytest.raises(FrozenInstanceError):
        found.total_px = 1


def test_a_view_without_any_print_has_no_error():
    nothing = np.zeros((4, 4), np.uint8)
    assert compare(nothing, nothing, nothing).error_ratio == 0


def test_masks_of_different_sizes_are_refused():
    right = np.zeros((4, 4), np.uint8)
    for shape in ((4, 5), (3, 4), (5, 3)):
        wrong = np.zeros(shape, np.uint8)
        for masks in ((right, wrong, right), (right, right, wrong), (right, right, right, wrong)):
            with pytest.raises(ValueError, match="different sizes"):
                compare(*masks)
