"""What counts as lost, stray and unseen, on pictures painted by hand."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from octoprint_moop.core.decision.evidence import find
from octoprint_moop.core.decision.memory import Memory
from octoprint_moop.core.decision.spots import near_to, without_specks
from octoprint_moop.core.expected.views import surroundings

from .stage import BED_BGR, GROUND, LAYER_PX, SHAPE, WALLS, Stage, moved, wall, walls


def figures(evidence):
    return evidence.lost_px, evidence.stray_px, evidence.unseen_px, evidence.barren_px


def test_a_print_that_grows_as_it_should_shows_nothing_wrong():
    stage = Stage()
    for layer in range(15):
        found = stage.good(layer, walls(layer))
        assert [figures(scope) for scope in found.scopes] == [(0, 0, 0, 0)] * 3
        assert found.whole.error_ratio == 0


@pytest.mark.parametrize("off", [(3, 0), (-3, 2), (0, -4)])
def test_a_calibration_that_is_pixels_off_is_found_before_the_first_verdict(off):
    stage = Stage()
    for layer in range(10):
        found = stage.good(layer, moved(walls(layer), *off))
        assert found.whole.lost_px == found.whole.stray_px == found.whole.barren_px == 0
    assert stage.memory.misfit.alignment.offset_px == pytest.approx(off, abs=0.3)


def test_a_look_without_contours_does_not_unsettle_what_contours_have_told():
    stage = Stage()
    stage.good(5, moved(walls(5), 3, 0))
    told = stage.memory.misfit.alignment
    blots = np.zeros(SHAPE, bool)
    blots[120:160:8, 92:230:9] = True
    stage.look(6, moved(walls(6), 3, 0), observed=blots)
    assert stage.memory.misfit.alignment == told and stage.memory.misfit.fitted


@pytest.mark.parametrize(("right_px", "counts"), [(2, False), (6, True)])
def test_while_no_contour_has_told_where_a_print_is_what_lies_close_beside_it_may_be_the_print(right_px, counts):
    stage = Stage()
    blot = np.zeros(SHAPE, bool)
    blot[172:176, 150 + right_px : 152 + right_px] = True  # no more of the print is seen
    found = stage.look(3, blot)
    assert not stage.memory.misfit.fitted and (found.whole.stray_px > 0) is counts


def test_a_print_that_slid_on_a_bed_that_stands_still_is_not_taken_for_a_camera_that_moved():
    stage = Stage(textured=True).printed(12)
    found = stage.look(13, moved(walls(13), 5, 0))
    assert found.moved_px == 0 and stage.memory.misfit.alignment.most_px < 0.5
    # each wall leaves a strip of 5 px less what lies within 1.5 px of matter, over the height that stood before
    assert found.whole.lost_px == pytest.approx(2 * 4 * 13 * LAYER_PX, rel=0.1)
    assert found.whole.stray_px == pytest.approx(2 * 3 * 14 * LAYER_PX, rel=0.1)


@pytest.mark.parametrize("off", [(2, 0), (5, 0), (-9, 6)])
def test_a_picture_that_has_moved_as_a_whole_bed_and_all_shows_nothing_wrong(off):
    stage = Stage(textured=True).printed(12)
    found = stage.look(13, moved(walls(13), *off), bed_px=off)
    assert found.moved_px == pytest.approx(np.hypot(*off), abs=0.3)
    assert figures(found.whole) == (0, 0, 0, 0)
    # from now on the picture is looked at so; and when the camera is set right again, that is found as well
    assert figures(stage.look(14, moved(walls(14), *off), bed_px=off).whole) == (0, 0, 0, 0)
    assert figures(stage.look(15, walls(15)).whole) == (0, 0, 0, 0)


def test_one_wall_that_slid_is_not_a_camera_that_moved_whatever_the_bed_shows():
    stage = Stage().printed(12)
    found = stage.look(12, moved(wall(0, 12), 6, 0) | wall(1, 12))
    assert found.moved_px == 0
    assert found.scopes[1].lost_px > 100 and found.scopes[2].lost_px == 0


def test_on_a_bed_too_plain_to_tell_two_walls_that_moved_alike_are_the_camera():
    found = Stage().printed(12).look(13, moved(walls(13), 5, 0))
    assert found.moved_px == pytest.approx(5, abs=0.3)


@pytest.mark.parametrize("moved_px", [2, 5])
@pytest.mark.parametrize("sure", [True, False])
def test_on_such_a_bed_a_single_wall_that_moved_is_the_camera_only_where_nothing_tells_where_that_stands(
    sure, moved_px
):
    stage = Stage()
    stage._birth[:, 160:] = 0  # the other wall is never to be
    for layer in range(13):
        stage.good(layer, wall(0, layer))
    found = find(replace(stage.sight(13, moved(wall(0, 13), moved_px, 0)), sure=sure), stage.memory)
    assert found.moved_px == pytest.approx(0 if sure else moved_px, abs=0.3)
    if moved_px == 5:  # two are within the band
        assert (found.whole.lost_px > 100) is sure


def test_much_that_is_seen_no_more_though_nothing_shows_that_it_has_gone_is_hidden():
    """Something of the print's own brightness stands before one of two walls, and segmentation takes it for no filament."""
    stage = Stage().printed(12)
    found = stage.look(13, walls(13), observed=wall(1, 13))
    assert found.whole.lost_px == 0
    assert found.untold_px > 0.3 * found.whole.standing_px
    assert stage.look(14, walls(14)).untold_px == 0


def test_what_is_seen_no_more_has_gone_though_its_place_does_not_show_it_where_as_much_lies_beside():
    """The bare place looks like the print; segmentation rightly sees none there, and much of it a little way off."""
    stage = Stage().printed(12)
    slid = moved(wall(0, 12), -50, 4)
    found = stage.look(13, walls(13) | slid, observed=wall(1, 13) | slid)
    assert found.untold_px == 0 and found.scopes[1].stray_px > 300
    # what lies within 1.5 px of the slid wall may be it
    assert found.scopes[1].lost_px == pytest.approx(np.count_nonzero(wall(0, 12) & ~slid), rel=0.15)
    assert found.scopes[2].lost_px == 0


@pytest.mark.parametrize("stands", [True, False])
def test_matter_hardly_darker_than_the_bed_has_gone_where_all_its_pixels_together_show_the_bed(stands):
    """Twelve grey levels of difference say nothing of one pixel; segmentation sees the wall no more in either case."""
    stage = Stage(plastic_bgr=(48, 50, 46)).printed(12)
    found = stage.look(13, walls(13) if stands else wall(1, 13), observed=wall(1, 13))
    assert (found.scopes[1].lost_px, found.untold_px > 0) == (0 if stands else found.scopes[1].standing_px, stands)
    assert found.scopes[2].lost_px == 0


def test_before_a_few_layers_have_shown_what_matter_may_look_like_what_looks_like_the_bed_may_be_matter():
    stage = Stage(plastic_bgr=(48, 50, 46)).printed(2)
    found = stage.look(3, wall(1, 3), observed=wall(1, 3))
    assert found.whole.lost_px == 0 and found.untold_px > 0


@pytest.mark.parametrize(("good_upto", "gone"), [(1, False), (12, True)])
def test_at_the_first_layers_a_print_that_seems_gone_with_nothing_beside_its_place_may_shine_as_the_bed(
    good_upto, gone
):
    stage = Stage().printed(good_upto)
    found = stage.look(good_upto + 1, np.zeros(SHAPE, bool))
    assert (found.whole.lost_px > 0, found.untold_px > 0) == (gone, not gone)
    fallen = wall(1, good_upto + 1) | moved(wall(0, good_upto + 1), -20, 10)
    assert Stage().printed(good_upto).look(good_upto + 1, fallen).scopes[1].lost_px > 0


def test_dark_matter_that_shines_brighter_than_the_bed_at_one_layer_has_not_gone():
    """Solid lines shine or not as they lie to the lamp, in turn; segmentation has learned the dark ones."""
    stage = Stage()
    for layer in range(13):
        sight = stage.sight(layer, walls(layer))
        sight.frame_bgr[walls(layer)] = np.array(BED_BGR) - 30
        found = find(sight, stage.memory)
        stage.memory.learn(found.window, found.wanted, found.look, found.seen, found.known)

    def lost_px(shade: int) -> int:
        nothing = np.zeros(SHAPE, bool)
        sight = stage.sight(13, walls(13), observed=nothing)
        noise = np.random.default_rng(7).normal(0, 2, (np.count_nonzero(walls(13)), 1))
        sight.frame_bgr[walls(13)] = np.array(BED_BGR) + shade + noise
        return find(sight, stage.memory).whole.lost_px

    assert lost_px(10) == 0
    assert lost_px(0) > 1000  # bare bed, and so gone


@pytest.mark.parametrize("board", [True, False])
def test_a_board_of_the_beds_shade_before_a_print_hides_it_since_it_lacks_the_beds_detail(board):
    """The bed has a grain of a few grey levels, the board not even the camera's noise: it is out of focus."""
    stage = Stage()
    grain = np.random.default_rng(5).normal(0, 9, SHAPE)
    stage.bed = np.clip(stage.bed + cv2.GaussianBlur(grain, (0, 0), 0.8)[..., None], 0, 255).astype(np.uint8)
    stage.memory = Memory(stage.bed, SHAPE)
    stage.printed(12)
    sight = stage.sight(13, wall(1, 13))
    if board:
        sight.frame_bgr[:, 80:160] = BED_BGR
    found = find(sight, stage.memory)
    assert found.scopes[1].lost_px == (0 if board else found.scopes[1].standing_px)
    assert (found.hidden_px >= found.scopes[1].standing_px) == board


@pytest.mark.parametrize(("shade", "gone"), [(0, False), (-30, True)])
def test_matter_in_shade_that_looks_as_the_bed_did_has_not_gone_while_the_bed_lies_in_less_light(shade, gone):
    stage = Stage().printed(12)
    sight = stage.sight(13, wall(1, 13))  # segmentation sees the one wall,
    sight.frame_bgr[~wall(1, 13)] = np.array(BED_BGR) - 30  # the bed is darker now,
    sight.frame_bgr[wall(0, 13)] = np.array(BED_BGR) + shade  # and where the other stood it looks so
    assert (find(sight, stage.memory).scopes[1].lost_px > 500) is gone


@pytest.mark.parametrize(("spread_px", "counted"), [(0.3, True), (1.2, False)])
def test_a_line_of_single_pixels_at_contours_that_are_known_to_be_off_is_no_missing_matter(spread_px, counted):
    """How a failure is named may still depend on such a line."""
    stage = Stage().printed(20)
    stage.memory.misfit.spread_px = spread_px
    matter = walls(21)
    matter[: GROUND - 22 * LAYER_PX + 3] = False
    found = stage.look(21, matter)
    assert np.count_nonzero(found.unseen) > 100
    assert (found.whole.unseen_px > 100) is counted


def test_layers_that_are_shifted_are_not_a_camera_that_moved():
    stage = Stage().printed(12)
    found = stage.look(18, walls(12) | moved(wall(0, 18, 13) | wall(1, 18, 13), 6, 0))
    assert found.moved_px == 0
    assert found.whole.stray_px == pytest.approx(2 * 4 * 6 * LAYER_PX, rel=0.15)


def test_matter_that_is_gone_is_lost_to_its_own_object_only():
    stage = Stage().printed(12)
    whole, left, right = stage.look(12, wall(1, 12)).scopes
    assert left.lost_px == whole.lost_px == pytest.approx(np.count_nonzero(wall(0, 12)), rel=0.02)
    assert right.lost_px == 0


@pytest.mark.parametrize(("inside", "lost"), [(5, False), (0, True)])
def test_what_is_gone_from_amid_a_wall_is_a_hollow_in_shadow_what_is_gone_at_its_edge_is_lost(inside, lost):
    rows, columns = np.nonzero(wall(0, 12))
    left, bottom = columns.min() + inside, rows.max() - inside
    gone = np.zeros(SHAPE, bool)
    gone[bottom - 11 : bottom + 1, left : left + 12] = True
    found = Stage().printed(12).look(12, walls(12) & ~gone)
    assert (found.whole.lost_px > 50) == lost
    assert lost or found.whole.lost_px == 0


@pytest.mark.parametrize(("from_bottom", "lost"), [(12, False), (0, True)])
def test_walls_do_not_hang_in_the_air_what_crosses_them_stands_before_them(from_bottom, lost):
    rows, columns = np.nonzero(wall(0, 12))
    bottom = rows.max() - from_bottom
    gone = np.zeros(SHAPE, bool)
    gone[bottom - 7 : bottom + 1, columns.min() : columns.max() + 1] = True
    found = Stage().printed(12).look(12, walls(12) & ~gone)
    assert (found.whole.lost_px > 100) == lost
    assert lost or found.whole.lost_px == 0


def test_stray_matter_belongs_to_the_object_beside_it():
    stage = Stage().printed(12)
    strand = np.zeros(SHAPE, bool)
    strand[150:153, 232:260] = True
    whole, left, right = stage.look(12, walls(12) | strand).scopes
    assert (left.stray_px, right.stray_px) == (0, whole.stray_px)
    assert whole.stray_px == pytest.approx(np.count_nonzero(strand), abs=8)


def test_matter_that_segmentation_no_longer_sees_but_the_picture_shows_is_not_lost():
    """A lamp was dimmed: the thresholds miss half of the print, which stands there all the same."""
    stage = Stage().printed(12)
    half = walls(12)
    half[:, ::2] = False
    half[:, :120] = False
    found = stage.look(12, walls(12), gain=0.85, observed=half)
    assert found.whole.lost_px == 0


def test_matter_that_was_seen_to_come_and_looks_like_the_bed_now_has_not_failed_to_come():
    """A solid layer that shines as grey as the bed: if anything, what lay there has gone again."""
    stage = Stage().printed(12)
    patch = np.zeros(SHAPE, bool)
    patch[GROUND - 12 * LAYER_PX : GROUND - 8 * LAYER_PX, 95:145] = True
    found = stage.look(13, walls(13) & ~patch)
    assert found.whole.unseen_px == found.whole.barren_px == 0
    never = stage.look(13, walls(12))
    assert never.whole.unseen_px > 100


def test_matter_that_segmentation_imagines_where_nothing_changed_has_not_come():
    stage = Stage().printed(12)
    found = stage.look(15, walls(12), observed=walls(15))
    new_px = np.count_nonzero(walls(15) & ~walls(12))
    # the row that touches the last layer is blurred by it
    assert 0.8 * new_px <= found.whole.unseen_px <= new_px


def test_a_thing_of_the_same_colour_away_from_the_print_is_not_stray():
    stage = Stage().printed(12)
    thing = np.zeros(SHAPE, bool)
    thing[60:80, 20:40] = True
    assert stage.look(12, walls(12) | thing).whole.stray_px == 0


def test_more_than_was_laid_cannot_have_come():
    """A sleeve of the filament's colour touches the print; a strand, or a wall that has moved, is as large as may be."""
    stage = Stage().printed(12)
    sleeve, strand = np.zeros(SHAPE, bool), np.zeros(SHAPE, bool)
    sleeve[120:180, 233:290] = True
    strand[150:154, 234:262] = True

    def stray_px(matter: np.ndarray, laid_px: float) -> int:
        sight = replace(stage.sight(12, matter), laid_px=lambda: laid_px)
        return find(sight, stage.memory).whole.stray_px

    assert stray_px(walls(12) | sleeve, 200.0) == 0
    assert stray_px(walls(12) | strand, 200.0) > 80
    assert stray_px(walls(12) | sleeve, 3000.0) > 3000
    assert stray_px(wall(1, 12) | moved(wall(0, 12), -40, 0), 10.0) > 900


@pytest.mark.parametrize(("matter", "missing"), [((76, 76, 74), False), ((72, 68, 63), True)])
def test_newer_layers_as_dark_as_the_bed_have_come_where_all_of_them_together_are_of_the_filaments_tint(
    matter, missing
):
    """A side wall in shade, against a bed that shows; the bed is bluish, the filament grey."""
    stage = Stage(plastic_bgr=(150, 150, 150))
    stage.bed[:] = (80, 76, 70)
    stage.memory = Memory(stage.bed, SHAPE)
    for layer in range(10):
        stage.good(layer, walls(layer))
    sight = stage.sight(16, walls(16), observed=wall(0, 9) | wall(1, 16))
    sight.frame_bgr[wall(0, 16, 10)] = np.array(matter)
    found = find(sight, stage.memory)
    assert (found.whole.unseen_px > 200) == missing


def test_what_hides_the_print_is_told_from_what_is_gone():
    stage = Stage().printed(12)
    sight = stage.sight(12, walls(12))
    sight.frame_bgr[100:200, 80:160] = (120, 150, 200)
    sight.observed[100:200, 80:160] = 0
    from octoprint_moop.core.decision.evidence import find

    found = find(sight, stage.memory)
    assert found.hidden_px > 1000
    assert found.whole.lost_px == 0
    assert stage.look(12, wall(1, 12)).hidden_px == 0


def test_where_the_bed_is_seen_instead_a_patch_of_another_light_beside_it_hides_nothing():
    stage = Stage().printed(12)
    foot = np.zeros(SHAPE, bool)
    foot[170:180, 90:112] = True
    sight = stage.sight(13, walls(13) & ~foot)
    sight.frame_bgr[160:180, 66:86] += 14
    found = find(sight, stage.memory)
    assert found.hidden_px == 0 and found.whole.lost_px > 100


def test_a_fault_that_stays_below_all_limits_is_not_learned_as_it_comes_but_in_the_end():
    stage, lost_px = Stage().printed(12), []
    foot, strand_px = np.zeros(SHAPE, bool), np.zeros(SHAPE, bool)
    foot[170:180, 90:112] = strand_px[150:160, 60:86] = True
    for layer in range(13, 39):
        found = stage.look(layer, walls(layer) & ~foot | strand_px)
        doubtful = found.lost | found.stray
        stage.memory.learn(found.window, found.wanted, found.look, found.seen, found.known, doubtful)
        lost_px.append((found.whole.lost_px, found.whole.stray_px))
    assert min(lost_px[6]) > 0.8 * min(lost_px[0]) > 80
    assert lost_px[-1] == (0, 0)


def test_noise_that_changes_every_pixel_of_the_bed_hides_nothing_where_a_part_has_gone():
    stage = Stage().printed(12)
    sight = stage.sight(13, wall(1, 13))
    noise = np.random.default_rng(5).normal(0, 25, sight.frame_bgr.shape)
    sight.frame_bgr[:] = np.clip(sight.frame_bgr + noise, 0, 255)
    found = find(sight, stage.memory)
    assert found.whole.lost_px > 1000
    assert found.hidden_px < 0.1 * found.whole.lost_px


def test_what_segmentation_misses_and_the_picture_still_shows_is_not_hidden_whatever_light_falls_beside_it():
    stage, missed = Stage().printed(12), np.zeros(SHAPE, bool)
    missed[150:180, 90:110] = True
    sight = stage.sight(13, walls(13), observed=walls(13) & ~missed)
    sight.frame_bgr[140:200, 60:88] += 20
    found = find(sight, stage.memory)
    assert found.hidden_px == 0 and found.whole.lost_px == 0


def strand(row: int, columns: slice) -> np.ndarray:
    mask = np.zeros(SHAPE, bool)
    mask[row : row + 4, columns] = True
    return mask


def gone_on_with_a_strand() -> tuple[Stage, np.ndarray]:
    """Something hangs beside the print, and the user goes on with it; the strand."""
    stage = Stage().printed(12)
    hanging = strand(170, slice(60, 90))
    found = stage.look(13, walls(13) | hanging)
    assert found.whole.stray_px > 0
    stage.memory.accept(found.window, found.wanted, found.look, found.seen, found.stray)
    return stage, hanging


def test_strands_with_which_the_user_went_on_may_grow_but_others_are_new():
    stage, hanging = gone_on_with_a_strand()
    longer = hanging | strand(162, slice(55, 85))
    found = stage.look(14, walls(14) | longer)
    assert found.whole.stray_px == 0 and np.count_nonzero(found.loose) >= 60
    elsewhere = stage.look(14, walls(14) | longer | strand(170, slice(230, 260)))
    assert elsewhere.scopes[2].stray_px == pytest.approx(4 * 28, rel=0.1) and elsewhere.scopes[1].stray_px == 0


def test_loose_strands_behind_a_head_were_not_taken_away():
    stage, hanging = gone_on_with_a_strand()
    sight = stage.sight(14, walls(14))
    sight.ignored[150:190, 40:100] = 255
    hidden = find(sight, stage.memory)
    stage.memory.keep_loose(hidden.window, hidden.loose, hidden.seen, hidden.known)
    grown = stage.look(15, walls(15) | hanging | strand(162, slice(55, 85)))
    assert grown.whole.stray_px == 0


def test_once_loose_strands_were_taken_away_new_ones_count_again():
    stage, _ = gone_on_with_a_strand()
    cleared = stage.look(14, walls(14))
    stage.memory.keep_loose(cleared.window, cleared.loose, cleared.seen, cleared.known)
    assert not stage.memory.loose(cleared.window).any()
    again = stage.look(15, walls(15) | strand(150, slice(60, 90)))
    assert again.whole.stray_px == pytest.approx(4 * 28, rel=0.1)


def test_nothing_extruded_shows_at_the_first_layer_that_is_wide_enough_to_tell():
    stage = Stage()
    found = stage.look(4, np.zeros(SHAPE, bool))
    assert found.whole.barren_px == found.whole.deep_px > 0


def test_specks_are_dropped_and_strands_are_kept():
    mask = np.zeros((20, 20), bool)
    mask[2, 2] = mask[5:7, 5:7] = True
    mask[12, 3:17] = True
    assert np.count_nonzero(without_specks(mask)) == 14


def test_only_spots_that_come_near_the_print_are_kept_and_then_whole():
    wanted, spots = np.zeros((40, 40), np.uint8), np.zeros((40, 40), bool)
    wanted[30:, :10] = 255
    spots[32, 12:35] = True
    spots[5:8, 5:8] = True
    kept = near_to(wanted, spots, 6.0)
    assert np.count_nonzero(kept) == 23 and not kept[:10].any()


def test_the_window_stays_in_the_picture():
    complete = np.zeros((100, 100), np.uint8)
    complete[:, 90:] = 255
    rows, columns = surroundings(complete)
    assert (rows.start, rows.stop) == (0, 100) and 0 < columns.start < columns.stop == 100


def test_a_bed_that_moves_carries_the_memory_along():
    stage = Stage().printed(12)
    stage.memory.carried(np.array([[1, 0, 7.0], [0, 1, -3.0], [0, 0, 1]]), SHAPE)
    there = (slice(0, SHAPE[0]), slice(0, SHAPE[1]))
    assert np.array_equal(stage.memory.standing(there), moved(walls(12), 7, -3))


@pytest.mark.parametrize(("seen_columns", "hidden"), [(0, False), (15, True)])
def test_a_wall_that_ends_in_its_midst_is_half_hidden_and_one_that_is_gone_has_come_off(seen_columns, hidden):
    """A thing of the bed's colour before it, and nothing lies elsewhere."""
    stage = Stage()
    for layer in range(14):
        stage.good(layer, walls(layer))
    left = walls(13)
    left[:, WALLS[0][0] + seen_columns : WALLS[0][1]] = False
    found = stage.look(13, left)
    assert (found.hidden_px > 0) == hidden
    assert found.whole.lost_px > 0


@pytest.mark.parametrize(("top", "counts"), [(0, False), (12, True)])
def test_matter_beside_a_print_that_hangs_together_with_the_pictures_rim_has_come_from_outside(top, counts):
    stage = Stage().printed(12)
    sleeve = np.zeros(SHAPE, bool)
    sleeve[top : GROUND - 10, 62:84] = True
    assert (stage.look(13, walls(13) | sleeve).whole.stray_px > 500) == counts


def test_a_camera_that_the_print_showed_to_have_moved_is_not_turned_back_twice():
    """The print alone told at first; from the next look on the picture is turned back before it is looked at."""
    stage = Stage(textured=True).printed(12)
    stage.look(13, moved(walls(13), 6, 4), bed_px=(6, 4))
    stage.memory.misfit.turn_is_found()
    assert figures(stage.look(14, walls(14)).whole) == (0, 0, 0, 0) and stage.memory.misfit.alignment.most_px < 0.5


@pytest.mark.parametrize("alike", [True, False])
def test_a_foot_that_is_no_more_seen_has_not_risen_where_a_good_part_of_the_matter_looks_like_the_bed(alike):
    stage = Stage().printed(12)
    foot = np.zeros(SHAPE, bool)
    foot[GROUND - 3 : GROUND, 116:150] = True
    found = stage.look(13, (wall(0, 13) if alike else walls(13)) & ~foot, observed=walls(13) & ~foot)
    assert (found.whole.sunk_px == 0) is alike


@pytest.mark.parametrize(("size_px", "away_px", "stray"), [(7, 1, False), (7, 12, True), (12, 1, True)])
def test_a_small_spot_that_hangs_together_with_the_head_as_well_is_not_stray(size_px, away_px, stray):
    """A spot beside the left wall, within the head's reach, so far from where the head hides everything."""
    stage = Stage().printed(12)
    spot = np.zeros(SHAPE, bool)
    spot[130 : 130 + size_px, 154 : 154 + size_px] = True
    sight = stage.sight(13, walls(13) | spot)
    reach, hidden = np.zeros(SHAPE, np.uint8), np.zeros(SHAPE, np.uint8)
    reach[60:170, 60:260] = 255
    hidden[: 130 - away_px, 140:180] = 255
    sight = replace(sight, expected=replace(sight.expected, volume=reach), ignored=hidden)
    assert (find(sight, stage.memory).whole.stray_px > 20) == stray
