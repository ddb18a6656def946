"""The 3D model of the selected job, attached, placed and taken off in the tab, against a real server."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import trimesh

from octoprint_moop.demo.server import DemoServer

from ..host.room import box_gcode
from .stage import show_tab

LAYERS = 8


@pytest.fixture
def job_page(page: Any, server: DemoServer, tmp_path: Path) -> Iterator[Any]:
    """The tab of somebody who has selected a file, and not attached anything to it."""
    page.expected_errors.append("/frame")  # there is no webcam
    job = tmp_path / "boxed.gcode"
    job.write_text(box_gcode(layers=LAYERS))
    server.upload(job, print=False)
    show_tab(page)
    page.wait_for_selector("[data-test-id=moop-mesh-summary]:has-text('none')")
    yield page
    server.request("DELETE", "/plugin/moop/mesh")
    server.request("DELETE", "/api/job")
    server.request("DELETE", "/api/files/local/boxed.gcode")


def model(path: Path) -> Path:
    """The box that the job draws."""
    path.write_bytes(trimesh.creation.box(extents=(30.8, 30.0, 0.3 * LAYERS)).export(file_type="stl"))
    return path


def attached(server: DemoServer) -> Any:
    return server.api("GET", "/plugin/moop/mesh")["mesh"]


def test_a_model_is_attached_placed_left_unused_and_taken_off(
    job_page: Any, server: DemoServer, tmp_path: Path
) -> None:
    page = job_page
    page.evaluate("document.getElementById('moop_mesh').open = true")
    page.set_input_files("[data-test-id=moop-mesh-file]", model(tmp_path / "<b>box.stl"))
    page.wait_for_selector(
        "[data-test-id=moop-mesh-summary]:has-text('Compared with the 3D model <b>box.stl')", timeout=60_000
    )
    assert "30.8 x 30 x 2.4 mm, 12 triangles" in page.inner_text("[data-test-id=moop-mesh-details]")
    page.fill("[data-test-id=moop-mesh-x_mm]", "100")
    page.fill("[data-test-id=moop-mesh-y_mm]", "99,6")
    page.click("[data-test-id=moop-mesh-place]")
    page.wait_for_function("!ko.dataFor(document.getElementById('moop_watch')).mesh.busy()", timeout=60_000)
    assert (attached(server)["x_mm"], attached(server)["y_mm"]) == (100, 99.6)
    page.uncheck("[data-test-id=moop-mesh-use]")
    page.wait_for_selector("[data-test-id=moop-mesh-summary]:has-text('not used')", timeout=60_000)
    assert attached(server)["use"] is False
    page.click("[data-test-id=moop-mesh-remove]")
    page.wait_for_selector("[data-test-id=moop-mesh-summary]:has-text('none')")
    assert attached(server) is None


def test_what_is_no_model_is_refused_in_the_servers_words(job_page: Any, server: DemoServer, tmp_path: Path) -> None:
    page = job_page
    page.expected_errors.append("400")
    page.evaluate("document.getElementById('moop_mesh').open = true")
    (tmp_path / "nothing.stl").write_text("solid nothing\nendsolid\n")
    page.set_input_files("[data-test-id=moop-mesh-file]", tmp_path / "nothing.stl")
    page.wait_for_selector("[data-test-id=moop-mesh-trouble]:has-text('surface')", timeout=60_000)
    assert attached(server) is None
