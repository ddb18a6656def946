"""`moop mask` writes the expected mask of one moment, from the beads or from a mesh."""

from __future__ import annotations

import cv2
import pytest
from click.testing import CliRunner

from octoprint_moop.cli.mask import mask


@pytest.fixture
def case(shared):
    return shared / "cases" / "cube-clean"


def written(case, out, *options):
    done = CliRunner().invoke(mask, [str(case), *options, "-o", str(out)], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return cv2.imread(str(out), cv2.IMREAD_UNCHANGED)


def iou(one, other):
    return ((one > 0) & (other > 0)).sum() / ((one > 0) | (other > 0)).sum()


def test_the_mask_of_a_frame_is_in_its_own_pixels_or_undistorted(case, tmp_path):
    truth = cv2.imread(str(case / "frames/000030.mask.png"), cv2.IMREAD_UNCHANGED)
    distorted = written(case, tmp_path / "d.png", "--frame", "frames/000030.jpg", "--distorted")
    assert distorted.dtype == "uint8" and set(distorted.ravel()) == {0, 255}
    assert iou(distorted, truth) > 0.985
    plain = written(case, tmp_path / "u.png", "--frame", "frames/000030.jpg")
    assert iou(plain, distorted) < iou(distorted, truth)


def test_the_complete_print_is_what_the_last_position_shows(case, tmp_path):
    complete = written(case, tmp_path / "c.png", "--complete")
    last = written(case, tmp_path / "l.png", "--file-pos", str(10**9))
    assert (complete == last).all()
    assert not written(case, tmp_path / "n.png", "--file-pos", "0").any()


def test_the_mesh_gives_the_same_picture_as_the_beads(case, tmp_path):
    beads = written(case, tmp_path / "b.png", "--frame", "frames/000040.jpg", "--distorted")
    options = ("--frame", "frames/000040.jpg", "--distorted", "--mesh", str(case / "model.stl"))
    assert iou(written(case, tmp_path / "m.png", *options), beads) > 0.97
