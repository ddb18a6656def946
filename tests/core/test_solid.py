"""Meshes are read, judged and drawn; cut off at a height they look like the solid below it."""

from __future__ import annotations

import json
import struct
import zipfile

import cv2
import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from octoprint_moop.core.camera import BedMotion
from octoprint_moop.core.errors import MeshError
from octoprint_moop.core.expected.meshroad import MeshRoad, by_height, sliced
from octoprint_moop.core.expected.placing import Placement, place
from octoprint_moop.core.expected.raster import CvRenderer
from octoprint_moop.core.expected.solid import Solid, printed_bounds_mm, read_solid
from octoprint_moop.core.expected.views import ExpectedViews
from octoprint_moop.core.header import Header, Moment
from octoprint_moop.core.toolpath import Role
from tests.made import LENSES, camera_at, toolpath_of, vase

NOWHERE = np.zeros(3)


def solid_of(mesh) -> Solid:
    return Solid(np.asarray(mesh.triangles, dtype=np.float32))


def rays_of(camera):
    """Directions in the room of every pixel's centre, (H, W, 3)."""
    width, height = camera.image_size_px
    y, x = np.mgrid[:height, :width]
    rays = camera.rays(np.stack([x.ravel(), y.ravel()], axis=1))
    return (rays @ camera.camera_from_room[:3, :3]).reshape(height, width, 3)


def box_below(camera, low, high):
    """(H, W) bool: the ray through the pixel meets the box (the slab method)."""
    rays, eye = rays_of(camera), camera.centre_mm
    with np.errstate(divide="ignore"):
        one, other = (low - eye) / rays, (high - eye) / rays
    return np.minimum(one, other).max(axis=2) < np.maximum(one, other).min(axis=2)


def dome_below(camera, centre, radius, height_mm):
    """(H, W) bool: the ray through the pixel meets the ball below a height (the quadratic formula)."""
    rays, eye = rays_of(camera), camera.centre_mm
    b = rays @ (eye - centre)
    root = b**2 - ((eye - centre) @ (eye - centre) - radius**2)
    with np.errstate(invalid="ignore"):
        near, far = -b - np.sqrt(root), -b + np.sqrt(root)
        plane = (height_mm - eye[2]) / rays[..., 2]  # looking down, what lies beyond it is below the height
        below = np.where(rays[..., 2] < 0, far > plane, near < plane)
    return (root > 0) & below


@pytest.mark.parametrize("lens", ["straight", "5 coefficients", "fisheye"])
def test_one_drawing_holds_the_capped_solid_at_every_height(renderer, lens):
    camera = camera_at((140, -40, 60), (100, 100, 8), lens)
    low, high = np.array([85.0, 90, 0]), np.array([115.0, 110, 20])
    mesh = trimesh.creation.box(bounds=[low, high])
    heights = renderer.solid_map(solid_of(mesh), camera, NOWHERE)
    for cut_mm in (0.2, 5.0, 13.3, 20.0):
        drawn = (heights > 0) & (heights <= 1 + round(1000 * cut_mm))
        true = box_below(camera, low, np.array([115.0, 110, cut_mm]))
        assert (drawn ^ true).sum() < 0.002 * true.sum() + 4


def test_a_ball_cut_at_its_middle_is_a_bowl_seen_with_its_lid_on(renderer):
    camera = camera_at((100, -30, 90), (100, 100, 8))
    centre = np.array([100.0, 100, 15])
    mesh = trimesh.creation.icosphere(subdivisions=5, radius=15)
    mesh.apply_translation(centre)
    heights = renderer.solid_map(solid_of(mesh), camera, NOWHERE)
    for cut_mm in (4.0, 15.0, 24.0):
        drawn = (heights > 0) & (heights <= 1 + round(1000 * cut_mm))
        true = dome_below(camera, centre, 15, cut_mm)
        assert (drawn ^ true).sum() < 0.004 * true.sum()


@pytest.mark.parametrize("lens", LENSES)
def test_both_renderers_draw_the_same_solid(lens):
    gl = pytest.importorskip("octoprint_moop.machine.gl")
    camera = camera_at((190, -60, 90), (100, 100, 5), lens)
    mesh = trimesh.creation.torus(18, 6)
    mesh.apply_translation((100, 100, 6))
    with gl.GlRenderer() as drawn_by_gl:
        by_gl = drawn_by_gl.solid_map(solid_of(mesh), camera, np.array([0, 3, -1]))
    by_cv = CvRenderer().solid_map(solid_of(mesh), camera, np.array([0, 3, -1]))
    assert (by_gl > 0).sum() > 1000
    assert ((by_gl > 0) != (by_cv > 0)).sum() <= 5
    both = (by_gl > 0) & (by_cv > 0)
    assert np.percentile(np.abs(by_gl[both].astype(int) - by_cv[both]), 99.5) <= 5  # micrometres


def test_every_format_gives_the_same_box(tmp_path):
    mesh = trimesh.creation.box((10, 20, 30))
    mesh.export(tmp_path / "binary.stl")
    mesh.export(tmp_path / "ascii.stl", file_type="stl_ascii")
    mesh.export(tmp_path / "wavefront.obj")
    write_3mf(tmp_path / "project.3mf", mesh)
    for path in sorted(tmp_path.iterdir()):
        solid = read_solid(path)
        assert len(solid.triangles_mm) == 12, path
        assert np.allclose(solid.bounds_mm(), mesh.bounds), path
        assert solid.notes == (), path


def write_3mf(path, mesh, items='<item objectid="1"/>', more="", unit="millimeter", other=None):
    vertices = "".join(f'<vertex x="{x}" y="{y}" z="{z}"/>' for x, y, z in mesh.vertices)
    triangles = "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in mesh.faces)
    mesh_xml = f"<mesh><vertices>{vertices}</vertices><triangles>{triangles}</triangles></mesh>"
    box = f'<object id="1" type="model">{mesh_xml}</object>'

    def model(resources, build):
        return (
            f'<?xml version="1.0"?><model unit="{unit}" '
            'xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02" '
            'xmlns:p="http://schemas.microsoft.com/3dmanufacturing/production/2015/06">'
            f"<resources>{resources}</resources><build>{build}</build></model>"
        )

    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr(
            "_rels/.rels",
            '<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships"><Relationship '
            'Target="/3D/3dmodel.model" Id="r" Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/>'
            "</Relationships>",
        )
        if other is None:
            archive.writestr("3D/3dmodel.model", model(box + more, items))
        else:
            archive.writestr("3D/3dmodel.model", model(more, items))
            archive.writestr(other, model(box, ""))


def test_a_3mf_project_is_assembled_from_its_parts_and_files(tmp_path):
    mesh = trimesh.creation.box((10, 20, 30))
    pair = (
        '<object id="2" type="model"><components><component objectid="1" p:path="/3D/Objects/one.model"/>'
        '<component objectid="1" p:path="/3D/Objects/one.model" transform="0 1 0 -1 0 0 0 0 1 100 0 0"/>'
        "</components></object>"
    )
    items = '<item objectid="2" transform="1 0 0 0 1 0 0 0 1 5 6 7"/><item objectid="2" printable="0"/>'
    write_3mf(tmp_path / "two.3mf", mesh, items, pair, other="3D/Objects/one.model")
    solid = read_solid(tmp_path / "two.3mf")
    # the second is turned by a quarter about z, so that 20 mm of it lie along x
    assert np.allclose(solid.bounds_mm(), [[0, -4, -8], [115, 16, 22]])
    write_3mf(tmp_path / "inch.3mf", mesh, unit="inch")
    assert np.allclose(read_solid(tmp_path / "inch.3mf").bounds_mm(), 25.4 * mesh.bounds)


def bad_files(folder):
    mesh = trimesh.creation.box((1, 1, 1))
    write_3mf(folder / "lost.3mf", mesh, '<item objectid="9"/>')
    write_3mf(folder / "bare.3mf", mesh, "")
    write_3mf(folder / "round.3mf", mesh, '<item objectid="2"/>', '<object id="2"><components><component objectid="2"/></components></object>')  # fmt: skip  # noqa: E501
    (folder / "text.3mf").write_text("no archive")
    (folder / "short.stl").write_bytes(b"solid of nothing")
    (folder / "empty.stl").write_bytes(b"")
    (folder / "none.stl").write_bytes(b" " * 80 + struct.pack("<I", 0))
    (folder / "noise.obj").write_bytes(bytes(range(256)) * 4)
    (folder / "infinite.stl").write_bytes(b" " * 80 + struct.pack("<I12fH", 1, *[np.inf] * 12, 0))
    (folder / "flat.stl").write_bytes(b" " * 80 + struct.pack("<I12fH", 1, *[1.0] * 12, 0))
    (folder / "model.step").write_text("ISO-10303-21;")
    return [*sorted(folder.iterdir()), folder / "missing.stl", folder / "missing.obj", folder / "missing.3mf"]


def test_files_that_hold_no_model_are_refused_in_words(tmp_path):
    for path in bad_files(tmp_path):
        with pytest.raises(MeshError, match=path.name):
            read_solid(path)


def test_a_hole_in_the_surface_is_said(tmp_path):
    mesh = trimesh.creation.box((10, 10, 10))
    mesh.update_faces(np.arange(12) > 1)
    mesh.export(tmp_path / "open.stl")
    assert "4 edges border a hole" in read_solid(tmp_path / "open.stl").notes[0]


def test_a_surface_that_crosses_itself_is_said_and_one_that_does_not_is_not(tmp_path):
    one = trimesh.creation.icosphere(subdivisions=3, radius=10)
    for shift, crossed in (((6, 1.3, 0.7), True), ((20.5, 0, 0), False), ((0, 0, 0), False)):
        other = one.copy()
        other.apply_scale(0.9 if shift == (0, 0, 0) else 1)  # one inside the other: a hollow ball
        other.apply_translation(shift)
        path = tmp_path / "pair.stl"
        trimesh.util.concatenate([one, other]).export(path)
        notes = read_solid(path).notes
        assert bool(notes) == crossed
        assert not crossed or "crosses itself" in notes[0]


def test_a_box_through_a_box_is_crossed_by_few_large_triangles(tmp_path):
    cross = [trimesh.creation.box((30, 3.1, 4.3)), trimesh.creation.box((3.3, 30, 4.9))]
    trimesh.util.concatenate(cross).export(tmp_path / "cross.stl")
    assert "crosses itself" in read_solid(tmp_path / "cross.stl").notes[0]


def test_a_model_is_moved_to_where_it_is_printed_unless_it_is_there():
    print_ = vase(20, 60, (120, 80), 15)
    low, high = printed_bounds_mm(print_)
    assert np.allclose(low[2], 0) and np.allclose(high[2], 6)
    there = trimesh.creation.box(bounds=[low + np.array([0.2, 0.2, 0]), high - np.array([0.2, 0.2, 0.1])])
    assert solid_of(there).placed_on(print_).notes == ()
    there.apply_translation((-120, -80, -3))
    placed = solid_of(there).placed_on(print_)
    assert "moved by 120.0, 80.0, 3.0 mm" in placed.notes[0]
    assert np.allclose(placed.bounds_mm()[:, :2], [low[:2] + 0.2, high[:2] - 0.2], atol=1e-3)
    assert abs(placed.bounds_mm()[0, 2]) < 1e-3
    there.apply_scale(2)
    assert "scaled" in solid_of(there).placed_on(print_).notes[0]


def test_the_mesh_road_knows_the_layers_and_keeps_what_the_slicer_added():
    ring, skirt = vase(20, 60, (100, 100), 12).beads_mm, vase(1, 60, (100, 100), 24).beads_mm
    role = np.r_[np.full(60, Role.BRIM), np.full(1200, Role.OUTER)].astype(np.uint8)
    print_ = toolpath_of(np.concatenate([skirt, ring]), np.r_[np.zeros(60), np.repeat(np.arange(20), 60)].astype(int), role=role)  # fmt: skip  # noqa: E501
    mesh = trimesh.creation.cylinder(15, 6, sections=90)
    mesh.apply_translation((100, 100, 3))
    camera = camera_at((100, -80, 90), (100, 100, 5))
    births = MeshRoad(CvRenderer(), solid_of(mesh)).birth_map(print_, camera, NOWHERE)
    alone = CvRenderer().birth_map(print_, camera, NOWHERE, np.arange(60))
    assert np.array_equal((births > 0) & (births <= 60), alone > 0)
    half = (births > 0) & (births <= print_.layer_start[10]) & (alone == 0)
    mesh = trimesh.creation.cylinder(15, 3, sections=90)
    mesh.apply_translation((100, 100, 1.5))
    wanted = (CvRenderer().solid_map(solid_of(mesh), camera, NOWHERE) > 0) & (alone == 0)
    assert (half ^ wanted).sum() <= 0.01 * wanted.sum()
    inside_a_layer = (births > 0) & (births <= print_.layer_start[10] + 30) & (alone == 0)
    assert np.array_equal(inside_a_layer, half)


@pytest.mark.parametrize("case", ["cube-clean", "detach-bedslinger", "dtu-paper", "multi-object"])
def test_mesh_and_gcode_agree_on_rendered_cases(shared, case):
    gcode = pytest.importorskip("octoprint_moop.core.gcode.read")
    folder = shared / "cases" / case
    header = Header.from_json(json.loads((folder / "recording.json").read_text()))
    print_ = gcode.read_gcode(folder / "job.gcode")
    solid = read_solid(folder / "model.stl").placed_on(print_)
    assert solid.notes == ()
    at = (0.0, 200.0, 0.0)
    views = [
        ExpectedViews(print_, header.camera(), header.printer.bed, renderer)
        for renderer in (CvRenderer(), MeshRoad(CvRenderer(), solid))
    ]
    ious, rims = [], []
    for file_pos in print_.layer_end_pos[5:]:
        by_gcode, by_mesh = (one.at(int(file_pos), at).mask > 0 for one in views)
        ious.append((by_gcode & by_mesh).sum() / (by_gcode | by_mesh).sum())
        rims.append(cv2.morphologyEx((by_gcode ^ by_mesh).astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3))).sum())
    assert np.mean(ious) >= 0.97
    assert max(rims) == 0  # beads are round: a rim thinner than a pixel is all that the two differ by


def test_a_model_is_turned_and_put_where_the_user_says():
    brick = trimesh.creation.box(bounds=[[0, 0, 5], [30, 10, 9]])
    low, high = place(solid_of(brick), Placement(100, 50, 90)).bounds_mm()
    assert np.allclose([low, high], [[95, 35, 0], [105, 65, 4]], atol=1e-4)
    # counter-clockwise: what was right is at the back
    corner = trimesh.creation.box(bounds=[[20, 0, 0], [30, 10, 1]])
    both = Solid(np.concatenate([solid_of(brick).triangles_mm, solid_of(corner).triangles_mm + [0, 0, 20]]))
    tower = place(both, Placement(0, 0, 90)).triangles_mm
    assert tower[tower[:, :, 2].max(axis=1) > 10][:, :, 1].min() > 4.9
    # without a place of its own it is turned, and then goes where it is printed
    print_ = vase(20, 60, (120, 80), 15)
    low, high = place(solid_of(brick), Placement(turn_deg=90), print_).bounds_mm()
    assert np.allclose((low + high)[:2] / 2, printed_bounds_mm(print_)[:, :2].mean(axis=0), atol=1e-3)
    assert np.allclose(high[:2] - low[:2], [10, 30], atol=1e-4)


@pytest.mark.parametrize(
    "wrong", [{"x_mm": 3}, {"x_mm": "here", "y_mm": 1}, {"turn_deg": float("nan")}, {"turn_deg": 9e9}]
)
def test_a_place_that_is_none_is_refused_in_words(wrong):
    with pytest.raises(MeshError, match="model's"):
        Placement.from_json(wrong)


def test_a_model_alone_gives_the_same_picture_as_its_gcode_would():
    """Of a cylinder the outline is a circle at each height, and a layer stands from its count on."""
    mesh = trimesh.creation.cylinder(15, 6, sections=90)
    mesh.apply_translation((100, 100, 3))
    solid = solid_of(mesh)
    print_ = sliced(solid, 0.2)
    assert print_.layers == 30 and print_.layer_end_pos.tolist() == list(range(1, 31))
    assert np.allclose(print_.layer_z_mm, 0.2 * np.arange(1, 31))
    ends = print_.beads_mm[:, :6].reshape(-1, 3)
    assert np.abs(np.hypot(*(ends[:, :2] - 100).T) - 15).max() < 0.02
    round_mm = np.hypot(*(print_.beads_mm[:, 3:5] - print_.beads_mm[:, :2]).T).sum() / 30
    assert abs(round_mm / (2 * np.pi * 15) - 1) < 2e-3
    camera = camera_at((100, -80, 90), (100, 100, 5))
    seen = ExpectedViews(print_, camera, BedMotion("fixed"), MeshRoad(CvRenderer(), solid))
    half = trimesh.creation.cylinder(15, 3, sections=90)
    half.apply_translation((100, 100, 1.5))
    wanted = CvRenderer().solid_map(solid_of(half), camera, NOWHERE) > 0
    assert ((seen.at(15, (0, 0, 0)).mask > 0) ^ wanted).sum() <= 0.01 * wanted.sum()


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 10**6), st.floats(0.05, 0.6))
def test_the_outline_of_any_ball_is_closed_at_every_height(seed, layer_height_mm):
    ball = trimesh.creation.icosphere(2, 10)
    ball.apply_transform(trimesh.transformations.random_rotation_matrix(np.random.default_rng(seed).random(3)))
    ball.apply_translation((0, 0, 10))
    print_ = sliced(solid_of(ball), layer_height_mm)
    for layer in range(print_.layers):
        beads = print_.beads_mm[print_.layer_start[layer] : print_.layer_start[layer + 1]]
        ends = np.round(beads[:, [0, 1, 3, 4]].reshape(-1, 2), 3)
        _, uses = np.unique(ends, axis=0, return_counts=True)
        assert (uses % 2 == 0).mean() > 0.95  # rounding may part two ends


def test_at_a_height_what_may_be_a_hop_is_in_doubt():
    mesh = trimesh.creation.box(bounds=[[90, 90, 0], [110, 110, 10]])
    print_ = sliced(solid_of(mesh), 0.2)
    moment = by_height(Moment("a.jpg", 123456, 0, (0, 0, 5.0)), print_, 0.2)
    assert (moment.file_pos, moment.layer) == (25, 24)
    assert 0.2 * moment.sure_pos <= 4.0  # a hop of a millimetre over a layer that is not complete
    assert by_height(Moment("a.jpg", 1, 0, (0, 0, 0.0)), print_, 0.2).file_pos == 0
    with pytest.raises(MeshError, match="layer height is 9"):
        sliced(solid_of(mesh), 9)
    with pytest.raises(MeshError, match="stands on the bed"):
        sliced(solid_of(mesh).moved([0, 0, -50]), 0.2)
