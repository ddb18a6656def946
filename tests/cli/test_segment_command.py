"""`moop segment IMAGE… --learn`: masks out, and sentences where something is wrong."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

from octoprint_moop.cli import main


@pytest.fixture
def pictures(tmp_path: Path) -> Path:
    """learn.jpg with learn.png, and later.jpg with its truth later.png: an orange block on a grey bed."""
    for name, height in (("learn", 40), ("later", 60)):
        frame = np.full((120, 160, 3), (60, 58, 62), np.uint8)
        mask = np.zeros((120, 160), np.uint8)
        mask[110 - height : 110, 60:110] = 255
        frame[mask > 0] = (40, 120, 235)
        cv2.imwrite(str(tmp_path / f"{name}.jpg"), frame)
        cv2.imwrite(str(tmp_path / f"{name}.png"), mask)
    return tmp_path


def run(*words: object):
    return CliRunner().invoke(main, ["segment", *map(str, words)])


def learned(folder: Path) -> str:
    return f"{folder / 'learn.jpg'}={folder / 'learn.png'}"


def test_each_image_gives_a_mask_of_its_own_name_and_size(pictures):
    result = run(pictures / "later.jpg", pictures / "learn.jpg", "--learn", learned(pictures), "-o", pictures / "out")
    assert result.exit_code == 0, result.stderr
    seen = cv2.imread(str(pictures / "out" / "later.png"), cv2.IMREAD_UNCHANGED)
    truth = cv2.imread(str(pictures / "later.png"), cv2.IMREAD_UNCHANGED)
    assert seen.shape == truth.shape and set(np.unique(seen)) == {0, 255}
    assert np.count_nonzero((seen > 0) != (truth > 0)) < 0.05 * np.count_nonzero(truth)
    assert (pictures / "out" / "learn.png").is_file()


def test_the_expected_masks_are_taken_in_order_and_do_not_win_over_the_picture(pictures):
    result = run(
        pictures / "later.jpg", "--learn", learned(pictures), "--expected", pictures / "learn.png",
        "--box", "40,20,130,118", "-o", pictures,
    )  # fmt: skip
    assert result.exit_code == 0, result.stderr
    seen = cv2.imread(str(pictures / "later.png"), cv2.IMREAD_UNCHANGED)
    assert seen[55:65, 65:105].all() and not seen[:45].any()


def test_the_expected_masks_may_follow_one_option(pictures):
    result = run(
        pictures / "later.jpg", pictures / "learn.jpg", "--learn", learned(pictures),
        "--expected", pictures / "later.png", pictures / "learn.png", "-o", pictures / "out",
    )  # fmt: skip
    assert result.exit_code == 0, result.stderr
    assert {path.name for path in (pictures / "out").iterdir()} == {"later.png", "learn.png"}


def test_a_few_points_do_instead_of_a_mask(pictures):
    points = ["--filament", "65,75", "--filament", "100,100", "--filament", "80,90"]
    beside = ["--background", "20,20", "--background", "140,80", "--background", "30,112"]
    result = run(pictures / "later.jpg", "--learn", pictures / "learn.jpg", *points, *beside, "-o", pictures / "out")
    assert result.exit_code == 0, result.stderr
    seen = cv2.imread(str(pictures / "out" / "later.png"), cv2.IMREAD_UNCHANGED)
    truth = cv2.imread(str(pictures / "later.png"), cv2.IMREAD_UNCHANGED)
    assert np.count_nonzero((seen > 0) != (truth > 0)) < 0.05 * np.count_nonzero(truth)


def test_pictures_without_colour_are_segmented(pictures):
    for name in ("learn", "later"):
        grey = cv2.imread(str(pictures / f"{name}.jpg"), cv2.IMREAD_GRAYSCALE)
        cv2.imwrite(str(pictures / f"{name}.jpg"), grey)
    result = run(pictures / "later.jpg", "--learn", learned(pictures), "-o", pictures / "out")
    assert result.exit_code == 0, result.stderr
    seen = cv2.imread(str(pictures / "out" / "later.png"), cv2.IMREAD_UNCHANGED)
    truth = cv2.imread(str(pictures / "later.png"), cv2.IMREAD_UNCHANGED)
    assert np.count_nonzero((seen > 0) != (truth > 0)) < 0.05 * np.count_nonzero(truth)


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--learn", "learn.jpg"], "FRAME.jpg=MASK.png"),
        ([], "--learn"),
        (["--learn", "learn.jpg=learn.png", "--box", "1,2,3"], "X0,Y0,X1,Y1"),
        (["--learn", "learn.jpg=learn.png", "--box", "900,900,950,950"], "outside"),
        (["--learn", "learn.jpg=learn.png", "--expected", "learn.png", "--expected", "learn.png"], "1 images need"),
        (["--learn", "nothing.jpg=learn.png"], "nothing.jpg"),
        (["--learn", "learn.jpg", "--filament", "70,80"], "background"),
        (["--learn", "learn.jpg", "--filament", "70,80", "--background", "900,3"], "outside"),
        (["--learn", "learn.jpg", "--filament", "70", "--background", "9,3"], "X,Y"),
    ],
)
def test_what_is_wrong_is_said_in_a_sentence_and_the_status_is_2(pictures, monkeypatch, words, sentence):
    monkeypatch.chdir(pictures)
    result = run("later.jpg", *words, "-o", "out")
    assert result.exit_code == 2 and sentence in result.stderr and "Traceback" not in result.output


def test_a_picture_that_is_none_is_named(pictures):
    (pictures / "broken.jpg").write_bytes(b"not a picture")
    result = run(pictures / "broken.jpg", "--learn", learned(pictures), "-o", pictures / "out")
    assert result.exit_code == 2 and "broken.jpg" in result.stderr


def test_masks_that_would_replace_each_other_are_refused(pictures):
    other = pictures / "sub"
    other.mkdir()
    (other / "later.jpg").write_bytes((pictures / "later.jpg").read_bytes())
    result = run(pictures / "later.jpg", other / "later.jpg", "--learn", learned(pictures), "-o", pictures / "out")
    assert result.exit_code == 2 and "one name" in result.stderr


def test_the_expected_mask_must_fit_its_image(pictures):
    cv2.imwrite(str(pictures / "small.png"), np.zeros((60, 80), np.uint8))
    result = run(
        pictures / "later.jpg", "--learn", learned(pictures), "--expected", pictures / "small.png", "-o", pictures
    )  # fmt: skip
    assert result.exit_code == 2 and "80x60" in result.stderr


def test_a_recordings_frame_gives_what_the_pipeline_saw_in_it(shared, tmp_path):
    case = shared / "cases" / "cube-clean"
    result = run(case, "--frame", "frames/000012.jpg", "--distorted", "-o", tmp_path / "seen.png")
    assert result.exit_code == 0, result.stderr
    seen = cv2.imread(str(tmp_path / "seen.png"), cv2.IMREAD_UNCHANGED)
    truth = cv2.imread(str(case / "frames" / "000012.mask.png"), cv2.IMREAD_UNCHANGED)
    both, either = np.count_nonzero((seen > 0) & (truth > 0)), np.count_nonzero((seen > 0) | (truth > 0))
    assert both / either > 0.93


def test_a_frame_that_the_recording_lacks_is_named(shared, tmp_path):
    result = run(shared / "cases" / "cube-clean", "--frame", "frames/999999.jpg", "-o", tmp_path / "seen.png")
    assert result.exit_code == 2 and "999999" in result.stderr


@pytest.mark.parametrize("words", [["--frame", "a.jpg", "--learn", "b=c"], ["--frame", "a.jpg", "--box", "1,2,3,4"]])
def test_the_two_forms_do_not_mix(pictures, words):
    assert run(pictures / "later.jpg", *words, "-o", pictures / "out").exit_code == 2
