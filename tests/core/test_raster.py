"""Both renderers draw the same beads; what is drawn is where cv2.projectPoints says."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from octoprint_moop.core.expected.beads import drawn_beads
from octoprint_moop.core.expected.raster import CvRenderer
from tests.made import LENSES, camera_at, toolpath_of, vase


@pytest.mark.parametrize("lens", LENSES)
def test_a_small_bead_is_drawn_where_the_camera_model_projects_it(renderer, lens):
    size_px, finer = (640, 480), 8
    coarse = camera_at((180, -160, 150), (100, 100, 10), lens, size_px)
    fine = coarse.resized((size_px[0] * finer, size_px[1] * finer))
    rng = np.random.default_rng(7)
    pixels = rng.uniform((4, 4), (size_px[0] - 4, size_px[1] - 4), (60, 2))
    rays = _rays(coarse, pixels)
    points = coarse.centre_mm + rays * rng.uniform(200, 500, (60, 1))
    beads = [[*p, *p, 1.0, 1.0] for p in points + np.array([0, 0, 0.5])]
    births = renderer.birth_map(toolpath_of(beads), fine, np.zeros(3))
    rows, columns = np.nonzero(births)
    bead = births[rows, columns]
    off = []
    for i, seen in enumerate(coarse.project(points)):
        y, x = rows[bead == i + 1], columns[bead == i + 1]
        assert len(x) > 20
        off.append(((x.mean() + 0.5) / finer - 0.5 - seen[0], (y.mean() + 0.5) / finer - 0.5 - seen[1]))
    assert np.abs(off).max() < 0.1
    assert np.abs(np.mean(off, axis=0)).max() < 0.02


def _rays(camera, pixels):
    """(N, 3) unit vectors in the room roughly towards `pixels`."""
    points = pixels.reshape(-1, 1, 2)
    if camera.model == "fisheye":
        plane = cv2.fisheye.undistortPoints(points, camera.K, camera.distortion)
    else:
        plane = cv2.undistortPoints(points, camera.K, camera.distortion)
    rays = np.hstack([plane.reshape(-1, 2), np.ones((len(pixels), 1))])
    rays = rays @ camera.camera_from_room[:3, :3]
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)


@pytest.mark.parametrize("lens", LENSES)
def test_both_renderers_draw_the_same_vase(lens):
    gl = pytest.importorskip("octoprint_moop.machine.gl")
    camera = camera_at((190, -60, 90), (100, 100, 5), lens)
    print_ = vase()
    with gl.GlRenderer() as drawn_by_gl:
        by_gl = drawn_by_gl.birth_map(print_, camera, np.zeros(3))
    by_cv = CvRenderer().birth_map(print_, camera, np.zeros(3))
    differ = (by_gl > 0) != (by_cv > 0)
    assert (by_gl > 0).sum() > 1500
    assert differ.mean() < 1e-4
    assert not cv2.morphologyEx(differ.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3))).any()
    assert (by_gl != by_cv).sum() < 0.005 * (by_gl > 0).sum()


@pytest.mark.parametrize("lens", ["5 coefficients", "8 coefficients", "fisheye"])
def test_a_long_bead_is_bent_as_the_lens_bends_it(renderer, lens):
    camera = camera_at((100, -60, 120), (100, 100, 0), lens, (1280, 960), 1000.0)
    ends = np.array([[10.0, 60, 1], [190, 75, 1]])
    long = renderer.birth_map(toolpath_of([[*ends[0], *ends[1], 1, 1]]), camera, np.zeros(3)) > 0
    share = np.linspace(0, 1, 361)[:, None]
    places = ends[0] * (1 - share) + ends[1] * share
    short = [[*a, *b, 1, 1] for a, b in zip(places[:-1], places[1:])]
    wanted = CvRenderer().birth_map(toolpath_of(short), camera, np.zeros(3)) > 0
    chord = CvRenderer().birth_map(toolpath_of([[*ends[0], *ends[1], 1, 1]]), camera.undistorted(), np.zeros(3)) > 0
    assert (long ^ wanted).sum() < 0.02 * wanted.sum()
    assert (chord ^ wanted).sum() > 0.2 * wanted.sum()
    middle = camera.project(places - [0, 0, 0.5]).round().astype(int)
    middle = middle[((middle >= 0) & (middle < [1280, 960])).all(axis=1)]
    assert len(middle) > 200
    assert long[middle[:, 1], middle[:, 0]].all()


def test_only_the_beads_asked_for_are_drawn_and_keep_their_numbers(renderer):
    camera = camera_at((190, -60, 90), (100, 100, 5), "5 coefficients")
    chosen = np.arange(60, 240, 3)
    births = renderer.birth_map(vase(), camera, np.zeros(3), chosen)
    drawn = np.unique(births[births > 0]) - 1
    assert len(drawn) > 20 and np.isin(drawn, chosen).all()
    assert not renderer.birth_map(vase(), camera, np.zeros(3), chosen[:0]).any()


def test_what_lies_behind_the_camera_or_beyond_its_lens_is_not_drawn(renderer):
    folding = camera_at((100, 0, 60), (100, 100, 60), focal_px=500)
    folding = type(folding)(folding.image_size_px, folding.K, [-0.4, 0, 0, 0, 0], folding.rvec, folding.tvec_mm)
    behind = [[60, -80, 60, 140, -80, 60, 5, 5]]
    far_aside = [[x, 30, z, x + 1, 30, z, 1, 1] for x in range(48, 58) for z in range(55, 65, 2)]
    inside = [[100, 100, 60, 101, 100, 60, 5, 5]]
    births = renderer.birth_map(toolpath_of(behind + far_aside + inside), folding, np.zeros(3))
    assert set(np.unique(births)) == {0, 2 + len(far_aside)}


def test_long_beads_are_cut_in_file_order_into_chunks_that_stay_small():
    rng = np.random.default_rng(5)
    beads = np.hstack([rng.uniform(0, 200, (500, 6)), np.ones((500, 2))]).astype(np.float32)
    chunks = list(drawn_beads(beads, np.arange(0, 500, 2), 7.0, 64))
    assert max(map(len, chunks)) <= 64
    drawn = np.concatenate(chunks)
    assert (np.diff(drawn["birth"].astype(int)) >= 0).all()
    assert np.linalg.norm(drawn["end"] - drawn["start"], axis=1).max() <= 7.001
    for index in (0, 2, 498):
        parts = drawn[drawn["birth"] == index + 1]
        assert np.allclose(parts["start"][0], beads[index, :3]) and np.allclose(parts["end"][-1], beads[index, 3:6])
        assert np.allclose(parts["end"][:-1], parts["start"][1:], atol=1e-3)
    assert set(drawn["birth"]) == set(range(1, 501, 2))
