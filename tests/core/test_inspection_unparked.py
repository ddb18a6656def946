"""Frames taken as the head stands: head and gantry in the picture, the bed wherever the last bead left it.

Painted by the demo's simulated webcam, whose painter shares nothing with the renderer under test.
"""

from __future__ import annotations

import gzip
from dataclasses import replace

import numpy as np
import pytest

from octoprint_moop.core.camera import BedMotion
from octoprint_moop.core.checks import Check
from octoprint_moop.core.decision.telling import HEAD_HIDES
from octoprint_moop.core.expected.hardware import hidden_by
from octoprint_moop.core.expected.raster import CvRenderer
from octoprint_moop.core.gcode.read import read_gcode
from octoprint_moop.core.head import HeadModel
from octoprint_moop.core.header import Header, Moment, Printer
from octoprint_moop.core.inspection import Inspector
from octoprint_moop.demo.faults import Fault
from octoprint_moop.demo.run import JOB, MATERIAL, demo_camera
from octoprint_moop.demo.simulate import ORANGE_BGR, Scene

BEDS = {"y": BedMotion("y", (0, 200, 0)), "z": BedMotion("z"), "fixed": BedMotion("fixed")}


@pytest.fixture(scope="module")
def toolpath(tmp_path_factory):
    path = tmp_path_factory.mktemp("job") / "job.gcode"
    path.write_bytes(gzip.decompress(JOB.read_bytes()))
    return read_gcode(path)


def dark(layer: int) -> tuple[float, float, float]:
    return (20.0, 30.0, 60.0 + 120 * (layer % 2))


def like_filament(_layer: int) -> tuple[float, float, float]:
    return ORANGE_BGR


def checks(
    toolpath, bed: BedMotion, layers: int, faults: tuple[Fault, ...] = (), tall: bool = False, over=None
) -> list[Check]:
    """The checks after each layer, with the nozzle over the last bead.

    tall : they are made from twice as far, under a head that reaches above the picture
    over : by layer, the colour of a head that fills all the room that it may take up
    """
    camera = demo_camera().resized((480, 360))
    if tall:
        camera = replace(camera, K=camera.K * [[0.5, 1, 1], [1, 0.5, 1], [1, 1, 1]])
    scene = Scene(toolpath, camera, bed, seed=5, faults=faults)
    header = Header(Printer(250, 210, 210, bed=bed), ((None, camera),), MATERIAL)
    inspector = Inspector(header, toolpath, CvRenderer(), reference_bgr=scene.frame(0, (0, 200, 0)))
    found = []
    for layer in range(layers):
        file_pos = int(toolpath.layer_end_pos[layer])
        position = tuple(float(value) for value in toolpath.beads_mm[toolpath.laid_at(file_pos) - 1][3:6])
        frame = scene.frame(file_pos, position)
        if over:
            head = hidden_by(HeadModel.common(250), position, bed, camera)
            head[head.shape[0] // 3 if tall else head.shape[0] :] = 0
            frame = np.where(head[..., None] > 0, np.array(over(layer), np.uint8), frame)
        found.append(inspector.check(frame, Moment(str(layer), file_pos, layer, position, parked=False)))
    return found


@pytest.mark.parametrize("kind", BEDS)
def test_a_good_print_that_is_seen_past_the_head_is_judged_and_left_alone(toolpath, kind):
    found = checks(toolpath, BEDS[kind], 12)
    assert {check.reason for check in found} <= {HEAD_HIDES, ""}
    assert [check.verdict for check in found[:8]] == ["ok"] * 8


def test_a_head_that_reaches_far_above_the_print_is_nobodys_hand(toolpath):
    found = checks(toolpath, BEDS["fixed"], 6, tall=True, over=dark)
    assert {check.reason for check in found} <= {HEAD_HIDES, ""}


def test_a_head_of_the_filaments_colour_is_no_matter_in_its_place(toolpath):
    found = checks(toolpath, BEDS["fixed"], 3, over=like_filament)
    assert {check.verdict for check in found} == {"unusable"}


@pytest.mark.parametrize("kind", BEDS)
def test_strands_beside_the_print_are_seen_past_the_head(toolpath, kind):
    found = checks(toolpath, BEDS[kind], 13, (Fault("spaghetti", layer=9),))
    assert {check.verdict for check in found[:9]} == {"ok"}
    assert "failed" in [check.verdict for check in found[9:]]


def test_a_print_that_comes_off_is_seen_past_the_head(toolpath):
    found = checks(toolpath, BEDS["y"], 12, (Fault("detachment", layer=9),))
    assert {check.verdict for check in found[4:9]} == {"ok"}
    assert "failed" in [check.verdict for check in found[9:]]
