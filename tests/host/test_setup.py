"""The set-up's routes: a marker plate, a lens, and the camera's place, found on a real server."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import trimesh

from octoprint_moop.core.gcode.read import read_gcode
from octoprint_moop.core.view.orientation import Orientation

from .room import HEIGHT, WIDTH, camera, header

BED_TEXTURE = np.random.default_rng(5).integers(0, 255, (50, 50, 3), np.uint8)


def show(room, picture: np.ndarray) -> None:
    room.webcam.shown = jpeg(picture)


def jpeg(picture: np.ndarray) -> bytes:
    return cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 95])[1].tobytes()


def bed_moved_by(shift_mm: np.ndarray) -> np.ndarray:
    """A bed with a pattern, as the room's camera sees it once it has moved."""
    corners_mm = np.array([[0, 0, 0], [200, 0, 0], [200, 200, 0], [0, 200, 0]], dtype=float) + shift_mm
    corners_px = np.float32(camera().project(corners_mm))
    texture = cv2.resize(BED_TEXTURE, (800, 800), interpolation=cv2.INTER_CUBIC)
    warp = cv2.getPerspectiveTransform(np.float32([[0, 0], [800, 0], [800, 800], [0, 800]]), corners_px)
    return cv2.warpPerspective(texture, warp, (WIDTH, HEIGHT), flags=cv2.INTER_AREA, borderValue=(90, 90, 90))


def refused(room, path: str, **body) -> str:
    answer = room.server.request("POST", f"/plugin/moop/{path}", json=body, timeout_s=60)
    assert answer.status_code == 400, answer.text
    return answer.json()["message"]


def test_the_marker_plate_lies_among_the_files_and_can_be_printed(room):
    made = room.moop("POST", "calibrate/markers", json={"nozzle_temperature": 205})
    path = room.server.basedir / "uploads" / made["file"]
    toolpath = read_gcode(path)
    (x0, y0, _), (x1, y1, _) = toolpath.bounds_mm()
    centres = np.array(made["markers"]["centres_mm"])
    assert ([x0, y0] < centres.min(axis=0)).all() and ([x1, y1] > centres.max(axis=0)).all()
    answer = room.server.request("POST", "/plugin/moop/calibrate/markers", json={"height_mm": 99})
    assert answer.status_code == 400 and "height_mm" in answer.json()["message"]


def test_a_model_with_markers_is_kept_until_the_cameras_place_is(room):
    cube = trimesh.creation.box(extents=(20, 20, 20)).export(file_type="stl")
    made = room.server.request("POST", "/plugin/moop/calibrate/markers/model", files={"file": ("cube.stl", cube)})
    marked = room.server.request("GET", "/plugin/moop/calibrate/markers/model.stl")
    assert len(marked.content) == made.json()["bytes"] > len(cube)
    room.moop("POST", "setup", json={**header(), "how": "points"})
    gone = room.server.request("GET", "/plugin/moop/calibrate/markers/model.stl")
    assert gone.status_code == 404 and "Make it anew" in gone.text
    assert not list(room.server.basedir.rglob("model-with-markers.stl"))


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


def test_a_calibration_is_kept_named_and_reverted(room):
    room.set_up()
    before = room.moop("GET", "calibrations")
    moved = header()
    moved["camera"]["tvec_mm"][0] += 1
    changed = room.moop(
        "POST", "setup", json={**moved, "name": "Higher", "how": "points", "error_px": {"mean": 1, "max": 3}}
    )
    assert changed["changed"] == ["camera"]
    after = room.moop("GET", "calibrations")
    newest = after["calibrations"][0]
    assert len(after["calibrations"]) == len(before["calibrations"]) + 1
    assert (newest["name"], newest["how"], newest["error_px"]) == ("Higher", "points", {"mean": 1, "max": 3})
    assert newest["id"] == after["current"] != before["current"] and newest["stale"] == []
    assert room.moop("POST", "calibrations/revert", json={})["current"] == before["current"]
    assert room.moop("GET", "setup")["camera"] == header()["camera"]
    assert (
        room.moop("POST", f"calibrations/{newest['id']}", json={"name": "Shelf"})["calibrations"][0]["name"] == "Shelf"
    )
    assert room.moop("POST", f"calibrations/{newest['id']}/use", json={})["current"] == newest["id"]
    assert "in use" in room.server.request("DELETE", f"/plugin/moop/calibrations/{newest['id']}").json()["message"]
    room.moop("POST", "calibrations/revert", json={})
    left = room.server.api("DELETE", f"/plugin/moop/calibrations/{newest['id']}")
    assert newest["id"] not in [each["id"] for each in left["calibrations"]]
    assert "number 999" in refused(room, "calibrations/999/use")


def test_what_was_exported_can_be_taken_over_again(room):
    room.set_up()
    number = room.moop("GET", "calibrations")["current"]
    answer = room.server.request("GET", f"/plugin/moop/calibrations/{number}.json")
    assert "attachment" in answer.headers["Content-Disposition"]
    exported = answer.json()
    other = header()
    other["camera"]["tvec_mm"][2] += 5
    room.moop("POST", "setup", json=other)
    assert room.moop("POST", "setup", json={**exported, "name": "From the file"})["changed"] == ["camera"]
    setup = room.moop("GET", "setup")
    assert setup["camera"] == header()["camera"] and setup["calibration"]["name"] == "From the file"


def test_a_calibration_of_turned_pictures_is_turned_back(room):
    turned = Orientation(True, True, True).camera(camera())
    room.moop("POST", "setup", json={
        **header(), "camera": turned.to_json(), "turned": {"flip_h": True, "flip_v": True, "rotate_90": True},
    })  # fmt: skip
    kept = room.moop("GET", "setup")["camera"]
    assert kept["image_size_px"] == [WIDTH, HEIGHT]
    assert np.allclose(kept["K"], camera().K) and np.allclose(kept["tvec_mm"], camera().tvec_mm)
    room.set_up()


def test_a_webcam_that_was_flipped_or_resized_since_is_told_as_stale(room):
    room.set_up()
    show(room, np.zeros((HEIGHT // 2, WIDTH, 3), np.uint8))
    room.server.request("GET", "/plugin/moop/frame")
    try:
        room.server.api("POST", "/api/settings", json={"plugins": {"classicwebcam": {"flipH": True}}})
        told = room.moop("GET", "calibrations")
        assert told["now"] == {
            "image_size_px": [WIDTH, HEIGHT // 2],
            "flip_h": True,
            "flip_v": False,
            "rotate_90": False,
        }
        current = next(each for each in told["calibrations"] if each["id"] == told["current"])
        assert "another shape" in current["stale"][0] and "flip horizontally" in current["stale"][1]
        assert room.moop("GET", "setup")["calibration"]["stale"] == current["stale"]
    finally:
        room.server.api("POST", "/api/settings", json={"plugins": {"classicwebcam": {"flipH": False}}})
        room.webcam.shown = b""
        room.server.request("GET", "/plugin/moop/frame")


def test_the_beds_motion_is_measured_but_not_before_it_is_agreed_to(room):
    room.reconnect()
    show(room, bed_moved_by(np.zeros(3)))
    room.moop("POST", "calibrate/points/picture", json={})
    told = room.moop("GET", "calibrate/bed-motion")
    assert not told["can"] and "homed" in told["why"]
    assert "home it" in refused(room, "calibrate/bed-motion", camera=header()["camera"], confirmed=True)
    room.server.api("POST", "/api/printer/command", json={"commands": ["G28", "G1 X10 Y20 Z10"]})
    assert "take that picture again" in refused(room, "calibrate/bed-motion", camera=header()["camera"], moved=True)
    room.moop("POST", "calibrate/points/picture", json={})
    told = room.moop("GET", "calibrate/bed-motion")
    assert (
        told["can"] and told["from_mm"] == {"x": 10, "y": 20, "z": 10} and told["to_mm"] == {"x": 10, "y": 80, "z": 40}
    )
    assert "agreed" in refused(room, "calibrate/bed-motion", camera=header()["camera"])
    show(room, bed_moved_by(np.array([0.0, -60.0, 0.0])))  # where a bed slinger's bed is when Y has gone from 20 to 80
    found = room.moop(
        "POST", "calibrate/bed-motion", json={"camera": header()["camera"], "confirmed": True}, timeout_s=90
    )  # fmt: skip
    assert found["bed_motion"] == "y" and found["bed_reference_mm"] == {"x": 10, "y": 20, "z": 10}
    assert room.moop("GET", "calibrate/bed-motion")["from_mm"] == {"x": 10, "y": 20, "z": 10}, "moved back"
