"""The marker plate: what its G-code lays down, by our reader and by OctoPrint's."""

from __future__ import annotations

import math

import numpy as np
import pytest

from octoprint_moop.core.calibration.calibrate import Lens
from octoprint_moop.core.calibration.markers import find_discs
from octoprint_moop.core.calibration.plate import PlateSettings, plate_gcode, printer_from_profile
from octoprint_moop.core.calibration.plate_mesh import model_with_markers
from octoprint_moop.core.calibration.pose import calibrate_pose
from octoprint_moop.core.errors import CalibrationError, MeshError, RecordingError
from octoprint_moop.core.expected.raster import CvRenderer
from octoprint_moop.core.gcode.read import read_gcode_bytes
from octoprint_moop.core.header import Printer
from octoprint_moop.core.segmentation.segment import HsvThresholds
from tests.drawn import volume_error_px
from tests.made import camera_at

PRINTERS = {
    "corner origin": Printer(250, 210, 200),
    "centre origin": Printer(220, 220, 200, origin="center"),
    "round": Printer(200, 200, 300, origin="center", form_factor="circular"),
    "wide nozzle": Printer(300, 300, 200, nozzle_mm=0.8, filament_mm=2.85),
}


@pytest.mark.parametrize("name", PRINTERS)
def test_four_rings_of_the_right_size_height_and_amount_lie_where_markers_json_says(name):
    printer = PRINTERS[name]
    gcode, plate = plate_gcode(printer, PlateSettings())
    path = read_gcode_bytes(gcode.encode(), nozzle_mm=printer.nozzle_mm, filament_mm=printer.filament_mm)
    assert path.notes == ()
    assert len(path.objects) == 4
    assert path.layer_z_mm[-1] == pytest.approx(plate.height_mm, abs=1e-3)
    for index, centre in enumerate(plate.centres_mm):
        beads = path.beads_mm[path.object_id == index].astype(np.float64)
        from_centre = np.linalg.norm(beads[:, [0, 1]] - centre, axis=1)
        half = beads[:, 6] / 2
        assert (from_centre + half).max() == pytest.approx(plate.outer_diameter_mm / 2, abs=0.05)
        assert (from_centre - half).min() == pytest.approx(plate.hole_diameter_mm / 2, abs=0.05)
    ring_mm3 = math.pi / 4 * (plate.outer_diameter_mm**2 - plate.hole_diameter_mm**2) * plate.height_mm
    used_mm3 = path.filament_mm * math.pi / 4 * printer.filament_mm**2
    assert 4 * ring_mm3 < used_mm3 * 1.02 < 4 * ring_mm3 * 1.1
    low, high = path.bounds_mm()
    corner = np.zeros(2) if printer.origin == "lowerleft" else -np.array([printer.width_mm, printer.depth_mm]) / 2
    assert (low[:2] > corner).all() and (high[:2] < corner + [printer.width_mm, printer.depth_mm]).all()
    if printer.form_factor == "circular":
        assert np.linalg.norm(path.beads_mm[:, :2], axis=1).max() < printer.width_mm / 2


def test_octoprints_own_reader_sees_the_same_plate(tmp_path):
    interpreter = pytest.importorskip("octoprint.util.gcodeInterpreter")
    file = tmp_path / "markers.gcode"
    code, _ = plate_gcode(PRINTERS["corner origin"], PlateSettings())
    file.write_text(code)
    ours = read_gcode_bytes(code.encode())
    reader = interpreter.gcode()
    reader.load(str(file))
    assert reader.extrusionAmount[0] == pytest.approx(ours.filament_mm, rel=0.03)
    area = reader.printing_area
    assert [area["minX"], area["maxX"]] == pytest.approx(ours.bounds_mm()[:, 0], abs=0.5)
    assert area["maxZ"] == pytest.approx(1.2, abs=1e-3)


def test_the_plate_as_rendered_gives_the_pose_back():
    printer = PRINTERS["corner origin"]
    gcode, plate = plate_gcode(printer, PlateSettings())
    camera = camera_at((130, -150, 220), (125, 95, 0), "5 coefficients", focal_px=600)
    path = read_gcode_bytes(gcode.encode())
    # Four times as fine and then averaged, so that edges lie between pixels as a camera's do.
    fine = CvRenderer().birth_map(path, camera.resized((2560, 1920)), np.zeros(3)) > 0
    cover = fine.reshape(480, 4, 640, 4).mean(axis=(1, 3))[..., None]
    image = (cover * [20, 120, 240] + (1 - cover) * [40, 40, 40]).astype(np.uint8)
    colour = HsvThresholds(15, 45, 0.4, 0.3)
    assert len(find_discs(image, colour)) >= 4
    result = calibrate_pose(image, Lens.of(camera), plate, colour)
    assert volume_error_px(result.camera, camera).max() < 1.0


def test_the_users_own_start_and_end_code_is_kept_and_filled_in():
    start = "START_PRINT E={nozzle_temperature} B={bed_temperature}\n"
    settings = PlateSettings(start_gcode=start, end_gcode="END_PRINT", nozzle_temperature=245, bed_temperature=80)
    code, _ = plate_gcode(PRINTERS["corner origin"], settings)
    lines = code.splitlines()
    assert "START_PRINT E=245 B=80" in lines
    assert lines[-1] == "END_PRINT"
    assert "G28" not in lines
    assert lines.index("START_PRINT E=245 B=80") < lines.index("M83") < lines.index(";LAYER_CHANGE")


def test_a_cold_bed_is_not_waited_for():
    code, _ = plate_gcode(PRINTERS["corner origin"], PlateSettings(bed_temperature=0))
    assert "M190" not in code


@pytest.mark.parametrize(
    "changes",
    [{"diameter_mm": 3}, {"hole_diameter_mm": 15}, {"nozzle_temperature": 900}, {"height_mm": float("nan")}],
)
def test_settings_out_of_range_are_refused(changes):
    with pytest.raises(CalibrationError):
        PlateSettings(**changes)


def test_a_bed_too_small_is_refused():
    with pytest.raises(CalibrationError, match="do not fit"):
        plate_gcode(Printer(60, 60, 60), PlateSettings())


def test_octoprints_profile_and_a_recordings_header_both_serve():
    volume = {"width": 235, "depth": 235, "height": 250, "formFactor": "rectangular", "origin": "lowerleft"}
    profile = {"volume": volume, "extruder": {"nozzleDiameter": 0.6}}
    printer = printer_from_profile(profile)
    assert (printer.width_mm, printer.nozzle_mm) == (235, 0.6)
    assert printer_from_profile({"printer": printer.to_json()}) == printer
    profile["volume"]["formFactor"] = "circular"
    assert printer_from_profile(profile).origin == "center"
    for nonsense in (None, [], {}, {"volume": 3}, {"volume": {"width": "x", "depth": 1, "height": 1}}):
        with pytest.raises((CalibrationError, RecordingError)):
            printer_from_profile(nonsense)


def test_a_model_gets_four_rings_around_it_and_stays_solid(tmp_path):
    trimesh = pytest.importorskip("trimesh")
    file = tmp_path / "part.stl"
    part = trimesh.creation.box((40, 25, 12))
    part.apply_translation([300, -70, 3])
    part.export(file)
    printer = PRINTERS["corner origin"]
    mesh, plate = model_with_markers(file, printer, PlateSettings())
    bodies = mesh.split(only_watertight=True)
    assert len(bodies) == 5
    low, high = mesh.bounds
    assert (low[:2] + high[:2]) / 2 == pytest.approx([125, 105], abs=0.01)
    assert low[2] == pytest.approx(0)
    rings = sorted((body for body in bodies if body.volume < 1000), key=lambda body: body.centroid[0])
    for ring, centre in zip(rings, sorted(plate.centres_mm.tolist())):
        assert ring.centroid[:2] == pytest.approx(centre, abs=0.01)
        assert ring.volume == pytest.approx(math.pi * (64 - 9) * 1.2, rel=0.01)


def test_what_is_no_model_or_too_large_is_refused(tmp_path):
    trimesh = pytest.importorskip("trimesh")
    nonsense = tmp_path / "a.stl"
    nonsense.write_bytes(b"not a mesh at all")
    with pytest.raises(MeshError):
        model_with_markers(nonsense, PRINTERS["round"], PlateSettings())
    large = tmp_path / "b.stl"
    trimesh.creation.box((190, 190, 5)).export(large)
    with pytest.raises(CalibrationError, match="more than the bed"):
        model_with_markers(large, PRINTERS["round"], PlateSettings())
