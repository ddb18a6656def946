"""What tests of masks share: both ways of drawing."""

from __future__ import annotations

import pytest

from octoprint_moop.core.expected.raster import CvRenderer


@pytest.fixture(scope="module", params=["OpenCV", "OpenGL"])
def renderer(request):
    if request.param == "OpenCV":
        yield CvRenderer()
        return
    gl = pytest.importorskip("octoprint_moop.machine.gl")
    with gl.GlRenderer() as made:
        yield made
