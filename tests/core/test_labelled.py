"""Learning from one labelled picture: small drawn scenes, and real prints where they are at hand."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from octoprint_moop.core.errors import SegmentationError
from octoprint_moop.core.segmentation.clicks import label_from_clicks
from octoprint_moop.core.segmentation.labelled import LOOK_ALIKE, learn_from_clicks, learn_from_label

BED, FILAMENT = (60, 58, 62), (40, 120, 235)


def scene(
    height_px: int, left_px: int = 60, colour=FILAMENT, bed=BED, seed: int = 0, gain: float = 1.0
) -> tuple[np.ndarray, np.ndarray]:
    """A print 50 px wide that stands on row 110 of a 160 x 120 view and is `height_px` high; and its true mask."""
    rng = np.random.default_rng(seed)
    frame = np.full((120, 160, 3), bed, np.float64)
    frame[:40] = (120, 125, 130)
    mask = np.zeros((120, 160), np.uint8)
    mask[110 - height_px : 110, left_px : left_px + 50] = 255
    frame[mask > 0] = colour
    frame[mask > 0] *= rng.normal(1, 0.06, (int((mask > 0).sum()), 1))
    frame += rng.normal(0, 5, frame.shape)
    return np.clip(cv2.GaussianBlur(frame, (3, 3), 0) * gain, 0, 255).astype(np.uint8), mask


def iou(a: np.ndarray, b: np.ndarray) -> float:
    return np.count_nonzero((a > 0) & (b > 0)) / np.count_nonzero((a > 0) | (b > 0))


def test_earlier_and_later_layers_are_found_from_one_labelled_frame():
    learned = learn_from_label(*scene(40))
    for height_px in (12, 25, 55, 80):
        frame, truth = scene(height_px, seed=height_px)
        assert iou(learned.segment(frame).mask, truth) > 0.9


def test_a_print_of_the_backgrounds_own_colours_is_found_by_each_pixels_own_past():
    """Both show the same greys; only where the camera has seen which of them tells them apart."""
    rng = np.random.default_rng(1)
    walls, skin = (
        cv2.resize(rng.uniform(20, 120, (30, 40)), (160, 120), interpolation=cv2.INTER_NEAREST) for _ in "ab"
    )

    def look(height_px: int) -> tuple[np.ndarray, np.ndarray]:
        _, mask = scene(height_px)
        grey = np.where(mask > 0, skin, walls) + rng.normal(0, 3, mask.shape)
        return cv2.cvtColor(np.clip(grey, 0, 255).astype(np.uint8), cv2.COLOR_GRAY2BGR), mask

    learned = learn_from_label(*look(60))
    assert learned.separability < LOOK_ALIKE
    frame, truth = look(60)
    assert iou(learned.segment(frame).mask, truth) > 0.7


def test_dimmer_light_is_taken_out():
    learned = learn_from_label(*scene(40))
    frame, truth = scene(60, seed=5, gain=0.75)
    assert iou(learned.segment(frame).mask, truth) > 0.9


def test_a_wrong_expectation_does_not_win_over_the_picture():
    learned = learn_from_label(*scene(40))
    frame, truth = scene(40, left_px=75, seed=7)
    _, expected = scene(40)
    seen = learned.segment(frame, expected).mask
    assert iou(seen, truth) > iou(seen, expected) and iou(seen, truth) > 0.85


def test_what_is_expected_on_top_but_not_there_is_not_seen():
    learned = learn_from_label(*scene(60))
    frame, truth = scene(42, seed=8)
    _, expected = scene(60)
    assert iou(learned.segment(frame, expected).mask, truth) > 0.9


def test_nothing_is_seen_where_the_print_is_gone_altogether():
    learned = learn_from_label(*scene(40))
    frame, _ = scene(0, seed=9)
    _, expected = scene(40)
    assert np.count_nonzero(learned.segment(frame, expected).mask) < 0.1 * np.count_nonzero(expected)


def test_a_part_lying_beside_its_place_is_seen_although_nothing_is_expected_there():
    learned = learn_from_label(*scene(40))
    frame, truth = scene(40, seed=3)
    frame[60:80, 125:150], truth[60:80, 125:150] = FILAMENT, 255
    _, expected = scene(40)
    assert (learned.segment(frame, expected).mask[62:78, 127:148] > 0).mean() > 0.9


def test_the_answer_is_the_same_every_time():
    frame, truth = scene(40)
    answers = [learn_from_label(frame, truth).segment(scene(50)[0], truth).mask for _ in range(2)]
    assert np.array_equal(*answers)


def test_nothing_is_seen_outside_of_the_box():
    frame, truth = scene(40)
    learned = learn_from_label(frame, truth, (50, 60, 120, 115))
    seen = learned.segment(frame).mask
    assert iou(seen, truth) > 0.9
    seen[60:115, 50:120] = 0
    assert not seen.any()


@pytest.mark.parametrize(
    ("mask", "region", "reason"),
    [
        (np.zeros((120, 160), np.uint8), None, "no filament"),
        (np.full((120, 160), 255, np.uint8), None, "nothing but filament"),
        (np.zeros((60, 80), np.uint8), None, "80x60"),
        (scene(40)[1], (400, 400, 500, 500), "outside"),
    ],
)
def test_a_label_that_cannot_teach_is_refused_with_the_reason(mask, region, reason):
    with pytest.raises(SegmentationError, match=reason):
        learn_from_label(scene(40)[0], mask, region)


def test_a_picture_of_another_size_is_refused_with_both_sizes():
    learned = learn_from_label(*scene(40))
    with pytest.raises(SegmentationError, match=r"80x60.*160x120"):
        learned.segment(np.zeros((60, 80, 3), np.uint8))


def test_three_clicks_each_teach_as_much_as_a_label_where_colours_differ():
    frame, _ = scene(40)
    learned = learn_from_clicks(frame, [(70, 80), (90, 100), (105, 90)], [(20, 20), (20, 90), (140, 80)])
    later, truth = scene(60, seed=4)
    assert iou(learned.segment(later).mask, truth) > 0.9


def shaded() -> tuple[np.ndarray, np.ndarray]:
    """A white print, its left side in shade, on a bed as bright as that shade, before a wall brighter than all of it."""
    rng = np.random.default_rng(6)
    frame, mask = np.full((240, 320), 150.0), np.zeros((240, 320), np.uint8)
    frame[:150] = 250
    mask[60:190, 120:220] = 255
    frame[60:190, 120:220] = np.linspace(110, 215, 100)
    frame = cv2.GaussianBlur(frame, (0, 0), 1) + rng.normal(0, 3, frame.shape)
    return cv2.cvtColor(np.clip(frame, 0, 255).astype(np.uint8), cv2.COLOR_GRAY2BGR), mask


@pytest.mark.parametrize("region", [None, (90, 40, 260, 220)])
@pytest.mark.parametrize(
    "filament", [[(125, 180), (130, 70), (214, 130)], [(140, 70), (170, 120), (200, 180)], [(205, 80), (150, 180)]]
)
def test_a_clicked_print_is_cut_out_with_the_shades_that_nobody_clicked(region, filament):
    """No colour parts them: the bed's brightness lies in the middle of the print's."""
    frame, truth = shaded()
    assert iou(label_from_clicks(frame, filament, [(100, 60), (250, 100), (240, 210)], region), truth) > 0.85


def test_clicks_outside_of_the_picture_are_refused():
    with pytest.raises(SegmentationError, match="outside"):
        learn_from_clicks(scene(40)[0], [(400, 3)], [(3, 3)])


@pytest.mark.parametrize("colour", ["Black", "White"])
def test_photographed_prints_of_the_hardest_colours_are_found_from_one_label(shared, colour):
    """The figures over all prints and expectations are in docs/segmentation.md."""
    folders = sorted((shared / "data" / "real-frames").glob(f"*{colour}*"))
    if not folders:
        pytest.skip("no photographs there")
    alone, with_expected = [], []
    for folder in folders:
        files = sorted(folder.glob("*.jpg"))
        frames = [cv2.imread(str(file)) for file in files]
        truths = [cv2.imread(str(file.with_suffix(".mask.png")), cv2.IMREAD_GRAYSCALE) for file in files]
        x, y, w, h = cv2.boundingRect(np.maximum.reduce(truths))
        box = (x - 10, y - 10, x + w + 10, y + h + 10)
        learned = learn_from_label(frames[5], truths[5], box)
        for i in (0, 1, 2, 3, 4, 6, 7, 8, 9):
            alone.append(iou(learned.segment(frames[i]).mask, truths[i]))
            nearly = np.roll(truths[i], (1, -2), axis=(0, 1))
            with_expected.append(iou(learned.segment(frames[i], nearly).mask, truths[i]))
    assert np.median(alone) > 0.75 and np.median(with_expected) > 0.85
