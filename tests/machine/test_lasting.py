import numpy as np
import pytest

from octoprint_moop.core.errors import RenderError
from octoprint_moop.core.expected.raster import CvRenderer
from octoprint_moop.machine.lasting import LastingRenderer
from octoprint_moop.machine.renderers import open_renderer
from tests.made import camera_at, vase

CAMERA = camera_at((100, -60, 90), (100, 100, 5))


class Failing:
    """Draws well a few times, and then no more."""

    name = "OpenGL on a chip"

    def __init__(self, error: Exception, times: int = 1) -> None:
        self.error, self.times = error, times

    def birth_map(self, *asked, **more):
        self.times -= 1
        if self.times < 0:
            raise self.error
        return CvRenderer().birth_map(*asked, **more)


@pytest.mark.parametrize("error", [RenderError("context lost"), RuntimeError("GL_OUT_OF_MEMORY"), OSError("EGL")])
def test_what_opengl_cannot_draw_any_more_is_drawn_by_opencv(error):
    renderer = LastingRenderer(Failing(error))
    before = renderer.birth_map(vase(), CAMERA, np.zeros(3))
    assert renderer.name == "OpenGL on a chip"
    after = renderer.birth_map(vase(), CAMERA, np.zeros(3))
    assert renderer.name == "OpenCV" and np.array_equal(before, after) and after.any()


def test_memory_that_runs_out_is_not_the_renderers_fault():
    with pytest.raises(MemoryError):
        LastingRenderer(Failing(MemoryError(), times=0)).birth_map(vase(), CAMERA, np.zeros(3))


def test_a_context_that_is_gone_is_noticed_and_costs_no_mask():
    with open_renderer() as first:
        if isinstance(first, CvRenderer):
            pytest.skip("there is no OpenGL here")
        renderer = LastingRenderer(first)
        before = renderer.birth_map(vase(), CAMERA, np.zeros(3)) > 0
        first._context.release()
        after = renderer.birth_map(vase(turns=13), CAMERA, np.zeros(3)) > 0
        assert renderer.name == "OpenCV"
        assert (before & ~after).sum() < 0.01 * before.sum()
        first.release = lambda: None
