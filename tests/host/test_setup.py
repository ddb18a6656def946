"""The set-up's routes: a marker plate, a lens, and the camera's place, found on a real server."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from octoprint_moop.core.gcode.read import read_gcode

from .room import HEIGHT, WIDTH, camera, header


def show(room, picture: np.ndarray) -> None:
    room.webcam.shown = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 95])[1].tobytes()


def test_the_marker_plate_lies_among_the_files_and_can_be_printed(room):
    made = room.moop("POST", "calibrate/markers", json={"nozzle_temperature": 205})
    path = room.server.basedir / "uploads" / made["file"]
    toolpath = read_gcode(path)
    (x0, y0, _), (x1, y1, _) = toolpath.bounds_mm()
    centres = np.array(made["markers"]["centres_mm"])
    assert ([x0, y0] < centres.min(axis=0)).all() and ([x1, y1] > centres.max(axis=0)).all()
    answer = room.server.request("POST", "/plugin/moop/calibrate/markers", json={"height_mm": 99})
    assert answer.status_code == 400 and "height_mm" in answer.json()["message"]


def test_the_cameras_place_is_found_from_clicked_points(room):
    truth = camera()
    mm = [[60, 60, 0], [140, 60, 0], [140, 140, 0], [60, 140, 0], [100, 100, 20], [90, 120, 0]]
    px = truth.project(np.array(mm, dtype=float))
    standing = room.moop("POST", "calibrate/points/picture", json={})["bed_reference_mm"]
    assert set(standing) == {"x", "y", "z"}
    points = [{"mm": m, "px": p.tolist()} for m, p in zip(mm, px)]
    found = room.moop("POST", "calibrate/points", json={"points": points, "lens": header()["camera"]})
    assert np.allclose(found["tvec_mm"], truth.tvec_mm, atol=0.5)
    answer = room.server.request("POST", "/plugin/moop/calibrate/points", json={"points": points[:3]})
    assert answer.status_code == 400 and answer.json()["code"] == "calibration"


def test_the_lens_is_found_from_pictures_of_a_checkerboard(room):
    squares = np.kron(np.indices((7, 10)).sum(0) % 2, np.ones((60, 60))).astype(np.uint8) * 255
    board = cv2.cvtColor(squares, cv2.COLOR_GRAY2BGR)
    board = cv2.copyMakeBorder(board, 60, 60, 60, 60, cv2.BORDER_CONSTANT, value=(255, 255, 255))
    truth = camera().undistorted()
    rng = np.random.default_rng(3)
    room.server.request("DELETE", "/plugin/moop/calibrate/lens/pictures")
    kept = 0
    for tilt in ((0.4, 0), (-0.4, 0.1), (0, 0.45), (0.1, -0.4), (0.3, 0.3), (-0.3, -0.3), (0.25, -0.35), (-0.35, 0.25)):
        rotation = cv2.Rodrigues(np.array([*tilt, rng.uniform(-0.3, 0.3)]))[0]
        plane = np.array([[x, y, 0] for x, y in ((-90, -67), (90, -67), (90, 67), (-90, 67))], dtype=float)
        at = plane @ rotation.T + [rng.uniform(-25, 25), rng.uniform(-20, 20), 480]
        corners = (at[:, :2] / at[:, 2:]) * 1100 + [(WIDTH - 1) / 2, (HEIGHT - 1) / 2]
        source = np.float32([[-0.5, -0.5], [719.5, -0.5], [719.5, 539.5], [-0.5, 539.5]])
        warp = cv2.getPerspectiveTransform(source, np.float32(corners))
        show(room, cv2.warpPerspective(board, warp, (WIDTH, HEIGHT), flags=cv2.INTER_AREA, borderValue=(180, 180, 180)))
        answer = room.moop("POST", "calibrate/lens/pictures", json={"board": "9x6", "square_mm": 15})
        kept = answer["kept"]
    assert kept >= 6
    lens = room.moop("POST", "calibrate/lens", json={"board": "9x6", "square_mm": 15}, timeout_s=120)
    assert lens["K"][0][0] == pytest.approx(truth.K[0, 0], rel=0.02)
    assert room.moop("GET", "calibrate/lens")["lens"]["K"] == lens["K"]
    assert room.server.request("GET", "/plugin/moop/calibrate/lens/pictures/0.jpg").content[:2] == b"\xff\xd8"


def test_a_picture_without_a_board_is_not_kept(room):
    before = room.moop("POST", "calibrate/lens/pictures", json={"square_mm": 15})
    assert before["id"] is None and before["corners_px"] is None
    answer = room.server.request("POST", "/plugin/moop/calibrate/lens/pictures", json={})
    assert answer.status_code == 400 and "square_mm" in answer.json()["message"]


def test_the_printers_geometry_comes_from_its_profile(room):
    printer = room.moop("GET", "calibrate/printer")["printer"]
    assert printer["volume_mm"] == {"width": 200.0, "depth": 200.0, "height": 200.0}


def test_a_pose_without_markers_in_view_is_refused_with_a_sentence(room):
    room.moop("POST", "calibrate/markers", json={})
    answer = room.server.request("POST", "/plugin/moop/calibrate/pose", json={}, timeout_s=120)
    assert answer.status_code == 400 and answer.json()["code"] == "calibration"
    assert room.server.request("GET", "/plugin/moop/calibrate/picture.jpg").content[:2] == b"\xff\xd8"


def test_a_checkerboard_to_print_is_a_picture(room):
    answer = room.server.request("GET", "/plugin/moop/calibrate/board.svg?board=9x6&square_mm=20")
    assert answer.status_code == 200 and b"<svg" in answer.content
