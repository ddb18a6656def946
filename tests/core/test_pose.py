"""The pose from ring markers, on rendered pictures with known cameras and on drawn ones."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest

from octoprint_moop.core.camera import Camera
from octoprint_moop.core.header import Header
from octoprint_moop.core.calibrate import Lens
from octoprint_moop.core.markers import MarkerPlate
from octoprint_moop.core.pose import calibrate_pose

CASES = ("cube-clean", "detach-bedslinger", "dtu-paper", "multi-object")


def volume_error_px(found: Camera, true: Camera, bed_mm=(250, 210), nearest_mm: float = 60.0) -> np.ndarray:
    """Distances in px over the bed and up to 100 mm above it, of points that the true camera sees."""
    axes = [np.linspace(0, bed_mm[0], 11), np.linspace(0, bed_mm[1], 11), np.linspace(0, 100, 6)]
    points = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 3)
    in_camera = points @ true.camera_from_room[:3, :3].T + true.tvec_mm
    width, height = true.image_size_px
    corners = Lens.of(true).rays(np.array([[0, 0], [width, 0], [0, height], [width, height]], float))
    slope = np.hypot(in_camera[:, 0], in_camera[:, 1]) / np.maximum(in_camera[:, 2], 1e-9)
    ahead = (in_camera[:, 2] > 0) & (slope < np.linalg.norm(corners, axis=1).max()) & (
        np.linalg.norm(in_camera, axis=1) > nearest_mm
    )
    seen = true.project(points[ahead])
    inside = ((seen >= 0) & (seen < [width, height])).all(axis=1)
    return np.linalg.norm(found.project(points[ahead][inside]) - seen[inside], axis=1)


@pytest.mark.parametrize("case", CASES)
def test_the_pose_from_a_rendered_plate_is_within_a_pixel_all_over_the_bed(shared, case):
    folder = shared / "cases" / case
    header = Header.from_json(json.loads((folder / "recording.json").read_text()))
    plate = MarkerPlate.from_json(json.loads((folder / "calib" / "markers.json").read_text()))
    image = cv2.imread(str(folder / "calib" / "markers.jpg"))
    result = calibrate_pose(image, Lens.of(header.camera()), plate, header.material)
    error_px = volume_error_px(result.camera, header.camera())
    assert all(px is not None for px in result.markers_px)
    assert error_px.mean() < 0.5
    assert np.quantile(error_px, 0.99) < 1.0
