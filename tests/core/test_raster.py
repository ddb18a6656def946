"""Both renderers draw the same beads; what is drawn is where cv2.projectPoints says."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from octoprint_moop.core.raster import CvRenderer
from tests.made import LENSES, camera_at, toolpath_of, vase


@pytest.fixture(scope="module", params=["OpenCV", "OpenGL"])
def renderer(request):
    if request.param == "OpenCV":
        yield CvRenderer()
        return
    gl = pytest.importorskip("octoprint_moop.machine.gl")
    with gl.GlRenderer() as made:
        yield made


@pytest.mark.parametrize("lens", LENSES)
def test_a_small_bead_is_drawn_where_the_camera_model_projects_it(renderer, lens):
    size_px, finer = (640, 480), 8
    coarse = camera_at((180, -160, 150), (100, 100, 10), lens, size_px)
    fine = coarse.resized((size_px[0] * finer, size_px[1] * finer))
    rng = np.random.default_rng(7)
    pixels = rng.uniform((4, 4), (size_px[0] - 4, size_px[1] - 4), (60, 2))
    rays = _rays(coarse, pixels)
    points = coarse.centre_mm + rays * rng.uniform(200, 500, (60, 1))
    beads = [[*p, *p, 1.0, 1.0] for p in points + [0, 0, 0.5]]
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
