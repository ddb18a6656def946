"""What a check saw, painted for people."""

from __future__ import annotations

import numpy as np

from octoprint_moop.core.overlay import EXTRA, MATCHED, MISSING, difference


def painted() -> tuple[np.ndarray, np.ndarray]:
    frame = np.full((60, 120, 3), 200, np.uint8)
    expected, observed, ignored = (np.zeros((60, 120), np.uint8) for _ in range(3))
    expected[10:50, 10:70] = 255
    observed[10:50, 40:110] = 255
    ignored[:, 90:] = 255
    return frame, difference(frame, expected, observed, ignored)


def test_matched_missing_and_extra_matter_each_have_their_own_outline() -> None:
    _, picture = painted()
    assert tuple(picture[10, 50]) == MATCHED.colour_bgr
    assert tuple(picture[10, 20]) == MISSING.colour_bgr
    assert tuple(picture[10, 80]) == EXTRA.colour_bgr


def test_the_kinds_can_be_told_apart_without_colour() -> None:
    _, picture = painted()
    inked = [
        np.mean((picture[14:46, x : x + 16] == ink.colour_bgr).all(axis=2))
        for x, ink in ((52, MATCHED), (14, MISSING), (72, EXTRA))
    ]
    assert inked[0] == 0 < 0.1 < inked[1] < 0.75 * inked[2]


def test_what_is_ignored_or_bare_stays_as_the_camera_saw_it() -> None:
    frame, picture = painted()
    assert np.array_equal(picture[:, 91:], frame[:, 91:]) and np.array_equal(picture[:9], frame[:9])
