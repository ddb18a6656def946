from __future__ import annotations

import cv2
import numpy as np
import pytest

from octoprint_moop.core.calibration.guides import BOX_MM, guides
from octoprint_moop.core.camera import Camera
from octoprint_moop.core.header import Printer


def camera(distortion: tuple[float, ...] = (0.0,) * 5, height_mm: float = 300.0) -> Camera:
    """Straight above (100, 100), the bed's y upwards in the picture."""
    rotation = np.diag([1.0, -1.0, -1.0])
    K = [[600, 0, 319.5], [0, 600, 239.5], [0, 0, 1]]
    centre = np.array([100.0, 100.0, height_mm])
    return Camera((640, 480), K, distortion, cv2.Rodrigues(rotation)[0].ravel(), -rotation @ centre)


def ends(what: str, printer: Printer, seen_by: Camera) -> np.ndarray:
    return np.array([line.points_px[[0, -1]] for line in guides(seen_by, printer) if line.what == what])


def test_the_beds_edge_is_where_similar_triangles_put_it() -> None:
    found = ends("bed", Printer(200, 200, 200), camera(height_mm=600.0)).reshape(-1, 2)
    corners = {(319.5 + 600 * x / 600, 239.5 - 600 * y / 600) for x in (-100, 100) for y in (-100, 100)}
    assert {tuple(point) for point in found.round(6)} == corners


def test_the_boxes_top_is_nearer_to_the_camera_and_so_larger() -> None:
    lines = ends("box", Printer(200, 200, 200), camera())
    lengths = np.linalg.norm(lines[:, 0] - lines[:, 1], axis=1)
    assert lengths.max() / 600 == pytest.approx(BOX_MM[0] / (300 - BOX_MM[2]))
    assert len(lines) == 12


def test_a_bed_with_its_origin_in_the_middle_is_drawn_round_nought() -> None:
    middle = Printer(200, 200, 200, origin="center")
    corner = Printer(200, 200, 200)
    seen = camera(height_mm=900.0)
    assert np.allclose(ends("bed", middle, seen) - ends("bed", corner, seen), np.array([-100, 100]) * 600 / 900)


def test_a_lens_bends_the_lines() -> None:
    bent = [
        line.points_px
        for line in guides(camera((-0.3, 0, 0, 0, 0), 400.0), Printer(200, 200, 200))
        if line.what == "bed"
    ]
    for line in bent:
        along = (line[-1] - line[0]) / np.linalg.norm(line[-1] - line[0])
        away_px = (line - line[0]) @ [along[1], -along[0]]
        assert np.abs(away_px).max() > 1


def test_what_lies_behind_the_camera_is_left_out() -> None:
    rotation = cv2.Rodrigues(np.array([-np.pi / 2, 0, 0]))[0].T  # from the bed's middle along y
    standing = Camera(
        (640, 480), camera().K, np.zeros(5), cv2.Rodrigues(rotation)[0].ravel(), -rotation @ [100.0, 100, 20]
    )
    lines = guides(standing, Printer(200, 200, 200))
    assert all(np.isfinite(line.points_px).all() for line in lines)
    assert 0 < len(lines) < 4 + 8 + 12
