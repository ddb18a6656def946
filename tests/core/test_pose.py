"""The pose from ring markers, on rendered pictures with known cameras and on drawn ones."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import permutations

import cv2
import numpy as np
import pytest

from octoprint_moop.core.calibration.calibrate import Lens
from octoprint_moop.core.calibration.markers import MarkerPlate, circle_poses, find_discs
from octoprint_moop.core.calibration.notes import roll_deg
from octoprint_moop.core.calibration.plate import PlateSettings, place_markers
from octoprint_moop.core.calibration.pose import PoseResult, calibrate_pose, calibrate_pose_any_colour
from octoprint_moop.core.camera import Camera
from octoprint_moop.core.errors import CalibrationError, CameraError
from octoprint_moop.core.header import Header, Printer
from octoprint_moop.core.segmentation.segment import HsvThresholds
from tests.drawn import CONDITIONS, Scene, draw_plate, random_scene, volume_error_px
from tests.made import camera_at

CASES = ("cube-clean", "detach-bedslinger", "dtu-paper", "multi-object")
PRINTER = Printer(200, 200, 200)
PLATE = place_markers(PRINTER, PlateSettings())
PINK = HsvThresholds(310, 350, 0.35, 0.2)


def scene(camera: Camera, condition: str = "plain", plate: MarkerPlate = PLATE, **changes) -> Scene:
    image = draw_plate(np.random.default_rng(7), camera, plate, PRINTER, 330.0, condition, **changes)
    return Scene(camera, plate, PRINTER, image, PINK)


def solve(seen: Scene) -> PoseResult:
    return calibrate_pose(seen.image, Lens.of(seen.camera), seen.plate, seen.colour)


def error_px(result: PoseResult, seen: Scene) -> np.ndarray:
    return volume_error_px(result.camera, seen.camera, (seen.printer.width_mm, seen.printer.depth_mm))


FRONT = camera_at((100, -130, 190), (100, 90, 0), "5 coefficients", focal_px=560)


@pytest.mark.parametrize("case", CASES)
def test_the_pose_from_a_rendered_plate_is_within_a_pixel_all_over_the_bed(shared, case):
    folder = shared / "cases" / case
    header = Header.from_json(json.loads((folder / "recording.json").read_text()))
    plate = MarkerPlate.from_json(json.loads((folder / "calib" / "markers.json").read_text()))
    image = cv2.imread(str(folder / "calib" / "markers.jpg"))
    result = calibrate_pose(image, Lens.of(header.camera()), plate, header.material)
    off_px = volume_error_px(result.camera, header.camera())
    assert all(px is not None for px in result.markers_px)
    assert off_px.mean() < 0.3
    assert off_px.max() < 1.0


@pytest.mark.parametrize("number", range(6))
def test_random_cameras_are_found_or_refused_but_never_wrong(number):
    seen = random_scene(np.random.default_rng(100 + number), CONDITIONS[number % len(CONDITIONS)])
    try:
        result = solve(seen)
    except CalibrationError:
        assert seen.hidden is not None, "only a plate with a marker missing may be refused"
        return
    wide = seen.camera.image_size_px[0] / 640
    assert error_px(result, seen).max() < (2.0 if seen.hidden is None else 4.0) * max(1.0, wide**0.5)


def test_a_far_marker_that_shows_its_side_does_not_pull_the_pose_as_it_pulls_the_ellipses_centre():
    seen = scene(camera_at((100, -160, 90), (100, 90, 0), "5 coefficients", focal_px=560))
    result = solve(seen)
    discs = find_discs(seen.image, seen.colour)
    centres_px = seen.camera.project(PLATE.tops_mm())
    naive_px = np.array([min(np.hypot(*(np.subtract(d.centre_px, px))) for d in discs) for px in centres_px])
    assert naive_px.max() > 1.0
    assert np.linalg.norm(np.array(result.markers_px) - centres_px, axis=1).max() < 0.5


def test_one_ellipse_tells_its_discs_place_and_tilt():
    seen = scene(FRONT)
    room = FRONT.camera_from_room
    tops = PLATE.tops_mm() @ room[:3, :3].T + room[:3, 3]
    for disc in find_discs(seen.image, seen.colour):
        poses = circle_poses(disc, PLATE.outer_diameter_mm, Lens.of(FRONT))
        assert len(poses) == 2
        nearest = min(np.linalg.norm(centre - top) / top[2] for centre, _ in poses for top in tops)
        assert nearest < 0.05
        assert max(normal @ room[:3, 2] for _, normal in poses) > np.cos(np.radians(12))


def test_a_camera_upside_down_or_rolled_is_found_and_said():
    for roll, word in ((180, "upside down"), (60, "rolled")):
        turn = np.eye(4)
        turn[:3, :3] = cv2.Rodrigues(np.array([0, 0, np.radians(roll)]))[0]
        moved = turn @ FRONT.camera_from_room
        camera = replace(FRONT, rvec=cv2.Rodrigues(moved[:3, :3])[0].ravel(), tvec_mm=moved[:3, 3])
        seen = scene(camera)
        result = solve(seen)
        assert error_px(result, seen).max() < 1.5
        assert abs(abs(roll_deg(result.camera)) - roll) < 2
        assert any(word in note for note in result.notes)


@pytest.mark.parametrize("axis", [0, 1])
def test_a_mirrored_picture_is_refused_as_such(axis):
    seen = scene(FRONT)
    with pytest.raises(CalibrationError, match="mirrored"):
        solve(replace(seen, image=np.ascontiguousarray(cv2.flip(seen.image, axis))))


def test_three_of_four_markers_are_enough_and_said():
    seen = scene(FRONT, "one hidden", hidden=2)
    result = solve(seen)
    assert result.markers_px[2] is None
    assert sum(px is not None for px in result.markers_px) == 3
    assert any("3 of 4 markers" in note and "missing: 3" in note for note in result.notes)
    assert error_px(result, seen).mean() < 2.0


def test_two_markers_are_refused_with_their_number():
    picture = scene(FRONT, "one hidden", hidden=2).image
    px = FRONT.project(PLATE.tops_mm())[0].astype(int)
    picture[px[1] - 45 : px[1] + 45, max(px[0] - 45, 0) : px[0] + 45] = 40
    with pytest.raises(CalibrationError, match="Only 2 of 4 markers"):
        calibrate_pose(picture, Lens.of(FRONT), PLATE, PINK)


def test_a_plate_whose_markers_can_be_exchanged_is_refused():
    square = MarkerPlate(16, 1.2, [[30, 30], [170, 30], [170, 170], [30, 170]], 6.0)
    with pytest.raises(CalibrationError, match="taken for each other"):
        solve(scene(FRONT, plate=square))


def test_markers_of_another_plate_are_refused():
    other = MarkerPlate(16, 1.2, PLATE.centres_mm * [0.6, 1.1], 6.0)
    with pytest.raises(CalibrationError, match="no three of them lie"):
        calibrate_pose(scene(FRONT).image, Lens.of(FRONT), other, PINK)


def test_the_colour_need_not_be_known():
    seen = scene(FRONT)
    result = calibrate_pose_any_colour(seen.image, Lens.of(FRONT), PLATE)
    assert error_px(result, seen).max() < 1.0


def test_a_picture_of_half_the_size_is_solved_with_the_same_lens_and_a_cropped_one_is_refused():
    seen = scene(FRONT)
    half = cv2.resize(seen.image, (320, 240), interpolation=cv2.INTER_AREA)
    result = calibrate_pose(half, Lens.of(FRONT), PLATE, PINK)
    assert volume_error_px(result.camera, FRONT.resized((320, 240)), (200, 200)).max() < 1.0
    with pytest.raises(CameraError, match="another shape"):
        calibrate_pose(seen.image[:, :480], Lens.of(FRONT), PLATE, PINK)


def test_a_black_picture_and_noise_are_refused():
    noise = np.random.default_rng(1).integers(0, 255, (480, 640, 3), dtype=np.uint8)
    for picture in (np.zeros((480, 640, 3), np.uint8), noise):
        with pytest.raises(CalibrationError):
            calibrate_pose(picture, Lens.of(FRONT), PLATE, PINK)
        with pytest.raises(CalibrationError):
            calibrate_pose_any_colour(picture, Lens.of(FRONT), PLATE)


def test_the_error_told_is_of_the_size_of_the_error_made():
    told, made = [], []
    for seed in range(200, 203):
        seen = random_scene(np.random.default_rng(seed))
        result = solve(seen)
        told.append(result.error_px[0])
        made.append(error_px(result, seen).mean())
    assert 0.2 < np.median(np.divide(made, told)) < 4


def test_no_two_markers_of_a_made_plate_can_be_exchanged():
    for printer in (PRINTER, Printer(300, 180, 200), Printer(200, 200, 300, "center", "circular")):
        centres = place_markers(printer, PlateSettings()).centres_mm
        middle = centres - centres.mean(axis=0)
        for order in list(permutations(range(4)))[1:]:
            for mirror in ([1, 1], [-1, 1]):
                u, _, vt = np.linalg.svd((middle * mirror)[list(order)].T @ middle)
                turned = (middle * mirror)[list(order)] @ (u @ np.diag([1, np.linalg.det(u @ vt)]) @ vt)
                assert np.linalg.norm(turned - middle, axis=1).max() > 8


@pytest.mark.parametrize(
    ("data", "said"),
    [
        ([], "must be an object"),
        ({"outer_diameter_mm": 16}, "height_mm, centres_mm"),
        ({"outer_diameter_mm": 16, "height_mm": 1, "centres_mm": [[0, 0], [50, 0]]}, "at least three"),
        ({"outer_diameter_mm": 16, "height_mm": 1, "centres_mm": [[0, 0], [50, 0], [100, 0]]}, "one line"),
        ({"outer_diameter_mm": 16, "height_mm": 1, "centres_mm": [[0, 0], [5, 0], [50, 90]]}, "overlap"),
        ({"outer_diameter_mm": 16, "height_mm": 1, "centres_mm": [[0, 0], [50, 0], [float("nan"), 9]]}, "finite"),
        ({"outer_diameter_mm": "x", "height_mm": 1, "centres_mm": [[0, 0], [50, 0], [0, 90]]}, "not numbers"),
        ({"outer_diameter_mm": -1, "height_mm": 1, "centres_mm": [[0, 0], [50, 0], [0, 90]]}, "cannot be"),
        ({"outer_diameter_mm": 16, "height_mm": 1, "centres_mm": "abc"}, "not numbers"),
        ({"outer_diameter_mm": 16, "height_mm": 1, "centres_mm": [[0, 0], [50, 0], [0]]}, "not numbers"),
    ],
)
def test_markers_that_make_no_sense_are_refused_with_a_sentence(data, said):
    with pytest.raises(CalibrationError, match=said):
        MarkerPlate.from_json(data)
