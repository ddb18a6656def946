"""Reading G-code: what a file says, and what the printer will do with it."""

from __future__ import annotations

import gzip
import json

import numpy as np
import pytest

from octoprint_moop.core.errors import GcodeError
from octoprint_moop.core.gcode.read import read_gcode, read_gcode_bytes


@pytest.mark.parametrize("case", ["cube-clean", "detach-bedslinger", "dtu-paper", "multi-object"])
def test_a_layer_ends_where_its_last_bead_ends(shared, case):
    folder = shared / "cases" / case
    truth = json.loads((folder / "truth.json").read_text())
    frames = [json.loads(line) for line in (folder / "frames.jsonl").read_text().splitlines()]
    toolpath = read_gcode(folder / "job.gcode")
    assert toolpath.layers == truth["layers"]
    assert set(toolpath.objects) == set(truth["objects"])
    ends = toolpath.end_pos[toolpath.layer_start[1:] - 1]
    np.testing.assert_array_equal(ends, [frame["file_pos"] for frame in frames])
    assert (toolpath.layer_end_pos >= ends).all()
    assert (toolpath.layer_end_pos[:-1] < toolpath.end_pos[toolpath.layer_start[1:-1]]).all()


@pytest.mark.parametrize(
    ("content", "word"),
    [
        (b"", "empty"),
        (b"GCDE\x01\x00\x00\x00", "binary G-code"),
        (b"PK\x03\x04rest", "zip"),
        (b"\x7fELF\x00\x00", "not a text file"),
        (b"G28\nG1 X10 Y10\nG1 E5\n", "extrudes nothing"),
    ],
)
def test_what_is_no_gcode_is_refused_with_a_sentence(tmp_path, content, word):
    path = tmp_path / "job.gcode"
    path.write_bytes(content)
    with pytest.raises(GcodeError, match=word):
        read_gcode(path)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(GcodeError, match=r"nowhere\.gcode"):
        read_gcode(tmp_path / "nowhere.gcode")


def test_a_layer_that_the_file_parks_after_ends_at_the_park_and_not_at_a_travel_across_the_print(tmp_path):
    square = "G1 X110 Y100 E1\nG1 X110 Y110 E1\nG1 X100 Y110 E1\nG1 X100 Y100 E1\n"
    first = "M83\nG1 X100 Y100 Z0.2\n" + square + "G1 E-1 F2400\n"
    parked = first + "G1 Z0.4\nG1 X0 Y200 F7800\n"
    second = parked + "G1 X100 Y100\nG1 E1\n" + square
    crossed = second + "G1 E-1\n"
    path = tmp_path / "job.gcode"
    path.write_text(crossed + "G1 Z0.6\nG1 X118 Y100\nG1 X100 Y100\nG1 E1\n" + square)
    assert read_gcode(path).layer_end_pos[:2].tolist() == [len(parked), len(crossed)]


def beads(text: str, **settings) -> np.ndarray:
    return read_gcode_bytes(text.encode(), **settings).beads_mm


def ends(text: str) -> list[list[float]]:
    """Where each bead ends, X Y Z rounded to the micrometre."""
    return np.round(beads(text)[:, 3:6].astype(float), 3).tolist()


def test_a_full_circle_arc_is_not_lost_and_leaves_the_circle_by_no_more_than_the_tolerance():
    path = beads("M83\nG1 X30 Y20 Z0.2\nG2 X30 Y20 I-10 J0 E5\n").astype(float)
    start, end = path[:, :2], path[:, 3:5]
    lengths = np.linalg.norm(end - start, axis=1)
    assert lengths.sum() == pytest.approx(2 * np.pi * 10, rel=0.005)
    middle = np.linalg.norm((start + end) / 2 - [20, 20], axis=1)
    assert (10 - middle).max() <= 0.0501
    (ax, ay), (bx, by) = (start - [20, 20]).T, (end - [20, 20]).T
    assert (ax * by - ay * bx).max() < 0  # clockwise


@pytest.mark.parametrize("turns", range(1, 12))
def test_circles_that_are_three_chords_each_are_never_one_more_for_rounding(turns):
    for radius_mm in (0.004, 0.02, 0.062, 0.0971):
        path = beads(f"M83\nG1 X30 Y20 Z0.2\nG2 I{radius_mm} P{turns} E5\n")
        assert len(path) == 3 * turns, radius_mm


@pytest.mark.parametrize(("radius", "turn"), [(10, np.pi / 2), (-10, 3 * np.pi / 2)])
def test_an_arc_by_radius_goes_the_short_way_for_r_and_the_long_way_for_minus_r(radius, turn):
    path = beads(f"M83\nG1 X30 Y20 Z0.2\nG3 X20 Y30 R{radius} E5\n").astype(float)
    lengths = np.linalg.norm(path[:, 3:5] - path[:, :2], axis=1)
    assert lengths.sum() == pytest.approx(10 * turn, rel=0.005)
    np.testing.assert_allclose(path[-1, 3:5], [20, 30], atol=1e-5)


def test_a_helix_climbs_evenly():
    path = beads("M83\nG1 X30 Y20 Z0.2\nG3 X30 Y20 Z1.2 I-10 E5\n").astype(float)
    part = np.cumsum(np.linalg.norm(path[:, 3:5] - path[:, :2], axis=1))
    np.testing.assert_allclose(path[:, 5], 0.2 + part / part[-1], atol=1e-4)


def test_g92_of_e_is_no_extrusion_and_of_x_moves_the_coordinates():
    assert ends("G1 X5 Y5 Z0.2\nG92 E100\nG1 X6 E100.5\nG92 X0\nG1 X1 E101\n") == [[6, 5, 0.2], [7, 5, 0.2]]


def test_inches_are_inches():
    assert ends("M83\nG20\nG1 X1 Y1 Z0.01\nG1 X2 E0.1\n") == [[50.8, 25.4, 0.254]]


def test_relative_moves_make_e_relative_too_and_g90_does_not_take_m83_back():
    both = ends("M82\nG1 X5 Y5 Z0.2 E3\nG91\nG1 X1 E0.1\nG1 X1 E0.1\nG90\nG1 X9 E3.5\n")
    assert both == [[5, 5, 0.2], [6, 5, 0.2], [7, 5, 0.2], [9, 5, 0.2]]
    assert len(ends("M83\nG90\nG1 X5 Y5 Z0.2 E1\nG1 X6 E0.5\nG1 X7 E0.4\n")) == 3


def test_relative_e_that_only_a_start_macro_declares_is_recognised():
    zigzag = "".join(f"G1 X{k % 2} Y{k} E{0.5 + 0.1 * (k % 3):.1f}\n" for k in range(20))
    assert len(ends("PRINT_START\nG1 X0 Y0 Z0.2\n" + zigzag)) == 19  # the first goes nowhere


def test_firmware_retraction_ends_a_layer_but_a_tool_setting_does_not():
    head, tail = "M83\n;LAYER:0\nG1 X5 Y5 Z0.2\nG1 X9 E1\n", ";LAYER:1\nG1 Z0.4\nG1 X5 E1\n"
    retracted, setting = head + "G10\n" + tail, head + "G10 P0 S190 R160\n" + tail
    assert read_gcode_bytes(retracted.encode()).layer_end_pos[0] == len(head + "G10\n")
    assert read_gcode_bytes(setting.encode()).layer_end_pos[0] == len(head)


def test_a_wipe_belongs_to_the_end_of_its_layer():
    head = "M83\n;LAYER_CHANGE\nG1 X5 Y5 Z0.2\nG1 X9 E1\n;WIPE_START\nG1 F8640\nG1 X8 E-.7\n;WIPE_END\nG1 E-.1 F2100\n"
    toolpath = read_gcode_bytes((head + ";LAYER_CHANGE\nG1 Z.4\nG1 X0 Y0\nG1 E.8\nG1 X3 E1\n").encode())
    assert toolpath.layer_end_pos[0] == len(head)


def test_volumetric_e_gives_the_same_filament_and_widths():
    area = np.pi / 4 * 1.75**2
    linear = read_gcode_bytes(b"M83\nG1 X0 Y0 Z0.2\nG1 X50 E2\n")
    volumetric = read_gcode_bytes(f"M83\nM200 D1.75\nG1 X0 Y0 Z0.2\nG1 X50 E{2 * area:.6f}\n".encode())
    assert volumetric.filament_mm == pytest.approx(linear.filament_mm, rel=1e-5)
    np.testing.assert_allclose(volumetric.beads_mm, linear.beads_mm, rtol=1e-4)


def test_a_beads_width_follows_from_its_volume():
    """Rectangle with round sides: 0.5 wide and 0.2 high has an area of 0.3 x 0.2 + pi x 0.01 mm2."""
    fed = 50 * (0.3 * 0.2 + np.pi * 0.01) / (np.pi / 4 * 1.75**2)
    width, height = beads(f"M83\nG1 X0 Y0 Z0.2\nG1 X50 E{fed:.6f}\n")[0, 6:]
    assert (width, height) == (pytest.approx(0.5, abs=1e-3), pytest.approx(0.2))


def layers_of(text: str) -> list[float]:
    return [round(float(z), 3) for z in read_gcode_bytes(text.encode()).layer_z_mm]


def test_a_hop_is_no_layer():
    hops = "G1 X5 E1\nG1 Z0.6\nG1 X0\nG1 Z0.2\nG1 X5 E1\n"
    assert layers_of("M83\nG1 X0 Y0 Z0.2\n" + 5 * hops) == [0.2]


def test_a_spiral_has_a_layer_for_each_turn_and_not_for_each_move():
    angle = np.linspace(0, 10 * 2 * np.pi, 1001)
    moves = "".join(
        f"G1 X{50 + 20 * np.cos(a):.3f} Y{50 + 9 * np.sin(a):.3f} Z{0.2 + a / 31.416:.3f} E0.1\n" for a in angle
    )
    toolpath = read_gcode_bytes(("M83\nG1 X70 Y50 Z0.2\n" + moves).encode())
    assert toolpath.layers in (10, 11)
    assert np.diff(toolpath.layer_start)[:-1].tolist() == pytest.approx([100] * (toolpath.layers - 1), abs=4)
    np.testing.assert_allclose(toolpath.beads_mm[200:-200, 7], 0.2, atol=0.01)


def test_objects_printed_one_after_the_other_begin_on_the_bed_again():
    tower = "".join(f"G1 Z{z:.1f}\nG1 X10 E1\nG1 X0 E1\n" for z in (0.2, 0.4, 0.6))
    toolpath = read_gcode_bytes(("M83\nG1 X0 Y0\n" + tower + "G1 Z9\nG1 Y50\n" + tower).encode())
    assert np.round(toolpath.layer_z_mm, 3).tolist() == pytest.approx([0.2, 0.4, 0.6, 0.2, 0.4, 0.6])
    np.testing.assert_allclose(toolpath.beads_mm[:, 7], 0.2, atol=1e-5)


def test_raft_layers_with_negative_numbers_are_layers():
    raft = "".join(f";LAYER:{n}\nG1 Z{z}\nG1 X10 E1\nG1 X0 E1\n" for n, z in ((-2, 0.3), (-1, 0.6), (0, 0.8), (1, 1.0)))
    assert layers_of("M83\n;LAYER_COUNT:4\n" + raft) == [0.3, 0.6, 0.8, 1.0]


def test_a_prime_line_before_the_first_layer_comment_belongs_to_layer_0_and_is_a_tower():
    toolpath = read_gcode_bytes(
        b"M83\nG1 X0 Y3 Z0.3\nG1 X60 E9\n;LAYER:0\nG1 Z0.2\nG1 X10 E1\n;LAYER:1\nG1 Z0.4\nG1 X0 E1\n"
    )
    assert toolpath.layer_start.tolist() == [0, 2, 3]
    assert toolpath.role.tolist() == [6, 0, 0]


def test_the_file_can_cancel_objects_itself():
    start = "M83\nG1 X0 Y0 Z0.2\nEXCLUDE_OBJECT_DEFINE NAME=a\nEXCLUDE_OBJECT_DEFINE NAME=b\n"
    body = "".join(
        f"EXCLUDE_OBJECT_START NAME={n}\nG1 X{5 + i} E1\nEXCLUDE_OBJECT_END NAME={n}\n" for i, n in enumerate("ab")
    )
    text = start + body + "EXCLUDE_OBJECT NAME=b\n"
    toolpath = read_gcode_bytes((text + body).encode())
    assert toolpath.objects == ("a", "b")
    assert toolpath.cancelled == ((1, len(text)),)
    named = 'M83\nM486 T2\nM486 S0 A"left"\nG1 X5 Z0.2 E1\nM486 S1\nM486 Aright\nG1 X6 E1\nM486 S-1\nG1 X7 E1\n'
    toolpath = read_gcode_bytes((named + "M486 P0\n").encode())
    assert (toolpath.objects, toolpath.object_id.tolist()) == (("left", "right"), [0, 1, -1])
    assert toolpath.cancelled == ((0, len(named + "M486 P0\n")),)
    assert toolpath.cancel_commands == ("M486 P0", "M486 P1")


def test_at_commands_of_the_cancelobject_plugin_label_objects():
    toolpath = read_gcode_bytes(b"M83\n@Object cube 1\nG1 X5 Y1 Z0.2 E1\n@ObjectEnd\nG1 X6 E1\n")
    assert (toolpath.objects, toolpath.object_id.tolist()) == (("cube 1",), [0, -1])


def test_tool_changes_and_filament_changes_lay_nothing_and_each_tools_retraction_is_its_own():
    text = "M83\nG1 X5 Y5 Z0.2\nT0\nG1 X9 E10\nG1 E-80\nT1\nG1 E2\nG1 X5 E10\nM600\nG1 E-2\nT0\nG1 E80\nG1 X9 E1\n"
    toolpath = read_gcode_bytes(text.encode())
    assert len(toolpath) == 3
    assert toolpath.filament_mm == pytest.approx(10 + 12 + 1)


def test_damaged_lines_and_unknown_commands_are_counted_and_said():
    toolpath = read_gcode_bytes(b"PRINT_START\nM83\nG1 X5 Y5 Z0.2 E1\nG1 X99999999 E1\nG6 X1 Y1\nG2 X9 E1\n")
    assert len(toolpath) == 2
    assert any(note.startswith("2 moves make no sense") for note in toolpath.notes)
    assert any("PRINT_START" in note and "G6" in note for note in toolpath.notes)


def test_a_packed_file_is_read_with_the_positions_of_the_unpacked_one(tmp_path):
    path = tmp_path / "job.gcode.gz"
    path.write_bytes(gzip.compress(b"M83\nG1 X5 Y5 Z0.2 E1\n"))
    assert read_gcode(path).end_pos.tolist() == [21]
    path.write_bytes(path.read_bytes()[:-12])
    with pytest.raises(GcodeError, match="unpacked"):
        read_gcode(path)


def test_a_line_without_end_is_refused():
    with pytest.raises(GcodeError, match="line of more than"):
        read_gcode_bytes(b"G1 X1 " + b"Y" * (4 << 20))


@pytest.mark.parametrize(
    "rubbish", [b"(" * 50000, b"G1 X1 " + b"Y" * 50000, b" " * 50000, b"M486 A" + b" " * 50000 + b"x"]
)
def test_long_lines_of_rubbish_take_no_longer_than_others(rubbish):
    """Each would take minutes where a pattern backtracks; a hang here fails by the suite's own time limit."""
    assert len(read_gcode_bytes((rubbish + b"\n") * 20 + b"M83\nG1 X5 Y5 Z0.2 E1\n")) == 1
