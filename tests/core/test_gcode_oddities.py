"""Commands that few files hold: curves, places of work, cancelling taken back, and whose filament it was."""

from __future__ import annotations

import os
import tracemalloc

import numpy as np
import pytest

from octoprint_moop.core.errors import GcodeError
from octoprint_moop.core.gcode import interpreter
from octoprint_moop.core.gcode.read import read_gcode, read_gcode_bytes


def ends(text: str) -> list[list[float]]:
    return read_gcode_bytes(text.encode()).beads_mm[:, 3:6].astype(float).round(4).tolist()


def test_a_curve_is_followed_to_within_the_tolerance():
    beads = read_gcode_bytes(b"M83\nG1 X0 Y0 Z0.2\nG5 X40 Y0 I10 J30 P-10 Q-30 E5\n").beads_mm.astype(float)
    t = np.linspace(0, 1, 20001)
    curve = np.stack([30 * t * (1 - t) ** 2 + 90 * t**2 * (1 - t) + 40 * t**3, 90 * t * (1 - t) * (1 - 2 * t)], axis=1)
    middles = (beads[:, :2] + beads[:, 3:5]) / 2
    assert max(np.hypot(*(curve - middle).T).min() for middle in middles) < 0.05
    length = np.hypot(*(beads[:, 3:5] - beads[:, :2]).T).sum()
    assert length == pytest.approx(np.hypot(*np.diff(curve, axis=0).T).sum(), rel=1e-3)
    assert beads[-1, 3:5].tolist() == [40, 0]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("G92 X0\nG53 G1 X9 E1\nG1 X9 E1", [[9, 5, 0.2], [14, 5, 0.2]]),  # one line in machine coordinates
        ("G92 X0\nG53\nG1 X9 E1", [[9, 5, 0.2]]),  # from now on
        ("G10 L2 P2 X100 Y50\nG55\nG1 X1 Y1 E1\nG54\nG1 X1 Y1 E1", [[101, 51, 0.2], [1, 1, 0.2]]),
        ("G10 L20 P1 X0 Y0\nG1 X1 Y2 E1", [[6, 7, 0.2]]),
        ("G54\nG92 X0\nG55\nG1 X3 E1\nG54\nG1 X3 E1", [[3, 5, 0.2], [8, 5, 0.2]]),  # each remembers its own
        ("G92 X0 Y0\nG92.1\nG1 X7 Y7 E1", [[7, 7, 0.2]]),
        ("SAVE_GCODE_STATE NAME=a\nG91\nG92 X0\nG1 X2 E1\nRESTORE_GCODE_STATE NAME=a\nG1 X9 E1", [[7, 5, 0.2], [9, 5, 0.2]]),
        ("G28 X\nG1 X6 E1", [[6, 5, 0.2]]),
        ("G10 P1 X20 Y30\nT1\nG1 X6 E1", [[6, 5, 0.2]]),  # the firmware sees to it that the tool is where the file says
        ("M82\nG92 E0\nG1 X6 E1\nM83\nG1 X7 E1\nM82\nG1 X8 E3\nG1 X9 E3", [[6, 5, 0.2], [7, 5, 0.2], [8, 5, 0.2]]),
        ("G20\nG53 G1 X1 E0.1\nG21", [[25.4, 5, 0.2]]),
    ],
)  # fmt: skip
def test_places_and_modes_mean_what_the_firmware_takes_them_for(text, expected):
    assert ends(f"M83\nG1 X5 Y5 Z0.2\n{text}\n") == expected


def test_a_cancelling_may_be_taken_back_in_either_language():
    body = "".join(f"M486 S{i}\nG1 X{5 + i} Z0.2 E1\n" for i in range(3)) + "M486 S-1\n"
    text = "M83\nM486 T3\n" + body
    both = read_gcode_bytes((text + "M486 P0\nM486 P2\nM486 U0\n" + body).encode())
    assert both.cancelled == ((2, len(text + "M486 P0\nM486 P2\n")),)
    current = read_gcode_bytes((text + "M486 S1\nM486 C\n" + body).encode())
    assert current.cancelled == ((1, len(text + "M486 S1\nM486 C\n")),)
    body = "".join(
        f"EXCLUDE_OBJECT_START NAME={n}\nG1 X{5 + i} Z0.2 E1\nEXCLUDE_OBJECT_END\n" for i, n in enumerate("ab")
    )
    text = "M83\n" + body
    for command, left in (
        ("EXCLUDE_OBJECT NAME=a\n", [0]),
        ("EXCLUDE_OBJECT NAME=a\nEXCLUDE_OBJECT NAME=b\nEXCLUDE_OBJECT NAME=a RESET=1\n", [1]),
        ("exclude_object name='a'\nEXCLUDE_OBJECT RESET=1\n", []),
        ("EXCLUDE_OBJECT_START NAME=b\nEXCLUDE_OBJECT CURRENT=1\nEXCLUDE_OBJECT_END NAME=b\n", [1]),
        ("EXCLUDE_OBJECT\nEXCLUDE_OBJECT NAME=nobody\n", []),  # a question; a name that is none
    ):
        found = read_gcode_bytes((text + command + body).encode())
        assert [index for index, _ in found.cancelled] == left, command
        assert found.notes == ()


def test_objects_of_bambu_studios_files_are_known_by_their_ids():
    """The structure of such a file: header, layers, features, skippable objects."""
    layer = (
        "; CHANGE_LAYER\n; Z_HEIGHT: {z}\n; LAYER_HEIGHT: 0.2\nG1 E-.8 F1800\n; layer num/total_layer_count: {n}/2\n"
        "M622.1 S1\nM73 L{n}\nM991 S0 P0\n; OBJECT_ID: 81\n; start printing object, unique label id: 81\n"
        "M624 AQAAAAAAAAA=\nG1 X80 Y10 F30000\nG1 Z{z}\nG1 E.8 F1800\n; FEATURE: Outer wall\n; LINE_WIDTH: 0.42\n"
        "G1 X90 Y10 E.4\n; FEATURE: Sparse infill\n; LINE_WIDTH: 0.45\nG1 X80 Y12 E.4\n; WIPE_START\nG1 X82 E-.7\n"
        "; WIPE_END\n; stop printing object, unique label id: 81\nM625\nG17\nG3 Z{hop} I1.2 J0 P1 F30000\n"
        "; start printing object, unique label id: 121\nM624 AgAAAAAAAAA=\nG1 X20 Y20\nG1 Z{z}\nG1 E.8\n"
        "; FEATURE: Top surface\n; LINE_WIDTH: 0.42\nG1 X30 Y20 E.4\n; stop printing object, unique label id: 121\nM625\n"
        "; FEATURE: Prime tower\n; LINE_WIDTH: 0.5\nG1 X50 Y50\nG1 X60 Y50 E.5\n"
    )
    text = (
        "; HEADER_BLOCK_START\n; BambuStudio 02.06.00.51\n; total layer number: 2\n; total filament length [mm] : 3.4\n"
        "; model label id: 81,121\n; filament_diameter: 1.75\n; HEADER_BLOCK_END\nG90\nM83\nG29.1 Z-0.04\nG1 X0 Y0 Z0.8\n"
        "G1 X40 E12\n" + "".join(layer.format(z=0.2 * n, n=n, hop=0.2 * n + 0.4) for n in (1, 2))
    )
    found = read_gcode_bytes(text.encode())
    assert (found.layers, found.objects, found.notes) == (2, ("object 81", "object 121"), ())
    assert found.object_id.tolist() == [-1, 0, 0, 1, -1, 0, 0, 1, -1]
    assert found.role.tolist()[1:5] == [0, 2, 3, 6]
    assert found.beads_mm[1:5, 6].astype(float).round(2).tolist() == [0.42, 0.45, 0.42, 0.5]
    # retractions by 0.8 and 0.7 against 0.8 and 0.8 again: what was fed beyond is the highest that E has been
    assert found.filament_own_mm == 12 and found.filament_mm == pytest.approx(3.4, abs=0.3)


def test_objects_that_cura_prints_one_after_the_other_keep_their_layers_and_names():
    part = ";LAYER:{n}\n;MESH:{name}\n;TYPE:WALL-OUTER\nG0 X{x} Y5 Z{z}\nG1 X{far} Y5 E1\n;MESH:NONMESH\nG0 Z5\n"
    text = ";FLAVOR:Marlin\nM83\n;LAYER_COUNT:3\n" + "".join(
        part.format(n=n, name=name, x=x, far=x + 9, z=0.2 * (n + 1))
        for name, x in (("a.stl", 10), ("b.stl", 60))
        for n in range(3)
    )
    found = read_gcode_bytes(text.encode())
    assert found.layers == 6 and found.objects == ("a.stl", "b.stl")
    assert found.layer_z_mm.astype(float).round(2).tolist() == [0.2, 0.4, 0.6] * 2
    assert found.object_id.tolist() == [0, 0, 0, 1, 1, 1]


START = "M83\nG92 E0\nG1 X0 Y0 Z0.2\nG1 X60 E9\nG1 X0 E9\nG1 E-1\n"
PRINT = ";LAYER_CHANGE\n;TYPE:External perimeter\nG1 X5 Y5\nG1 E1\n" + "G1 X9 Y9 E2\nG1 X5 Y5 E2\n" * 20
CHANGE = ";TYPE:Custom\nG1 E-40\nG1 E45\n;TYPE:Perimeter\n"


@pytest.mark.parametrize(
    ("slicer", "counted"),
    [
        ("PrusaSlicer 2.5.2", 160), ("PrusaSlicer 2.4.0-alpha1+win64", 160), ("SuperSlicer 2.3.56", 160),
        ("PrusaSlicer 2.6.1+MacOS-x64", 183), ("PrusaSlicer 2.10.0", 183), ("a slicer that nobody knows", 183),
    ],
)  # fmt: skip
def test_filament_is_counted_as_the_slicer_counts_with_or_without_the_users_own_gcode(slicer, counted):
    text = f"; generated by {slicer} on 2026-01-01\n;TYPE:Custom\n{START}{PRINT}{CHANGE}{PRINT}"
    found = read_gcode_bytes(text.encode())
    assert found.filament_own_mm == pytest.approx(18 + 5)
    assert found.filament_mm == pytest.approx(counted, abs=1.1)  # by the retraction of the start


def test_the_users_own_gcode_is_the_same_in_a_long_run_and_line_by_line(monkeypatch):
    text = ("; generated by PrusaSlicer 2.5.0 on\n;TYPE:Custom\n" + START + (PRINT + CHANGE) * 30).encode()
    fast = read_gcode_bytes(text)
    monkeypatch.setattr("octoprint_moop.core.gcode.read.SHORT_RUN", 10**9)
    slow = read_gcode_bytes(text)
    assert (fast.filament_mm, fast.filament_own_mm) == pytest.approx((slow.filament_mm, slow.filament_own_mm))


def test_a_file_of_nothing_but_arcs_takes_no_more_memory_than_a_multiple_of_its_size(monkeypatch):
    """A line of 23 bytes may ask for a circle of 1800 chords, 80 kB. Beads take 43 bytes each."""
    monkeypatch.setattr(interpreter, "SPARE_BEADS", 2000)
    arcs = b"M83\nG1 X0 Y0 Z0.2\n" + b"G2 X0 Y0 I-40000 E1\n" * 5000 + b"G2.1\n" + b"G3 I9000 P90 E1\nM117\n" * 2000
    tracemalloc.start()
    found = read_gcode_bytes(arcs)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert len(found) <= 2000 + len(arcs) // 2 + 4 * 7000
    assert most < 200 * len(arcs)
    assert "drawn coarsely" in " ".join(found.notes)
    assert found.end_pos[-1] == len(arcs) - len(b"M117\n")
    monkeypatch.undo()
    usual = read_gcode_bytes(b"M83\nG1 X0 Y0 Z0.2\n" + b"G2 X10 Y10 I5 J5 E1\nG3 X0 Y0 I-5 J-5 E1\n" * 3000)
    assert usual.notes == ()


def test_a_file_that_feeds_by_a_is_read_as_if_it_said_e():
    by_e = "G21\nG90\nG92 E0\nG1 X0 Y0 Z0.2\n" + "".join(
        f"G1 X{k % 2 * 9} Y{k} E{k + 1}\nG1 F9 E{k}\n" for k in range(40)
    )
    by_a = by_e.replace("E", "A")
    one, other = (read_gcode_bytes(text.encode()) for text in (by_e, by_a))
    np.testing.assert_array_equal(one.beads_mm, other.beads_mm)
    assert one.filament_mm == other.filament_mm
    relative = "G92 A0\n" + "".join(f"G1 X{k % 2 * 9} Y{k} Z.2 A{0.5 + k % 3}\n" for k in range(40))
    assert len(read_gcode_bytes(relative.encode())) == 39  # the first goes nowhere
    turned = "G1 X0 Y0 Z.2 A90\nM83\nG1 X9 A45 E1\n"  # an axis that turns, beside E
    assert read_gcode_bytes(turned.encode()).filament_mm == 1


def test_a_pipe_is_refused_and_not_waited_for(tmp_path):
    pipe = tmp_path / "job.gcode"
    os.mkfifo(pipe)
    with pytest.raises(GcodeError, match="is a pipe"):
        read_gcode(pipe)
