"""Rings that are printed with the part tell each print's camera anew."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from octoprint_moop.core.calibration.plate import PlateSettings, plate_gcode
from octoprint_moop.core.calibration.printed import markers_in
from octoprint_moop.core.camera import BedMotion
from octoprint_moop.core.expected.raster import CvRenderer
from octoprint_moop.core.gcode.read import read_gcode_bytes
from octoprint_moop.core.header import Header, Moment, Printer
from octoprint_moop.core.inspection import Inspector
from octoprint_moop.core.segmentation.segment import HsvThresholds
from octoprint_moop.demo.faults import Fault
from octoprint_moop.demo.simulate import Scene
from tests.made import camera_at, toolpath_of

CENTRES = [[61.5, 68.0], [136.5, 62.0], [141.0, 119.0], [68.0, 135.0]]
OUTER_MM, HOLE_MM, LAYER_MM, WIDTH_MM = 16.0, 6.0, 0.3, 0.5
RING_LAYERS, LAYERS = 4, 24
BED = BedMotion("y", (0.0, 200.0, 0.0))
PRINTER = Printer(200, 200, 200, bed=BED)
MATERIAL = HsvThresholds(8, 40, 0.45, 0.25)


def circle(centre, radius_mm, z_mm, sides=64):
    turn = np.linspace(0, 2 * np.pi, sides + 1)
    x, y = np.array(centre)[:, None] + radius_mm * np.stack([np.cos(turn), np.sin(turn)])
    return [[x[n], y[n], z_mm, x[n + 1], y[n + 1], z_mm, WIDTH_MM, LAYER_MM] for n in range(sides)]


def job(centres=CENTRES, in_hole=False, tower=False):
    """A box of 30 mm with four rings beside it."""
    beads, layers = [], []
    for layer in range(LAYERS):
        z_mm = LAYER_MM * (layer + 1)
        new = [[85, y, z_mm, 115, y, z_mm, WIDTH_MM, LAYER_MM] for y in np.arange(85, 115.1, 0.45)]
        for centre in centres if layer < RING_LAYERS or tower else ():
            for radius_mm in np.arange(HOLE_MM / 2 + WIDTH_MM / 2, OUTER_MM / 2 - WIDTH_MM / 2 + 0.01, 0.45):
                new += circle(centre, radius_mm, z_mm)
            new += circle(centre, OUTER_MM / 2 - WIDTH_MM / 2, z_mm)
            if in_hole:  # a disc
                new.append([centre[0] - 1, centre[1], z_mm, centre[0] + 1, centre[1], z_mm, WIDTH_MM, LAYER_MM])
        beads += new
        layers += [layer] * len(new)
    return toolpath_of(beads, layers)


JOB = job()
TRUE = camera_at((100, -110, 150), (100, 100, 0), "5 coefficients", focal_px=620)


def watch(thought, faults=(), layers=8):
    """(checks, inspector, moments) of a print that the true camera sees."""
    scene = Scene(JOB, TRUE, BED, faults=faults, bed_mm=(200, 200), seed=4)
    header = Header(PRINTER, ((None, thought),), MATERIAL)
    inspector = Inspector(header, JOB, CvRenderer(), reference_bgr=scene.frame(0, (0.0, 200.0, 0.0)))
    checks, moments = [], []
    for layer in range(layers):
        position = (0.0, 200.0, LAYER_MM * (layer + 1) + 0.4)
        moment = Moment(f"{layer}", int(JOB.layer_end_pos[layer]), layer, position)
        checks.append(inspector.check(scene.frame(moment.file_pos, position), moment))
        moments.append(moment)
    return checks, inspector, moments


def apart_px(camera):
    points_mm = JOB.beads_mm[::40, :3].astype(float)
    return np.linalg.norm(camera.project(points_mm) - TRUE.project(points_mm), axis=1).max()


def test_rings_are_found_in_the_job_itself():
    plate = markers_in(JOB)
    assert np.allclose(sorted(plate.centres_mm.tolist()), sorted(CENTRES), atol=0.01)
    assert plate.outer_diameter_mm == pytest.approx(OUTER_MM, abs=0.05)
    assert plate.hole_diameter_mm == pytest.approx(HOLE_MM, abs=0.05)
    assert plate.height_mm == pytest.approx(RING_LAYERS * LAYER_MM, abs=1e-3)


def test_our_own_plate_is_found_where_its_markers_json_says():
    code, plate = plate_gcode(PRINTER, PlateSettings())
    found = markers_in(read_gcode_bytes(code.encode()))
    assert np.allclose(found.centres_mm, plate.centres_mm, atol=0.01)
    assert found.outer_diameter_mm == pytest.approx(plate.outer_diameter_mm, abs=0.05)


@pytest.mark.parametrize(
    "other",
    [job(CENTRES[:3]), job(in_hole=True), job(tower=True), job([[x, 60.0] for x in (30, 60, 120, 150)])],
    ids=["three rings", "discs", "towers", "rings in one line"],
)
def test_what_is_no_plate_of_four_low_rings_is_none(other):
    assert markers_in(other) is None


def test_a_camera_that_was_knocked_by_twenty_pixels_is_found_anew_and_the_print_goes_on():
    knocked = replace(TRUE, rvec=TRUE.rvec + [0.03, -0.035, 0.02], tvec_mm=TRUE.tvec_mm + [4.0, -3.0, 2.0])
    assert apart_px(knocked) > 20
    checks, inspector, moments = watch(knocked)
    assert [check.verdict for check in checks] == ["ok"] * len(checks)
    assert apart_px(inspector.camera(moments[-1])) < 1.5
    assert "markers in this print" in checks[-1].to_json()["calibration"]


def test_a_good_camera_stays_good():
    checks, inspector, moments = watch(TRUE, layers=5)
    assert [check.verdict for check in checks] == ["ok"] * 5
    assert apart_px(inspector.camera(moments[-1])) < 1.0


def test_a_print_that_comes_off_is_caught_although_it_has_markers():
    checks, _, _ = watch(TRUE, faults=(Fault("detachment", 5),))
    assert "failed" in [check.verdict for check in checks[5:]]
