from __future__ import annotations

import cv2
import numpy as np
import pytest

from octoprint_moop.core.errors import FrameError
from octoprint_moop.core.view.glance import Glance
from octoprint_moop.core.view.usable import Occluders, Repeats, is_still, refuse_unusable


@pytest.fixture
def frame() -> np.ndarray:
    rng = np.random.default_rng(2)
    picture = cv2.resize(rng.integers(40, 120, (24, 32, 3)).astype(np.uint8), (640, 480))
    return np.clip(picture + rng.normal(0, 2, picture.shape), 0, 255).astype(np.uint8)


def test_an_ordinary_frame_is_used(frame):
    repeats = Repeats()
    for one in (frame, np.clip(frame.astype(int) + 1, 0, 255).astype(np.uint8), frame):
        refuse_unusable(one)
        repeats.refuse(one)


@pytest.mark.parametrize(
    ("spoil", "word"),
    [
        (lambda frame: frame // 20, "black"),
        (lambda frame: np.full_like(frame, 255), "white"),
        (lambda frame: np.full_like(frame, 90), "one colour"),
    ],
)
def test_a_frame_that_shows_nothing_is_refused_with_the_reason(frame, spoil, word):
    with pytest.raises(FrameError, match=word):
        refuse_unusable(spoil(frame))


def test_the_same_picture_twice_is_a_camera_that_hangs(frame):
    repeats = Repeats()
    repeats.refuse(frame)
    for _ in range(2):
        with pytest.raises(FrameError, match="same picture"):
            repeats.refuse(frame.copy())


def with_the_time(frame: np.ndarray, time: str) -> np.ndarray:
    return cv2.putText(frame.copy(), time, (380, 460), cv2.FONT_HERSHEY_SIMPLEX, 1.0, (255, 255, 255), 2)


def test_a_camera_that_hangs_while_its_clock_goes_on_delivers_the_same_picture(frame):
    rng, repeats = np.random.default_rng(4), Repeats()
    for minute in range(4):
        live = np.clip(frame + rng.normal(0, 2, frame.shape), 0, 255).astype(np.uint8)
        repeats.refuse(with_the_time(live, f"12:0{minute}:17"))
    with pytest.raises(FrameError, match="same picture"):
        repeats.refuse(with_the_time(live, "12:04:17"))


def test_a_camera_that_smooths_all_noise_away_is_not_taken_for_one_that_hangs(frame):
    repeats = Repeats()
    for minute in range(6):
        repeats.refuse(with_the_time(frame, f"12:0{minute}:17"))


def test_a_picture_cut_off_in_transfer_is_torn(frame):
    """JPEG decoders fill what never came with one value."""
    frame[300:] = 128
    with pytest.raises(FrameError, match="torn"):
        refuse_unusable(frame)


def small(picture: np.ndarray) -> np.ndarray:
    return Glance(picture).quarter


@pytest.mark.parametrize("gain", [0.85, 1.0, 1.15])
def test_noise_and_a_lamp_that_flickers_are_no_motion(frame, gain):
    noise = np.random.default_rng(8).normal(0, 4, frame.shape)
    assert is_still(frame, np.clip(frame * gain + noise, 0, 255).astype(np.uint8))


@pytest.mark.parametrize("step_px", [12, 40])
def test_a_head_that_goes_on_is_motion(frame, step_px):
    first, second = frame.copy(), frame.copy()
    first[100:220, 200:280] = second[100:220, 200 + step_px : 280 + step_px] = 15
    assert not is_still(first, second)
    assert is_still(first, first.copy())


def test_a_hand_is_found_and_filament_is_not_taken_for_one(frame):
    occluders = Occluders(small(frame))
    occluders.accept(small(frame))
    with_hand = frame.copy()
    cv2.ellipse(with_hand, (500, 340), (90, 120), 30, 0, 360, (130, 160, 220), -1)
    nothing = np.zeros((120, 160), np.uint8)
    found = occluders.find(small(with_hand), nothing, nothing)
    assert found[85, 125] == 255 and found[15, 15] == 0
    as_filament = nothing.copy()
    cv2.ellipse(as_filament, (125, 85), (23, 30), 30, 0, 360, 255, -1)
    assert not occluders.find(small(with_hand), as_filament, nothing).any()


def test_what_has_crept_in_slowly_and_was_accepted_hides_nothing(frame):
    """A gantry climbs a layer's height at a time: it differs from the reference, but not from the last good frame."""
    occluders = Occluders(small(frame))
    for top in range(200, 100, -1):
        climbing = frame.copy()
        climbing[top : top + 60] = (200, 200, 205)
        if top < 200:
            nothing = np.zeros((120, 160), np.uint8)
            assert not occluders.find(small(climbing), nothing, nothing).any()
        occluders.accept(small(climbing))


def test_a_hand_that_moves_on_keeps_hiding_the_view(frame):
    occluders, nothing = Occluders(small(frame)), np.zeros((120, 160), np.uint8)
    occluders.accept(small(frame))
    for x in (500, 400, 300):
        with_hand = cv2.ellipse(frame.copy(), (x, 380), (90, 90), 0, 0, 360, (130, 160, 220), -1)
        cv2.ellipse(with_hand, (x, 380), (40, 20), x, 0, 360, (40, 60, 90), -1)
        assert occluders.find(small(with_hand), nothing, nothing)[75, x // 4] == 255


def test_what_stands_elsewhere_than_for_the_reference_and_stays_there_is_scenery(frame):
    """A gantry beside the print is scenery at the second look, and at once where nothing was seen since the reference; a
    thing before the print's place only at the fourth."""
    changed = frame.copy()
    changed[40:120] = (180, 170, 60)
    apart, before = np.zeros((2, 120, 160), np.uint8)
    apart[75:100, 50:100] = 255
    before[25:100, 50:100] = 255
    for place, seen_before, looks in ((apart, True, 1), (apart, False, 0), (before, True, 3), (before, False, 3)):
        occluders = Occluders(small(frame))
        if seen_before:
            occluders.accept(small(frame))
        found = [occluders.find(small(changed), np.zeros_like(place), place).any() for _ in range(5)]
        assert found == [True] * looks + [False] * (5 - looks)


def test_a_hand_at_rest_whose_fingers_pass_for_filament_is_no_scenery_at_the_second_look(frame):
    """What is left of it beside the print lies a few pixels off: the arm, which a margin about the fingers cuts off."""
    with_hand = cv2.rectangle(frame.copy(), (280, 220), (440, 479), (130, 160, 220), -1)
    place, as_filament = np.zeros((2, 120, 160), np.uint8)
    place[40:80, 60:120] = 255
    as_filament[38:84, 60:120] = 255
    occluders = Occluders(small(frame))
    assert [occluders.find(small(with_hand), as_filament, place).any() for _ in range(5)] == [True] * 3 + [False] * 2


def test_a_thing_of_the_filaments_colour_that_reaches_into_the_picture_is_never_matter(frame):
    """A sleeve rests before the print: it hides it at first, and is known for what it is for as long as it stays."""
    sleeve = cv2.rectangle(frame.copy(), (430, 0), (560, 200), (20, 120, 230), -1)
    place, as_filament = np.zeros((2, 120, 160), np.uint8)
    place[45:80, 60:120] = 255
    as_filament[:51, 107:141] = 255
    occluders, nothing = Occluders(small(frame)), np.zeros_like(place)
    for look in range(8):
        assert occluders.find(small(sleeve), as_filament, place).any() == (look < 3)
        assert occluders.foreign[20, 120] == 255 and not occluders.foreign[100, 20]
        occluders.accept(small(sleeve))
    assert not occluders.find(small(frame), nothing, place).any() and not occluders.foreign.any()


def test_what_a_print_sheds_at_the_pictures_rim_is_not_taken_for_a_thing_that_reaches_in(frame):
    """The print itself stands at the rim, or strands of it hang out of the picture."""
    lump = cv2.rectangle(frame.copy(), (430, 300), (560, 479), (20, 120, 230), -1)
    strands = cv2.polylines(frame.copy(), [np.array([[400, 300], [480, 420], [520, 479]])], False, (20, 120, 230), 9)
    at_rim, apart = np.zeros((2, 120, 160), np.uint8)
    at_rim[70:, 60:120] = apart[60:90, 60:100] = 255
    for picture, place in ((lump, at_rim), (strands, apart)):
        as_filament = np.where((small(picture) == (20, 120, 230)).all(axis=2), np.uint8(255), np.uint8(0))
        occluders = Occluders(small(frame))
        assert not occluders.find(small(picture), cv2.dilate(as_filament, np.ones((3, 3))), place).any()
        assert not occluders.foreign.any()


def test_a_print_that_fell_over_the_pictures_rim_has_not_come_in_there(frame):
    """The bed shows where it stood."""
    stood = cv2.rectangle(frame.copy(), (300, 180), (430, 330), (20, 120, 230), -1)
    fallen = cv2.rectangle(frame.copy(), (480, 180), (639, 300), (20, 120, 230), -1)
    place, as_filament = np.zeros((2, 120, 160), np.uint8)
    place[40:85, 72:110] = as_filament[40:85, 72:110] = 255
    occluders = Occluders(small(frame))
    occluders.accept(small(stood))
    as_filament[43:78, 118:160] = 255
    assert not occluders.find(small(fallen), as_filament, place).any() and not occluders.foreign.any()
