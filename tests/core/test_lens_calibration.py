"""The lens from checkerboards: rendered ones with a known lens, and drawn ones."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ElementTree

import cv2
import numpy as np
import pytest

from octoprint_moop.core.calibration.board import board_svg
from octoprint_moop.core.calibration.calibrate import Lens, calibrate_lens, lens_difference_px
from octoprint_moop.core.calibration.chessboard import Board, find_corners
from octoprint_moop.core.calibration.corners import fit_corners
from octoprint_moop.core.errors import CalibrationError, CameraError
from octoprint_moop.core.header import Header

BOARD = Board(9, 6, 15.0)
WEBCAM_K = np.array([[610.0, 0, 325], [0, 611.0, 236], [0, 0, 1]])
WEBCAM = Lens((640, 480), WEBCAM_K, np.array([-0.2, 0.06, 8e-4, -6e-4, 0]))
FISHEYE = Lens((640, 480), np.array([[330.0, 0, 322], [0, 330.0, 238], [0, 0, 1]]), np.array([0.03, -0.01, 0.002, 0]),
               "fisheye")  # fmt: skip


def view(lens: Lens, rvec, centre_mm, board: Board = BOARD, blur: float = 0.7, seed: int = 0) -> np.ndarray:
    """A board drawn square by square through the lens, four samples a pixel each way."""
    rotation = cv2.Rodrigues(np.asarray(rvec, float))[0]
    middle = np.array([(board.columns - 1) / 2, (board.rows - 1) / 2, 0]) * board.square_mm
    camera = lens.at(rvec, np.asarray(centre_mm, float) - rotation @ middle)
    fine = np.full((480 * 4, 640 * 4), 110, np.uint8)

    def fill(corner, size, grey):
        t = np.linspace(0, 1, 12, endpoint=False)
        edge = np.vstack([np.column_stack([t, 0 * t]), np.column_stack([0 * t + 1, t]),
                          np.column_stack([1 - t, 0 * t + 1]), np.column_stack([0 * t, 1 - t])])  # fmt: skip
        flat = np.asarray(corner) + edge * np.asarray(size)
        px = camera.project(np.column_stack([flat, np.zeros(len(flat))]) * [board.square_mm, board.square_mm, 1])
        cv2.fillPoly(fine, [np.round((px * 4 + 1.5) * 16).astype(np.int32)], grey, shift=4)

    fill((-2, -2), (board.columns + 3, board.rows + 3), 225)
    for row in range(board.rows + 1):
        for column in range(board.columns + 1):
            if (row + column) % 2 == 0:
                fill((column - 1, row - 1), (1, 1), 25)
    image = cv2.GaussianBlur(cv2.resize(fine, (640, 480), interpolation=cv2.INTER_AREA), (0, 0), blur)
    noisy = image + np.random.default_rng(seed).normal(0, 2.0, image.shape)
    return np.clip(noisy, 0, 255).astype(np.uint8)


def views(lens: Lens, count: int = 12, near_mm: float = 190) -> list[tuple[str, np.ndarray]]:
    rng = np.random.default_rng(5)
    places = [(-45, -28), (45, -28), (45, 28), (-45, 28), (0, 0), (0, -32), (0, 32), (-55, 0), (55, 0)]
    pictures = []
    for number in range(count):
        x, y = places[number % len(places)]
        tilt = rng.uniform(-0.55, 0.55, 3) * [1, 1, 0.6]
        distance = near_mm * rng.uniform(1.0, 1.35)
        pictures.append((f"{number}.jpg", view(lens, tilt, (x, y, distance), seed=number)))
    return pictures


@pytest.mark.parametrize("case", ["cube-clean", "dtu-paper"])
def test_the_lens_of_rendered_pictures_is_found_to_half_a_pixel(shared, case):
    folder = shared / "cases" / case
    told = json.loads((folder / "calib" / "calib.json").read_text())
    images = [(path.name, cv2.imread(str(path))) for path in sorted((folder / "calib").glob("checkerboard_*.jpg"))]
    result = calibrate_lens(images, Board(*told["inner_corners"], told["square_mm"]))
    true = Lens.of(Header.from_json(json.loads((folder / "recording.json").read_text())).camera())
    assert lens_difference_px(result.lens, true, rotation_free=False).max() < 0.5
    assert lens_difference_px(result.lens, true).max() < 0.2
    assert not result.rejected


def test_corners_are_fitted_to_a_few_hundredths_of_a_pixel():
    tilt, centre_mm = np.array([0.4, -0.3, 0.2]), np.array([0.0, 0.0, 220.0])
    picture = view(WEBCAM, tilt, centre_mm)
    middle = np.array([(BOARD.columns - 1) / 2, (BOARD.rows - 1) / 2, 0]) * BOARD.square_mm
    camera = WEBCAM.at(tilt, centre_mm - cv2.Rodrigues(tilt)[0] @ middle)
    true_px = camera.project(BOARD.points_mm())
    found_px = find_corners(picture, BOARD)
    if np.linalg.norm(found_px[0] - true_px[0]) > 5:  # a board turned by half is the same board
        found_px = found_px[::-1]
    elsewhere = WEBCAM.at(tilt + [1e-3, 1e-3, 0], camera.tvec_mm)  # the camera need only be known roughly
    better_px = fit_corners(picture, elsewhere, found_px, BOARD)
    before, after = (np.sqrt(((px - true_px) ** 2).mean()) for px in (found_px, better_px))
    assert after < 0.7 * before
    assert after < 0.04
    lost = fit_corners(np.full_like(picture, 128), camera, found_px, BOARD)
    assert np.array_equal(lost, found_px), "where nothing is seen they stay as they were"


def test_a_drawn_lens_is_found_and_its_error_told():
    result = calibrate_lens(views(WEBCAM), BOARD)
    off_px = lens_difference_px(result.lens, WEBCAM)
    assert result.lens.model == "pinhole"
    assert off_px.mean() < 0.3
    assert 0.2 < off_px.mean() / result.error_px[0] < 5
    assert 0.3 < result.coverage_ratio < 1
    assert {"fx", "fy", "cx", "cy", "k1"} <= set(result.standard_error)


def test_a_fisheye_is_told_from_a_pinhole():
    result = calibrate_lens(views(FISHEYE, near_mm=95), BOARD)
    assert result.lens.model == "fisheye"
    off_px = lens_difference_px(result.lens, FISHEYE)
    assert np.nanmean(off_px) < 0.5


def test_no_distortion_is_made_up_for_a_straight_lens():
    straight = Lens((640, 480), WEBCAM.K, np.zeros(5))
    result = calibrate_lens(views(straight), BOARD, "pinhole")
    assert lens_difference_px(result.lens, straight).max() < 0.5
    assert result.order in ("none", "k1")


def test_each_picture_that_is_not_used_has_its_reason():
    good = views(WEBCAM, 8)
    blurred = cv2.GaussianBlur(good[2][1], (0, 0), 7)
    bad = [
        ("blurred", blurred), ("twin", good[0][1]), ("turned", cv2.flip(good[1][1], -1)), ("small", good[3][1][:240]),
        ("empty", np.full((480, 640), 128, np.uint8)),
        ("another board", view(WEBCAM, (0, 0, 0), (0, 0, 220), Board(7, 5, 20))),
    ]  # fmt: skip
    result = calibrate_lens(good + bad, BOARD, "pinhole")
    why = dict(result.rejected)
    assert set(why) >= {"blurred", "twin", "small", "empty", "another board"}
    assert "0.jpg" in why["twin"]
    assert "640 x 240" in why["small"]
    assert "blurred" in why["blurred"] or "no board" in why["blurred"]
    assert lens_difference_px(result.lens, WEBCAM).mean() < 0.5


def test_a_view_that_does_not_fit_the_others_is_left_out():
    pictures = views(WEBCAM, 10)
    x, y = np.meshgrid(np.arange(640, dtype=np.float32), np.arange(480, dtype=np.float32))
    bent = cv2.remap(pictures[4][1], x, (y + 6 * np.sin(x / 60)).astype(np.float32), cv2.INTER_LINEAR)
    result = calibrate_lens([*pictures[:4], ("bent", bent), *pictures[5:]], BOARD, "pinhole")
    assert "fits only to" in dict(result.rejected)["bent"]


def test_pictures_that_cannot_do_are_refused_with_what_to_do():
    picture = views(WEBCAM, 1)[0][1]
    with pytest.raises(CalibrationError, match="no pictures"):
        calibrate_lens([], BOARD)
    with pytest.raises(CalibrationError, match="None of the 2"):
        calibrate_lens([("a", np.zeros((480, 640), np.uint8))] * 2, BOARD)
    with pytest.raises(CalibrationError, match="give 9x6"):
        calibrate_lens([("a", picture)], Board(10, 7, 15.0))
    with pytest.raises(CalibrationError, match="Only 1 of 4"):
        calibrate_lens([(str(k), picture) for k in range(4)], BOARD)
    with pytest.raises(CalibrationError, match="lens model"):
        calibrate_lens([("a", picture)], BOARD, "mirror")


@pytest.mark.parametrize(("corners", "side"), [("9", 15), ("axb", 15), ("2x6", 15), ("9x6", 0), ("9x6", float("nan"))])
def test_a_board_that_makes_no_sense_is_refused(corners, side):
    with pytest.raises(CalibrationError):
        Board.parse(corners, side)


def test_rays_and_projection_undo_each_other():
    for lens in (WEBCAM, FISHEYE):
        px = np.random.default_rng(2).uniform([0, 0], [639, 479], (200, 2))
        rays = lens.rays(px)
        assert np.abs(lens.project(np.column_stack([rays, np.ones(200)])) - px).max() < 1e-3


def test_a_lens_can_be_read_from_a_result_and_nonsense_cannot():
    data = calibrate_lens(views(WEBCAM, 6), BOARD, "pinhole").to_json()
    json.dumps(data, allow_nan=False)
    three = calibrate_lens(views(WEBCAM, 3, near_mm=240), BOARD, "pinhole")
    json.dumps(three.to_json(), allow_nan=False)
    assert any("Only 3 views" in note for note in three.notes)
    assert np.allclose(Lens.from_json(data).K, data["K"])
    for nonsense in ({}, [], {"K": [[1]]}, {**data, "K": [[float("nan")] * 3] * 3}, {**data, "image_size_px": None}):
        with pytest.raises(CameraError):
            Lens.from_json(nonsense)


def test_the_printed_board_is_found_as_the_board_it_says():
    root = ElementTree.fromstring(board_svg(BOARD))
    assert root.attrib["width"] == "180mm"
    path = root[1].attrib["d"]
    page = np.full((round(float(root.attrib["height"][:-2]) * 4), 720), 255, np.uint8)
    for square in path.split("z")[:-1]:
        x, y = (float(part) for part in square[1:].split("h")[0].split())
        page[round(y * 4) : round((y + 15) * 4), round(x * 4) : round((x + 15) * 4)] = 0
    found, corners = cv2.findChessboardCornersSB(page, (9, 6))
    assert found
    assert np.ptp(corners.reshape(-1, 2), axis=0) == pytest.approx([8 * 60, 5 * 60], abs=1)
