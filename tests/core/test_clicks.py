"""The pose from clicked points, against cameras that made them."""

from __future__ import annotations

import json

import numpy as np
import pytest

from octoprint_moop.core.calibration.calibrate import Lens
from octoprint_moop.core.calibration.clicks import Points, bed_corners_mm, pose_from_points
from octoprint_moop.core.errors import CalibrationError
from tests.drawn import volume_error_px
from tests.made import camera_at

TRUE = camera_at((110, -140, 190), (100, 100, 10), "5 coefficients", focal_px=600)
LENS = Lens.of(TRUE)
SIZE = TRUE.image_size_px
FLAT = np.array([[20, 20, 0], [180, 20, 0], [180, 180, 0], [20, 180, 0]], float)
SOLID = np.vstack([FLAT, [[100, 100, 60], [60, 140, 30], [140, 60, 45], [100, 20, 25]]])


def clicked(points_mm, off_px=0.0, seed=0):
    noise = np.random.default_rng(seed).normal(0, off_px, (len(points_mm), 2))
    return Points(points_mm, TRUE.project(points_mm) + noise)


def off_px(result):
    return volume_error_px(result.camera, TRUE, (200, 200))


def test_four_exact_corners_and_a_known_lens_give_the_pose():
    result = pose_from_points(clicked(FLAT), SIZE, LENS)
    assert off_px(result).max() < 1e-3
    assert result.rms_px < 1e-4


def test_the_error_told_for_inexact_clicks_is_of_the_size_of_the_error_made():
    made, told = [], []
    for seed in range(20):
        result = pose_from_points(clicked(FLAT, 2.0, seed), SIZE, LENS, click_px=2.0)
        made.append(off_px(result).mean())
        told.append(result.error_px[0])
    assert 0.5 < np.sqrt(np.mean(np.square(made))) / np.sqrt(np.mean(np.square(told))) < 2


def test_without_a_lens_a_focal_length_is_found_and_its_doubt_told():
    result = pose_from_points(clicked(SOLID, 1.0), SIZE, None, click_px=1.0)
    assert result.camera.K[0, 0] == pytest.approx(600, rel=0.1)
    assert off_px(result).mean() < 4 * result.error_px[0]
    assert any("not calibrated" in note for note in result.notes)
    known = pose_from_points(clicked(SOLID, 1.0), SIZE, LENS, click_px=1.0)
    assert known.error_px[0] < result.error_px[0]


def test_a_picture_of_another_size_uses_the_same_lens():
    double = TRUE.resized((1280, 960))
    result = pose_from_points(Points(FLAT, double.project(FLAT)), (1280, 960), LENS)
    assert np.linalg.norm(result.camera.centre_mm - TRUE.centre_mm) < 0.01


def test_points_exchanged_are_named():
    with pytest.raises(CalibrationError, match="Points 1 and 2 seem to be exchanged"):
        pose_from_points(Points(FLAT, TRUE.project(FLAT)[[1, 0, 2, 3]]), SIZE, LENS)


def test_a_mirrored_picture_is_told():
    mirrored = TRUE.project(FLAT) * [-1, 1] + [SIZE[0] - 1, 0]
    with pytest.raises(CalibrationError, match="mirrors its picture"):
        pose_from_points(Points(FLAT, mirrored), SIZE, LENS)
    with pytest.raises(CalibrationError, match="mirrors its picture"):
        pose_from_points(Points(FLAT, mirrored), SIZE)


def test_one_wrong_point_of_many_is_named():
    px = TRUE.project(SOLID)
    px[5] += [70, -40]
    with pytest.raises(CalibrationError, match="point 6"):
        pose_from_points(Points(SOLID, px), SIZE, LENS)


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (None, "must be a list"),
        ("abcd", "must be a list"),
        ([{"mm": [0, 0], "px": [1, 1]}] * 3, "four are needed"),
        ([{"mm": [0, 0], "px": [1, 1]}] * 4, "same millimetres"),
        ([{"mm": [k, 0], "px": [k, k * k]} for k in range(4)], "one line"),
        ([{"mm": [k, k * k], "px": [k, 0]} for k in range(4)], "one line"),
        ([{"mm": [0], "px": [1, 1]}] * 4, "needs two or three"),
        ([{"mm": [0, "x"], "px": [1, 1]}] * 4, "not of the kind"),
        ([{"mm": [k, k * k], "px": [k, float("nan")]} for k in range(4)], "not finite"),
        ([{"px": [1, 1]}] * 4, "not of the kind"),
    ],
)
def test_points_that_make_no_sense_are_refused_with_a_sentence(data, said):
    with pytest.raises(CalibrationError, match=said):
        Points.from_json(data)


def test_the_beds_corners_follow_its_origin():
    assert bed_corners_mm(200, 100).tolist() == [[0, 0, 0], [200, 0, 0], [200, 100, 0], [0, 100, 0]]
    assert bed_corners_mm(200, 100, "center").min(axis=0).tolist() == [-100, -50, 0]


def test_the_result_is_json_even_where_nothing_is_known_of_its_accuracy():
    data = pose_from_points(clicked(FLAT), SIZE, LENS).to_json()
    assert {"K", "rvec", "tvec_mm", "rms_px", "markers_px", "error_px", "error_mm", "notes"} <= set(data)
    json.dumps(data, allow_nan=False)
