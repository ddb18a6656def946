"""What slicers say of themselves, and what the reader makes of their files: must be the same."""

from __future__ import annotations

import re

import numpy as np
import pytest

from octoprint_moop.core.gcode.dialects import Feature, Height, Label, Layer, Width, meaning
from octoprint_moop.core.gcode.read import read_gcode, read_gcode_bytes
from octoprint_moop.core.toolpath import Role

# What the slicers' own comments say, found by eye or by the patterns below: layers, millimetres of filament, objects.
ZOO = {
    "arcwelder_benchy": (240, 4913.4, 0),
    "cura_3.6.0_calcube": (67, 1564.26, 1),  # its LAYER_COUNT says 68, but only 67 layers have a comment
    "cura_multi": (25, 273.87, 4),
    "cura_multi_excludeobject": (25, 273.87, 4),
    "dsf_simplify3d": (49, 4375.5, 0),
    "dsf_slic3r": (77, 1482.1, 0),
    "icesl_multi": (42, None, 0),
    "ideamaker_multi": (54, 422.7, 4),
    "kirimoto_multi": (25, 225.03, 0),
    "kisslicer_2.0.6_multi": (36, 305.09, 0),
    "m486_multi": (25, 215.44, 4),
    "matterslice_pyramid": (155, 3676.6, 0),
    "prusaslicer_2.6.1_benchy": (160, 4282.06, 1),
    "prusaslicer_2.7.4_vase": (334, 2996.07, 1),
    "prusaslicer_multi": (25, 215.44, 4),
    "s3d_4.0.0_bamarillo": (15, 10248.3, 0),
    "slic3r_multi": (16, None, 4),
    "superslicer_multi": (25, 264.59, 4),
}
LAYER_COMMENT = re.compile(
    rb"^(?:;LAYER_CHANGE|;\s?LAYER:-?\d+\s*$|; layer \d+, Z ?=|; BEGIN_LAYER_OBJECT|; <layer>|;; --- layer)",
    re.MULTILINE,
)


@pytest.mark.parametrize("name", sorted(ZOO))
def test_the_zoo_agrees_with_the_slicers_own_words(shared, name):
    layers, filament_mm, objects = ZOO[name]
    path = shared / "data" / "gcode-zoo" / f"{name}.gcode"
    toolpath = read_gcode(path)
    said = LAYER_COMMENT.findall(path.read_bytes())
    assert toolpath.layers == layers
    if said:
        assert len(said) == layers
    if filament_mm is not None:
        assert toolpath.filament_mm == pytest.approx(filament_mm, rel=0.005)
    assert len(toolpath.objects) == objects


def test_a_cura_files_bounds_are_those_it_states(shared):
    path = shared / "data" / "gcode-zoo" / "cura_multi.gcode"
    text = path.read_text()
    low, high = ([float(re.search(f";{end}{axis}:(.*)", text).group(1)) for axis in "XY"] for end in ("MIN", "MAX"))
    bounds = read_gcode(path).bounds_mm()
    np.testing.assert_allclose(bounds[:, :2], [low, high], atol=0.001)


def test_what_firmware_and_slicer_labels_name_is_one_object_with_its_command(shared):
    toolpath = read_gcode(shared / "data" / "gcode-zoo" / "m486_multi.gcode")
    assert toolpath.objects[0] == "cylinder_2 id:1 copy 0"
    assert toolpath.cancel_commands == ("M486 P0", "M486 P1", "M486 P2", "M486 P3")


def test_stated_widths_and_those_of_the_extruded_volume_agree(shared):
    """PrusaSlicer states each width. Without its comments, the volume must tell nearly the same."""
    data = (shared / "data" / "gcode-zoo" / "prusaslicer_2.6.1_benchy.gcode").read_bytes()
    data = data.replace(b"M221 S95", b"")  # of which the stated widths know nothing
    stated = read_gcode_bytes(data)
    silent = read_gcode_bytes(re.sub(rb"^;(?:WIDTH|HEIGHT):.*\n", b"", data, flags=re.MULTILINE))
    long_ = np.linalg.norm(stated.beads_mm[:, 3:5] - stated.beads_mm[:, :2], axis=1) > 2.0
    flat = np.isclose(stated.beads_mm[:, 7], silent.beads_mm[:, 7], atol=0.01)
    difference = (stated.beads_mm[:, 6] - silent.beads_mm[:, 6])[long_ & flat]
    assert flat.mean() > 0.95
    assert np.abs(np.median(difference)) < 0.01
    assert np.percentile(np.abs(difference), 90) < 0.03


@pytest.mark.parametrize(
    "comment",
    [
        "LAYER_CHANGE", "LAYER:0", "LAYER:-2", " LAYER:12", " CHANGE_LAYER", " layer 2, Z = 0.720", " layer 1, Z=0.200",
        " BEGIN_LAYER_OBJECT z=0.263 z_thickness=0.263", " <layer>", "; --- layer 0 (0.250 @ 0.255) ---",
    ],
)  # fmt: skip
def test_each_slicers_layer_comment_is_known(comment):
    assert isinstance(meaning(comment)[0], Layer)


@pytest.mark.parametrize(
    "comment",
    ["LAYER_COUNT:25", " layer end", " layer_height = 0.2", "LAYER:[layer_num]", " Layer count: 155",
     "BEFORE_LAYER_CHANGE",
     "AFTER_LAYER_CHANGE", " </layer>", "   layerHeight,0.24", " total_layer_number: 20", "Layer height: 0.2"],
)  # fmt: skip
def test_what_only_speaks_of_layers_is_no_layer(comment):
    assert not any(isinstance(said, Layer) for said in meaning(comment))


@pytest.mark.parametrize(
    ("comment", "role"),
    [
        ("TYPE:External perimeter", Role.OUTER), ("TYPE:WALL-INNER", Role.INNER), (" FEATURE: Outer wall", Role.OUTER),
        (" FEATURE: Sparse infill", Role.INFILL), ("TYPE:SKIN", Role.SURFACE), (" feature infill", Role.INFILL),
        (" outer perimeter", Role.OUTER), (" 'Loop Path', 0.2 [feed mm/s], 5.2 [head mm/s]", Role.INNER),
        ("TYPE:SUPPORT-INTERFACE", Role.SUPPORT), ("TYPE:Skirt/Brim", Role.BRIM), ("TYPE:RAFT", Role.BRIM),
        ("TYPE:Wipe tower", Role.TOWER), ("TYPE:PRIME-TOWER", Role.TOWER), ("TYPE:Never heard of", Role.OUTER),
    ],
)  # fmt: skip
def test_features_have_roles_and_unknown_ones_are_drawn(comment, role):
    (feature,) = meaning(comment)
    assert isinstance(feature, Feature)
    assert feature.role == role


@pytest.mark.parametrize(
    ("comment", "name"),
    [
        (" printing object gear.stl id:0 copy 0", "gear.stl id:0 copy 0"),
        (" stop printing object gear.stl id:0 copy 0", None),
        ("MESH:part 1.stl(2)", "part 1.stl(2)"), ("MESH:NONMESH", None),
        ("PRINTING: bed.3mf", "bed.3mf"), ("PRINTING: NON-OBJECT", None),
        (" start printing object, unique label id: 113", "object 113"),
        (" stop printing object, unique label id: 113", None), (" OBJECT_ID: 113", "object 113"),
    ],
)  # fmt: skip
def test_each_slicers_object_labels_are_known(comment, name):
    (label,) = meaning(comment)
    assert isinstance(label, Label)
    assert label.name == name


def test_stated_sizes_of_all_slicers_are_known():
    assert meaning("WIDTH:0.45") == (Width(0.45),)
    assert meaning(" LINE_WIDTH: 0.42") == (Width(0.42),)
    assert meaning("HEIGHT:0.2") == (Height(0.2),)
    assert meaning(" LAYER_HEIGHT: 0.28") == (Height(0.28),)
    assert meaning(" tool H0.240 W0.600") == (Height(0.24), Width(0.6))
