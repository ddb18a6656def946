"""moop calibrate and moop markers, as they are called."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

from octoprint_moop.cli import main
from octoprint_moop.core.calibration.calibrate import Lens
from octoprint_moop.core.calibration.plate import PlateSettings, place_markers
from octoprint_moop.core.camera import Camera
from octoprint_moop.core.header import Header, Printer
from tests.drawn import draw_plate, volume_error_px
from tests.made import camera_at

PRINTER = Printer(200, 200, 200)
PLATE = place_markers(PRINTER, PlateSettings())
CAMERA = camera_at((100, -130, 190), (100, 90, 0), "5 coefficients", focal_px=560)


def run(*arguments):
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


@pytest.fixture()
def folder(tmp_path):
    image = draw_plate(np.random.default_rng(3), CAMERA, PLATE, PRINTER, 330.0)
    cv2.imwrite(str(tmp_path / "plate.png"), image)
    (tmp_path / "markers.json").write_text(json.dumps(PLATE.to_json()))
    (tmp_path / "lens.json").write_text(json.dumps(Lens.of(CAMERA).to_json()))
    return tmp_path


def test_lens_and_then_pose_from_the_rendered_pictures(shared, tmp_path):
    case = shared / "cases" / "dtu-paper"
    boards = sorted((case / "calib").glob("checkerboard_*.jpg"))
    lens_file, camera_file = tmp_path / "lens.json", tmp_path / "camera.json"
    answer = run("calibrate", "lens", *boards, "--board", "9x6", "--square-mm", 15, "--json", "-o", lens_file)
    assert answer.exit_code == 0, answer.output
    lens = json.loads(answer.stdout)
    assert {"image_size_px", "K", "distortion", "rms_px", "images_used", "rejected"} <= set(lens)
    assert lens["images_used"] == 12
    header = Header.from_json(json.loads((case / "recording.json").read_text()))
    hue = ",".join(f"{value:g}" for value in header.material.to_json()["hue_deg"])
    answer = run("calibrate", "pose", case / "calib" / "markers.jpg", "--lens", lens_file, "--markers",
                 case / "calib" / "markers.json", "--hue", hue, "--json", "-o", camera_file)  # fmt: skip
    assert answer.exit_code == 0, answer.output
    pose = json.loads(answer.stdout)
    assert json.loads(camera_file.read_text()) == pose
    assert {"rvec", "tvec_mm", "rms_px", "markers_px"} <= set(pose)
    assert volume_error_px(Camera.from_json(pose), header.camera()).max() < 1.0


def test_the_pose_is_told_to_people_too(folder):
    answer = run("calibrate", "pose", folder / "plate.png", "--lens", folder / "lens.json", "--markers",
                 folder / "markers.json")  # fmt: skip
    assert answer.exit_code == 0, answer.output
    assert "4 of 4 markers" in answer.output


def test_clicked_points_give_a_pose(folder):
    corners = np.array([[0, 0, 0], [200, 0, 0], [200, 200, 0], [0, 200, 0]], float)
    points = [{"mm": mm.tolist(), "px": px.tolist()} for mm, px in zip(corners, CAMERA.project(corners))]
    (folder / "points.json").write_text(json.dumps(points))
    answer = run("calibrate", "points", folder / "plate.png", folder / "points.json", "--lens", folder / "lens.json",
                 "--json")  # fmt: skip
    assert answer.exit_code == 0, answer.output
    assert volume_error_px(Camera.from_json(json.loads(answer.stdout)), CAMERA, (200, 200)).max() < 0.1


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["lens", "plate.png", "--square-mm", "15"], "None of the 1 pictures"),
        (["lens", "nowhere.png", "--square-mm", "15"], "nowhere.png"),
        (["lens", "markers.json", "--square-mm", "15"], "not a picture"),
        (["lens", "plate.png", "--square-mm", "15", "--board", "9"], "not of the kind 9x6"),
        (["lens", "plate.png", "--square-mm", "nan"], "cannot be used"),
        (["pose", "plate.png", "--lens", "markers.json", "--markers", "markers.json"], "image_size_px"),
        (["pose", "plate.png", "--lens", "plate.png", "--markers", "markers.json"], "not JSON"),
        (["pose", "plate.png", "--lens", "lens.json", "--markers", "lens.json"], "outer_diameter_mm"),
        (["pose", "plate.png", "--lens", "lens.json", "--markers", "markers.json", "--hue", "red"], "18,47"),
        (["pose", "plate.png", "--lens", "lens.json", "--markers", "markers.json", "--hue", "100,120"], "Only 0 of 4"),
        (["points", "plate.png", "lens.json"], "must be a list"),
    ],
)
def test_what_cannot_be_used_is_one_line_and_status_2(folder, monkeypatch, arguments, said):
    monkeypatch.chdir(folder)
    answer = run("calibrate", *arguments)
    assert answer.exit_code == 2
    assert said in answer.stderr
    assert len(answer.stderr.strip().splitlines()) == 1
    assert "Traceback" not in answer.output


def test_a_marker_plate_and_a_board_are_written(tmp_path):
    answer = run("markers", "--bed-mm", "220x220", "--board", "9x6", "-o", tmp_path / "out", "--json")
    assert answer.exit_code == 0, answer.output
    files = json.loads(answer.stdout)["files"]
    assert [file.rsplit("/", 1)[-1] for file in files] == ["markers.gcode", "markers.json", "checkerboard.svg"]
    plate = json.loads((tmp_path / "out" / "markers.json").read_text())
    assert {"outer_diameter_mm", "height_mm", "centres_mm"} <= set(plate)


@pytest.mark.parametrize("arguments", [[], ["--bed-mm", "big"], ["--bed-mm", "50x50"], ["--profile", "nowhere.json"]])
def test_a_plate_that_cannot_be_made_is_one_line_and_status_2(arguments, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    answer = run("markers", *arguments)
    assert answer.exit_code == 2
    assert len(answer.stderr.strip().splitlines()) == 1
