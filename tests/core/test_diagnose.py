"""Which failure it is, on pictures painted by hand and moved by known distances."""

from __future__ import annotations

import re

import cv2
import numpy as np
import pytest

from octoprint_moop.core.decision.counts import WHOLE
from octoprint_moop.core.decision.decide import FAILED, Outcome, Surprise
from octoprint_moop.core.decision.diagnose import Naming
from octoprint_moop.core.decision.evidence import find

from .stage import BED_BGR, GROUND, LAYER_PX, PLASTIC_BGR, PX_PER_MM, SHAPE, Stage, moved, wall, walls


class FlatPlace:
    """The bed seen aslant: x to the right, y to the back, and heights as long as depths, PX_PER_MM."""

    def __init__(self, upto: int) -> None:
        self._upto = upto

    def covered(self, object_id: int, first_layer: int) -> np.ndarray:
        numbers = (0, 1) if object_id == WHOLE else (object_id,)
        part = np.any([wall(number, self._upto, first_layer) for number in numbers], axis=0)
        return np.where(part, np.uint8(255), np.uint8(0))

    def on_bed_mm(self, pixels: np.ndarray, z_mm: float) -> np.ndarray:
        return np.asarray(pixels, float) / PX_PER_MM * [1, -1] - [0, z_mm]

    def layer_z_mm(self, layer: int) -> float:
        return 0.2 * (layer + 1)


def named(layer: int, matter: np.ndarray, object_id: int = WHOLE, good_upto: int = 20, place: FlatPlace | None = None):
    stage = Stage().printed(good_upto)
    sight = stage.sight(layer, matter)
    surprises = (Surprise("all", 9.0), Surprise("lost", 9.0), Surprise("stray", 9.0), Surprise("fresh", 9.0))
    naming = Naming(find(sight, stage.memory), sight, place or FlatPlace(layer))
    return naming.name(Outcome(object_id, FAILED, surprises, 9.0))


@pytest.mark.parametrize(("right", "way"), [(12, "right"), (-16, "left")])
def test_what_lies_above_a_layer_and_is_displaced_is_a_layer_shift_with_its_distance(right, way):
    found = named(23, walls(20) | moved(wall(0, 23, 21) | wall(1, 23, 21), right, 0))
    assert found.mode == "layer_shift"
    assert (
        found.sentence == f"Everything above layer 21 is shifted by about {abs(right) / PX_PER_MM:.0f} mm to the {way}."
    )


def grid(across_px: int, along_px: int) -> np.ndarray:
    """bool: a layer that is nothing but crossing lines of two pixels, so far apart."""
    lines = np.zeros(SHAPE, bool)
    lines[130:170, 90:150:across_px] = lines[130:170, 91:151:across_px] = True
    lines[130:170:along_px, 90:150] = lines[131:171:along_px, 90:150] = True
    return lines


class PlaceOf(FlatPlace):
    """What lies of any layer on is these pixels."""

    def __init__(self, pixels: np.ndarray, layer: int) -> None:
        super().__init__(layer)
        self._pixels = pixels

    def covered(self, object_id: int, first_layer: int) -> np.ndarray:
        return np.where(self._pixels, np.uint8(255), np.uint8(0))


def test_a_first_shifted_layer_is_told_by_its_own_pattern_of_lines_though_perspective_has_stretched_it():
    lines = grid(8, 19)
    stretched = np.float32([[1.1, 0, -32 - 0.1 * 90], [0, 1.1, -0.1 * 150]])
    beside = cv2.warpAffine(lines.astype(np.uint8), stretched, SHAPE[::-1]) > 0
    found = named(22, walls(22) | beside, place=PlaceOf(lines, 22))
    assert found.mode == "layer_shift"
    assert "to the left" in found.sentence and millimetres(found.sentence) == pytest.approx(32 / PX_PER_MM, abs=0.6)


def test_a_wall_that_moved_as_a_whole_has_come_off():
    found = named(21, moved(wall(0, 20), -24, 0) | wall(1, 21), object_id=0)
    assert found.mode == "detachment"
    assert "6 mm to the left" in found.sentence


def test_a_wall_of_which_nothing_is_left_is_gone():
    found = named(21, wall(1, 21), object_id=0)
    assert (found.mode, found.sentence) == ("detachment", "The print is gone from its place.")


def test_layers_that_never_came_are_an_extrusion_failure_since_the_first_of_them():
    found = named(25, walls(21), good_upto=21)
    assert found.mode == "extrusion_failure"
    assert found.sentence == "No new material since layer 23."  # counted from 1


def millimetres(sentence: str) -> float:
    return float(re.search(r"([0-9.]+) mm", sentence).group(1))


def test_a_foot_laid_bare_is_a_corner_that_has_lifted():
    matter = walls(21)
    matter[GROUND - 8 : GROUND, 90:112] = False
    found = named(21, matter, object_id=0)
    assert found.mode == "warping"
    assert "left" in found.sentence and millimetres(found.sentence) == pytest.approx(2.0, abs=0.3)


def test_a_corner_that_lifts_behind_the_print_shows_extra_matter_only_and_is_no_shift():
    """The wall's top left rises by up to 3 mm, the more the nearer to the corner; in front nothing is laid bare."""
    matter = walls(21)
    top = GROUND - 22 * LAYER_PX
    for column in range(90, 120):
        matter[top - round(12 * (120 - column) / 30) : top, column] = True
    found = named(21, matter, object_id=0)
    assert found.mode == "warping"
    assert "left" in found.sentence and millimetres(found.sentence) == pytest.approx(3.0, abs=0.6)


def test_what_is_displaced_on_one_of_two_objects_alone_is_no_shift_since_axes_that_slip_shift_both():
    beside = moved(wall(0, 23, 21), -12, 0)
    assert named(23, walls(20) | beside | moved(wall(1, 23, 21), -12, 0), object_id=0).mode == "layer_shift"
    assert named(23, walls(20) | beside | wall(1, 23, 21), object_id=0).mode == "stray_material"


@pytest.mark.parametrize("slid", [False, True])
def test_what_lies_beside_one_object_like_its_newest_layer_is_no_shift_where_the_others_newest_is_in_place(slid):
    left, right = wall(0, 21, 21), wall(1, 21, 21)
    found = named(21, walls(20) | moved(left, -40, 0) | (moved(right, -40, 0) if slid else right), object_id=0)
    assert found.mode == ("layer_shift" if slid else "stray_material")


def test_a_shift_that_lays_one_objects_matter_beside_another_is_told_by_all_objects_together():
    """What the right wall shed lies half beside the left one's top, which shows too little of its own."""
    newest = moved(wall(0, 22, 21) | wall(1, 22, 21), 44, 0)
    for number in (0, 1):
        found = named(22, walls(20) | newest, object_id=number)
        assert found.mode == "layer_shift", number
        assert millimetres(found.sentence) == pytest.approx(44 / PX_PER_MM, abs=0.6) and "right" in found.sentence


def test_a_first_shifted_layer_whose_lines_have_run_together_is_told_by_its_outline():
    lines = grid(6, 6)
    nearer = np.float32([[1.15, 0, -32 - 0.15 * 120], [0, 1.15, -0.15 * 150]])
    beside = cv2.warpAffine(cv2.dilate(lines.astype(np.uint8), np.ones((3, 3))), nearer, SHAPE[::-1]) > 0
    found = named(22, walls(22) | beside, place=PlaceOf(lines, 22))
    assert found.mode == "layer_shift"
    assert "to the left" in found.sentence and millimetres(found.sentence) == pytest.approx(32 / PX_PER_MM, abs=2.1)


def test_what_lies_turned_beside_the_print_with_the_outline_of_a_part_has_come_off_though_its_place_is_hidden():
    """As where a head stands before the place: there all is taken to be as it was."""
    turn = cv2.getRotationMatrix2D((120, 158), 40, 1.0) + [[0, 0, -50], [0, 0, 20]]
    slid = cv2.warpAffine(wall(0, 20).astype(np.uint8), turn, SHAPE[::-1]) > 0
    found = named(21, walls(21) | slid, object_id=0)
    assert found.mode == "detachment"
    assert "left" in found.sentence and millimetres(found.sentence) == pytest.approx(
        np.hypot(50, 20) / PX_PER_MM, abs=1.5
    )


def test_a_part_that_came_to_lie_between_two_objects_has_come_off_whichever_is_asked_about():
    slid = moved(wall(0, 20), 66, 46)
    for number in (0, 1):
        assert named(21, walls(21) | slid, object_id=number).mode == "detachment", number


def test_a_round_blob_as_large_as_a_part_is_stray_material():
    blob = cv2.circle(np.zeros(SHAPE, np.uint8), (66, 160), 27, 1, cv2.FILLED) > 0
    assert named(21, walls(21) | blob, object_id=0).mode == "stray_material"


@pytest.mark.parametrize("stands", [True, False])
def test_what_sticks_out_like_a_part_that_slid_is_stray_material_where_the_part_is_seen_to_stand(stands):
    left, slid = wall(0, 21), moved(wall(0, 21), -20, 4)
    found = named(21, wall(1, 21) | slid | left if stands else wall(1, 21) | slid, object_id=0)
    assert found.mode == ("stray_material" if stands else "detachment")


def test_strands_beside_a_print_that_stands_are_stray_material():
    matter = walls(21)
    for row in range(GROUND - 60, GROUND - 10, 9):
        matter[row : row + 2, 60:90] = True
    found = named(21, matter, object_id=0)
    assert found.mode == "stray_material"


def test_a_print_that_has_stopped_growing_amid_strands_is_not_called_a_clog():
    matter = walls(20)
    matter[GROUND - 21 * LAYER_PX - 6 : GROUND - 21 * LAYER_PX - 4, 80:160] = True
    matter[120:124, 60:90] = True
    assert matter.shape == SHAPE
    assert named(23, matter, object_id=0).mode == "stray_material"


def test_a_foot_laid_bare_all_the_way_up_that_sticks_out_at_the_other_end_has_come_off_however_little():
    matter = walls(21)
    matter[GROUND - 44 : GROUND, 90:96] = False
    matter[GROUND - 44 : GROUND, 150:155] = True
    found = named(21, matter, object_id=0)
    assert found.mode == "detachment" and millimetres(found.sentence) == pytest.approx(5 / PX_PER_MM, abs=0.3)


def test_a_shift_within_the_band_about_edges_is_told_by_what_sticks_out_and_what_is_bared():
    matter = walls(17) | moved(wall(0, 23, 18) | wall(1, 23, 18), 2, 0)
    for object_id in (WHOLE, 0, 1):
        found = named(23, matter, object_id, good_upto=17)
        assert found.mode == "layer_shift", object_id
        assert "right" in found.sentence and millimetres(found.sentence) == pytest.approx(2 / PX_PER_MM, abs=0.3)


def test_such_a_shift_of_one_of_two_objects_alone_is_none():
    matter = walls(17) | moved(wall(0, 23, 18), 2, 0) | wall(1, 23)
    assert named(23, matter, 0, good_upto=17).mode != "layer_shift"


def test_where_newest_layers_are_missing_and_nothing_sticks_out_there_is_no_shift_however_well_one_would_hide_them():
    assert named(23, walls(20), good_upto=20).mode == "extrusion_failure"


def test_a_print_that_lies_askew_amid_strands_has_come_off_since_no_corner_that_lifts_would_leave_it_so():
    turn = cv2.getRotationMatrix2D((120, 158), 12, 1.0)
    matter = wall(1, 21) | (cv2.warpAffine(wall(0, 21).astype(np.uint8), turn, SHAPE[::-1]) > 0)
    for row in range(GROUND - 50, GROUND + 30, 9):
        matter[row : row + 2, 60:88] = True
    assert named(21, matter, object_id=0).mode == "detachment"


def test_layers_that_blur_alone_lets_appear_have_not_come_since_the_first_that_is_hardly_covered():
    """Of the last two layers a fifth is seen everywhere, so that no pixel looks bare, and segmentation sees them all."""
    stage = Stage().printed(20)
    sight = stage.sight(22, walls(20), observed=walls(22))
    new = walls(22) & ~walls(20)
    sight.frame_bgr[new] = 0.8 * np.array(BED_BGR) + 0.2 * np.array(PLASTIC_BGR)
    found = find(sight, stage.memory)
    assert found.whole.unseen_px == 0
    outcome = Outcome(0, FAILED, (Surprise("fresh", 3.0), Surprise("all", 0.0)), 3.0)
    named = Naming(found, sight, FlatPlace(22)).name(outcome)
    assert (named.mode, named.sentence) == ("extrusion_failure", "Too little new material since layer 22.")
