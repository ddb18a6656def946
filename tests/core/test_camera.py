"""A camera stays the same camera at another resolution, and turned as OctoPrint turns its pictures."""

from __future__ import annotations

import itertools
from dataclasses import FrozenInstanceError

import cv2
import numpy as np
import pytest

from octoprint_moop.core.camera import BedMotion, Camera
from octoprint_moop.core.errors import CameraError
from octoprint_moop.core.expected.lens import outermost_ray, radial_px, tilt
from octoprint_moop.core.expected.raster import CvRenderer
from octoprint_moop.core.view.orientation import Orientation
from tests.made import LENSES, camera_at, vase

POINTS = np.random.default_rng(3).uniform((60, 60, 0), (140, 140, 40), (200, 3))
ALL = [Orientation(*flags) for flags in itertools.product((False, True), repeat=3)]


def eye(lens="5 coefficients"):
    return camera_at((180, -60, 110), (100, 100, 10), lens)


def test_a_quarter_turn_is_counter_clockwise_and_comes_after_the_flips():
    picture = np.array([[1, 2, 3], [4, 5, 6]])
    assert Orientation(rotate_90=True).apply(picture).tolist() == [[3, 6], [2, 5], [1, 4]]
    assert Orientation(flip_h=True).apply(picture).tolist() == [[3, 2, 1], [6, 5, 4]]
    assert Orientation(flip_v=True).apply(picture).tolist() == [[4, 5, 6], [1, 2, 3]]
    assert Orientation(True, False, True).apply(picture).tolist() == [[1, 4], [2, 5], [3, 6]]


@pytest.mark.parametrize("orientation", ALL)
def test_what_was_turned_can_be_turned_back(orientation):
    picture = np.random.default_rng(0).integers(0, 255, (6, 9, 3), np.uint8)
    assert np.array_equal(orientation.undo(orientation.apply(picture)), picture)
    assert np.array_equal(orientation.inverse.apply(picture), orientation.undo(picture))


@pytest.mark.parametrize("lens", [name for name in LENSES if name != "14 coefficients"])
@pytest.mark.parametrize("orientation", ALL)
def test_the_turned_camera_sees_points_where_the_turned_picture_shows_them(orientation, lens):
    camera = eye(lens)
    if orientation.flip_h != orientation.flip_v:
        with pytest.raises(CameraError, match="mirror"):
            orientation.camera(camera)
        return
    width, height = camera.image_size_px
    x, y = camera.project(POINTS).T
    if orientation.flip_h:
        x = width - 1 - x
    if orientation.flip_v:
        y = height - 1 - y
    if orientation.rotate_90:
        x, y = y, width - 1 - x
    assert np.allclose(orientation.camera(camera).project(POINTS), np.stack([x, y], axis=1), atol=1e-6)


def test_the_mask_of_the_turned_camera_is_the_turned_mask():
    orientation = Orientation(True, True, True)
    straight = CvRenderer().birth_map(vase(), eye(), np.zeros(3)) > 0
    turned = CvRenderer().birth_map(vase(), orientation.camera(eye()), np.zeros(3)) > 0
    assert (orientation.apply(straight) ^ turned).sum() <= 3


def test_a_tilted_sensor_is_refused_and_not_turned_wrongly():
    with pytest.raises(CameraError, match="tilted"):
        Orientation(rotate_90=True).camera(eye("14 coefficients"))


@pytest.mark.parametrize("lens", LENSES)
def test_another_resolution_shows_the_same_view(lens):
    camera = eye(lens)
    double = camera.resized((1280, 960))
    # the picture's corner lies half a pixel before the first centre, at both resolutions
    assert np.allclose((double.project(POINTS) + 0.5) / 2, camera.project(POINTS) + 0.5, atol=1e-6)
    small = CvRenderer().birth_map(vase(), camera, np.zeros(3)) > 0
    large = CvRenderer().birth_map(vase(), double, np.zeros(3)) > 0
    shrunk = cv2.resize(large.astype(np.float32), (640, 480), interpolation=cv2.INTER_AREA)
    assert not small[shrunk == 0].any()
    assert abs(shrunk.sum() - small.sum()) < 0.02 * small.sum()


def test_a_resolution_that_is_no_whole_multiple_shows_the_same_view_too():
    camera = eye()
    other = camera.resized((1000, 750))
    assert np.allclose((other.project(POINTS) + 0.5) * 0.64, camera.project(POINTS) + 0.5, atol=1e-6)
    assert camera.resized((644, 480)).image_size_px == (644, 480)  # rounding of a scaler, not another shape


@pytest.mark.parametrize("lens", [name for name in LENSES if name != "14 coefficients"])
def test_rays_have_length_one_and_point_at_what_their_pixels_show(lens):
    camera = eye(lens)
    rays = camera.rays(camera.project(POINTS))
    to_points = POINTS - camera.centre_mm
    in_room = rays @ camera.camera_from_room[:3, :3]
    assert np.allclose(np.linalg.norm(rays, axis=1), 1, atol=1e-12)
    assert np.allclose(in_room, to_points / np.linalg.norm(to_points, axis=1, keepdims=True), atol=1e-4)
    assert camera.rays(np.empty((0, 2))).shape == (0, 3)


@pytest.mark.parametrize("lens", LENSES)
def test_many_points_and_few_are_seen_where_opencv_sees_them(lens):
    camera, seen = eye(lens), cv2.fisheye.projectPoints if lens == "fisheye" else cv2.projectPoints
    many = np.tile(POINTS, (3, 1))
    theirs, _ = seen(many.reshape(-1, 1, 3), camera.rvec, camera.tvec_mm, camera.K, camera.distortion)
    assert np.allclose(camera.project(many), theirs.reshape(-1, 2), atol=1e-9)
    assert np.allclose(camera.project(many[:50]), theirs.reshape(-1, 2)[:50], atol=1e-9)


@pytest.mark.parametrize("place", range(8))
def test_many_points_are_bent_by_each_number_of_the_lens_alone_as_opencv_bends_them(place):
    plain = eye()
    lens = np.zeros(8)
    lens[place] = 0.05
    camera = Camera(plain.image_size_px, plain.K, lens, plain.rvec, plain.tvec_mm)
    many = np.tile(POINTS, (3, 1))
    theirs, _ = cv2.projectPoints(many, camera.rvec, camera.tvec_mm, camera.K, camera.distortion)
    assert np.allclose(camera.project(many), theirs.reshape(-1, 2), atol=1e-9)
    assert np.abs(camera.project(many) - plain.undistorted().project(many)).max() > 1e-4  # it does bend


def test_what_is_at_or_behind_the_camera_has_no_pixel():
    camera = Camera((640, 480), np.diag([600.0, 600.0, 1.0]), np.zeros(5), np.zeros(3), np.zeros(3))
    pixels = camera.project([[0.1, 0.2, 0.5], [1, 1, 0], [0, 0, -5]])
    assert np.allclose(pixels[0], [120, 240]) and np.isnan(pixels[1:]).all()
    assert camera.project(np.empty((0, 3))).shape == (0, 2)
    many = np.tile([[0.1, 0.2, 0.5], [1, 1, 0], [0, 0, -5]], (200, 1))
    assert np.array_equal(camera.project(many), np.tile(pixels, (200, 1)), equal_nan=True)


@pytest.mark.parametrize("model, legal", [("pinhole", {0, 4, 5, 8, 12, 14}), ("fisheye", {4})])
def test_a_lens_has_as_many_numbers_as_opencv_knows(model, legal):
    good = eye().to_json()
    for count in range(16):
        data = {**good, "model": model, "distortion": [0.0] * count}
        if count in legal:
            assert Camera.from_json(data).distortion.size == count
        else:
            with pytest.raises(CameraError, match=f"not {count}"):
                Camera.from_json(data)


def test_a_camera_cannot_be_changed_behind_the_back_of_whoever_uses_it():
    camera = eye()
    for numbers in (camera.K, camera.distortion, camera.rvec, camera.tvec_mm):
        with pytest.raises(ValueError):
            numbers[0] = 1
    with pytest.raises(FrozenInstanceError):
        camera.model = "fisheye"
    with pytest.raises(FrozenInstanceError):
        BedMotion().kind = "y"


def test_a_camera_can_be_a_key_and_is_equal_to_itself_alone():
    camera = eye()
    assert camera in {camera} and camera not in {eye()}


@pytest.mark.parametrize("lens", LENSES)
def test_a_camera_survives_its_file_and_names_its_model_only_where_it_is_not_the_usual_one(lens):
    camera = eye(lens)
    stored = camera.to_json()
    assert ("model" in stored) == (lens == "fisheye")
    again = Camera.from_json(stored)
    assert again.model == camera.model and np.array_equal(again.project(POINTS[:3]), camera.project(POINTS[:3]))


def test_a_pose_is_a_matrix_of_four_by_four():
    matrix = eye().camera_from_room
    assert matrix.shape == (4, 4) and matrix[3].tolist() == [0, 0, 0, 1]
    assert np.allclose(matrix @ [*eye().centre_mm, 1], [0, 0, 0, 1])


@pytest.mark.parametrize("lens", LENSES)
def test_a_turned_camera_sees_directions_where_the_camera_sees_the_points_that_lie_there(lens):
    camera, turn = eye(lens), np.array([0.02, -0.03, 0.05])
    in_camera = POINTS[:5] @ camera.camera_from_room[:3, :3].T + camera.tvec_mm
    assert np.allclose(camera.turned(np.zeros(3)).project(in_camera), camera.project(POINTS[:5]), atol=1e-6)
    turned = camera.turned(turn)
    assert turned.centre_mm.tolist() == [0, 0, 0]
    there = in_camera @ cv2.Rodrigues(turn)[0].T
    assert np.allclose(turned.project(in_camera), camera.turned(np.zeros(3)).project(there), atol=1e-6)


@pytest.mark.parametrize("lens", LENSES)
def test_a_camera_without_its_lens_is_a_pinhole(lens):
    camera = eye(lens)
    flat = camera.K @ (camera.camera_from_room @ np.vstack([POINTS.T, np.ones(len(POINTS))]))[:3]
    assert np.allclose(camera.undistorted().project(POINTS), (flat[:2] / flat[2]).T, atol=1e-6)


def test_another_shape_of_picture_is_refused():
    for size in ((1280, 720), (640, 520), (656, 480)):
        with pytest.raises(CameraError, match=f"{size[0]} x {size[1]} px.* 640 x 480 px"):
            eye().resized(size)


@pytest.mark.parametrize("lens", ["5 coefficients", "8 coefficients", "fisheye"])
def test_the_lens_reaches_out_to_where_its_polynomial_turns_back(lens):
    camera = eye(lens)
    edge = outermost_ray(camera)
    tangent = np.linspace(0.01, edge, 50)
    rays = np.stack([tangent, 0 * tangent, 1 + 0 * tangent], axis=1)
    plain = Camera((640, 480), np.eye(3), camera.distortion * [1, 1, 0, 0, *[1] * (camera.distortion.size - 4)]
                   if camera.model == "pinhole" else camera.distortion, np.zeros(3), np.zeros(3), camera.model)  # fmt: skip
    assert np.allclose(plain.project(rays)[:, 0], radial_px(camera, tangent), atol=1e-9)
    assert (np.diff(plain.project(rays)[:, 0]) > -1e-6).all()


def test_a_tilt_is_the_one_of_opencv():
    camera = eye("14 coefficients")
    without = Camera(camera.image_size_px, camera.K, camera.distortion[:12], camera.rvec, camera.tvec_mm)
    flat = np.linalg.inv(camera.K) @ np.vstack([without.project(POINTS).T, np.ones(len(POINTS))])
    tilted = camera.K @ tilt(camera) @ flat
    assert np.allclose((tilted[:2] / tilted[2]).T, camera.project(POINTS), atol=1e-6)


def test_a_bed_moves_the_print_against_the_machine():
    assert BedMotion().kind == "fixed" and BedMotion("y").reference_mm == (0, 0, 0)
    assert BedMotion("fixed", (1, 2, 3)).room_from_print_mm((9, 9, 9)).tolist() == [0, 0, 0]
    assert BedMotion("y", (0, 200, 0)).room_from_print_mm((9, 150, 9)).tolist() == [0, 50, 0]
    assert BedMotion("z", (0, 0, 10)).room_from_print_mm((9, 9, 30)).tolist() == [0, 0, -20]
    with pytest.raises(CameraError, match="diagonal"):
        BedMotion("diagonal")
    with pytest.raises(CameraError, match="finite"):
        BedMotion("y", (0, float("inf"), 0))


def test_numbers_that_are_no_camera_are_refused_in_words():
    good = eye().to_json()
    for key, value, said in (
        ("K", [[1, 2], [3, 4]], "shape"), ("K", "abc", "list of numbers"),
        ("K", np.diag([-600, 600, 1]).tolist(), "focal"), ("K", np.diag([600, 0, 1]).tolist(), "focal"),
        ("K", np.diag([0, 600, 1]).tolist(), "focal"), ("K", np.diag([600, -600, 1]).tolist(), "focal"),
        ("K", np.eye(4).tolist(), "shape"),
        ("image_size_px", [640, 0], "640 x 0"),
        ("distortion", [0.1] * 6, "distortion"), ("rvec", [0, 0, float("nan")], "finite"), ("tvec_mm", None, "tvec_mm"),
        ("image_size_px", [0, 480], "0 x 480"), ("image_size_px", 640, "width, height"), ("model", "mirror", "mirror"),
    ):  # fmt: skip
        with pytest.raises(CameraError, match=said):
            Camera.from_json({**good, key: value})
    assert Camera.from_json({**good, "image_size_px": [1, 1]}).image_size_px == (1, 1)
    assert Camera.from_json(good).to_json() == good
    fisheye = eye("fisheye").to_json()
    assert Camera.from_json(fisheye).to_json() == fisheye
