"""The picture of the empty bed, taken just before the first bead: where the machine stood, and what the head hid."""

from __future__ import annotations

import gzip
import json
from dataclasses import replace

import pytest

from octoprint_moop.core.camera import BedMotion
from octoprint_moop.core.errors import FrameError, RecordingError
from octoprint_moop.core.expected.raster import CvRenderer
from octoprint_moop.core.gcode.read import read_gcode
from octoprint_moop.core.header import Header, Moment, Printer
from octoprint_moop.core.inspection import Inspector
from octoprint_moop.demo.run import JOB, MATERIAL, demo_camera
from octoprint_moop.demo.simulate import Scene

BED = BedMotion("y", (0, 200, 0))
AWAY, PARKED, OVER = (5.0, 60.0, 5.0), (5.0, 200.0, 5.0), (125.0, 105.0, 1.0)


@pytest.fixture(scope="module")
def toolpath(tmp_path_factory):
    path = tmp_path_factory.mktemp("job") / "job.gcode"
    path.write_bytes(gzip.decompress(JOB.read_bytes()))
    return read_gcode(path)


@pytest.fixture(scope="module")
def scene(toolpath):
    return Scene(toolpath, demo_camera().resized((480, 360)), BED, seed=5)


@pytest.fixture
def header():
    return Header(Printer(250, 210, 210, bed=BED), ((None, demo_camera().resized((480, 360))),), MATERIAL)


def errors(inspector: Inspector, scene: Scene, layers: int = 4) -> list[float]:
    """E at each layer, with the head parked."""
    found = []
    for layer in range(layers):
        file_pos = int(scene.toolpath.layer_end_pos[layer])
        check = inspector.check(scene.frame(file_pos, PARKED), Moment(str(layer), file_pos, layer, PARKED))
        assert check.verdict == "ok"
        found.append(check.comparison.error_ratio)
    return found


def test_a_reference_taken_before_the_first_bead_serves_as_one_that_was_there_from_the_start(toolpath, scene, header):
    frame = scene.frame(0, AWAY)
    live = Inspector(header, toolpath, CvRenderer())
    assert live.take_reference(frame, Moment("reference.jpg", 0, 0, AWAY, parked=True))
    written = Header.from_json(json.loads(json.dumps(replace(header, reference_mm=AWAY).to_json())))
    replayed = Inspector(written, toolpath, CvRenderer(), reference_bgr=frame)
    assert errors(live, scene) == errors(replayed, scene)


def test_where_the_bed_stood_counts(toolpath, scene, header):
    """Taken for one at the bed's reference position, the picture shows a bed that is 140 mm away."""
    file_pos = int(toolpath.layer_end_pos[0])
    frame, here = scene.frame(0, AWAY), scene.frame(file_pos, PARKED)
    verdicts = []
    for reference_mm in (AWAY, None):
        inspector = Inspector(replace(header, reference_mm=reference_mm), toolpath, CvRenderer(), reference_bgr=frame)
        verdicts.append(inspector.check(here, Moment("0", file_pos, 0, PARKED)).verdict)
    assert verdicts == ["ok", "unusable"]


def test_a_picture_in_which_the_head_hides_the_prints_place_is_not_taken(toolpath, scene, header):
    inspector = Inspector(header, toolpath, CvRenderer())
    assert not inspector.take_reference(scene.frame(0, OVER), Moment("reference.jpg", 0, 0, OVER, parked=False))
    assert inspector._watched[None].view._bare_bgr is None


def test_a_black_picture_is_no_reference(toolpath, scene, header):
    with pytest.raises(FrameError, match="black"):
        Inspector(header, toolpath, CvRenderer()).take_reference(
            scene.frame(0, AWAY) // 40, Moment("reference.jpg", 0, 0, AWAY)
        )


def test_after_the_first_check_it_is_too_late(toolpath, scene, header):
    inspector = Inspector(header, toolpath, CvRenderer())
    errors(inspector, scene, 1)
    assert not inspector.take_reference(scene.frame(0, AWAY), Moment("reference.jpg", 0, 0, AWAY))


@pytest.mark.parametrize("reference", [{"position_mm": {"x": 1}}, {"position_mm": 3}, 7])
def test_a_reference_position_that_makes_no_sense_is_named(header, reference):
    with pytest.raises(RecordingError, match="position_mm"):
        Header.from_json({**header.to_json(), "reference": reference})
