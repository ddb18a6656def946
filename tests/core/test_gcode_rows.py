"""The reader that executes whole runs of moves against a plain one that goes line by line."""

from __future__ import annotations

import io
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from octoprint_moop.core.errors import GcodeError
from octoprint_moop.core.gcode import read as gcode
from octoprint_moop.core.gcode.head import HEAD_BYTES, looks_relative
from octoprint_moop.core.gcode.read import read_gcode_bytes
from octoprint_moop.core.gcode.rows import OTHER, split

from .plain_reader import plain_read


def assert_read_alike(data: bytes) -> None:
    plain = plain_read(data, looks_relative(data[:HEAD_BYTES]))
    if not plain["beads"]:
        with pytest.raises(GcodeError):
            read_gcode_bytes(data)
        return
    toolpath = read_gcode_bytes(data)
    starts, ends, _, positions = (np.array(column) for column in zip(*plain["beads"]))
    np.testing.assert_array_equal(toolpath.end_pos, positions)
    # float32 of numbers up to 1e6, and two ways to add up relative moves
    np.testing.assert_allclose(toolpath.beads_mm[:, :3], starts, rtol=2e-6, atol=2e-4)
    np.testing.assert_allclose(toolpath.beads_mm[:, 3:6], ends, rtol=2e-6, atol=2e-4)
    assert toolpath.bytes == plain["bytes"]
    last = toolpath.layer_start[1:] - 1
    tails = [plain["tails"].get(bead, int(positions[bead])) for bead in last.tolist()]
    parked = set(toolpath.layer_end_pos[toolpath.layer_end_pos != tails].tolist())
    assert parked <= plain["travels"]  # later only where the file parks the head


def number(low: float, high: float, decimals: int = 3) -> st.SearchStrategy[str]:
    def text(value: float, style: int) -> str:
        said = f"{value:.{decimals}f}"
        short = said.rstrip("0").rstrip(".") or "0"
        return {0: said, 1: short, 2: short.replace("0.", ".", 1) if short.lstrip("-").startswith("0.") else short}[
            style
        ]

    return st.builds(text, st.floats(low, high, allow_nan=False), st.integers(0, 2))


def words(letters: str, low: float, high: float) -> st.SearchStrategy[str]:
    return st.builds(
        lambda said: "".join(f" {letter}{value}" for letter, value in said.items()),
        st.dictionaries(st.sampled_from(letters), number(low, high), min_size=1, max_size=len(letters)),
    )


PLAIN = st.builds(
    lambda g, place, e: f"{g}{place}{e}",
    st.sampled_from(["G0", "G1", "G1", "G1"]),
    words("XYZF", -50, 250),
    st.one_of(st.just(""), number(-5, 5, 5).map(" E{}".format)),
)
ARCS = st.builds(
    lambda g, place, e: f"{g}{place}{e}",
    st.sampled_from(["G2", "G3"]),
    words("XYZIJRP", -20, 20),
    st.one_of(st.just(""), number(0, 5, 5).map(" E{}".format)),
)
MODES = st.sampled_from(
    [
        "G90", "G91", "M82", "M83", "G20", "G21", "G28", "G28 X0 Y0", "G92", "G92 E0", "G92 E1.5", "G92 X10 Y-3", "G10",
        "G11", "G10 P0 S200", "G10 S1", "T0", "T1", "M221 S94", "M200 D1.75", "M200 D0", "M600", "G4 P1", "M106 S255",
        "M204 S1000", ";TYPE:Perimeter", ";WIDTH:0.45", "; printing object a id:0 copy 0", "@Object a", "PRINT_START",
        "G53", "G54", "G55", "G59.2", "G53 G1 X5 Y6 E.2", "G53 G0 Z1", "G10 L2 P2 X5 Y6", "G10 L20 P1 X0 Y0 Z0.2", "G92.1",
        "G10 R5 S3", "SAVE_GCODE_STATE NAME=A", "RESTORE_GCODE_STATE NAME=A", "RESTORE_GCODE_STATE NAME=A MOVE=1",
        "M117 X1 Y2 E3", "(a comment) G1 X1", "", "   ", "M486 S1", "EXCLUDE_OBJECT_START NAME=a", "G17", "M73 P1",
    ]
)  # fmt: skip
CURVES = st.builds(
    lambda place, e: f"G5{place}{e}",
    words("XYZIJPQ", -20, 20),
    st.one_of(st.just(""), number(0, 5, 5).map(" E{}".format)),
)
ODD = st.sampled_from(
    [
        "g1 x10 y20 e.5", "G1X5Y6E1", "N12 G1 X3 Y4 E1*71", "G01 X1 Y2 E3", "G1 X 7 Y8 E2", "G1  X7 Y8 E2",
        "G1\tX2 E1",
        "G1 X1 Y2 E3 ; X99", "G1 X1 Y2 E3;E9", "G1 X1 Y2 E3 (X9)", "G1 X--5 E1", "G1 X1.2.3 E1", "G1 X E2", "G1 X+4 E1",
        "G1 X5- E1", "G1 X1e3 E1", "G1 X9999999999 E1", "G1 X12345678901234567890 E1", "G1 X- E1", "G1 X. E1",
        "G1 5 X3", "G1 X1 X2 Y3 E1", "G1 X1 Y2 E1 \u00e9", "; \u00e9\u4e2d", "G1 X3 Y3 E1   ", "  G1 X4 E1", "G2.1 X3",
        "G5 X1 Y1 E1",
        "G1", "G1 ", "G", "\u00e9", "G92 E", "G92 X0 E0", "G10;", "G11 ; x", "G1 X0.000001 E1", "G2 X1 Y1 E1",
        "G3 I5 E2",
    ]
)  # fmt: skip
LINE = st.one_of(PLAIN, PLAIN, PLAIN, ARCS, CURVES, MODES, ODD)
FILES = st.builds(
    lambda lines, endings, last: b"".join(
        line.encode() + endings[i % len(endings)] for i, line in enumerate(lines)
    )[: None if last else -1],
    st.lists(LINE, min_size=1, max_size=120),
    st.lists(st.sampled_from([b"\n", b"\n", b"\n", b"\r\n"]), min_size=1, max_size=3),
    st.booleans(),
)  # fmt: skip


@settings(max_examples=120, deadline=None)
@given(FILES)
def test_any_mixture_of_lines_is_read_as_line_by_line(data):
    assert_read_alike(data)


STYLES = {
    "as slicers write": str,
    "lower case": str.lower,
    "no blanks": lambda line: line.replace(" ", ""),
    "zeros": lambda line: " " + line.replace("G", "G 0", 1),
    "numbered, with checksums": lambda line: f"N12 {line}*71 ; *5",
    "all of it": lambda line: f"n3{line.lower().replace(' ', '').replace('g', 'g00')}*7",
    "words apart": lambda line: re.sub("([A-Z])", r" \1 ", line),
}


@settings(max_examples=60, deadline=None)
@given(
    st.lists(
        st.one_of(PLAIN, PLAIN, PLAIN, ARCS, st.sampled_from(["G92 E0", "G10", "G92 E0 X1"])), min_size=30, max_size=60
    ),
    st.sampled_from(["", "M83\n", "G91\n", "M83\nG91\nG20\n", "G92 X5\n"]),
    st.sampled_from(sorted(STYLES)),
)
def test_long_runs_of_moves_are_read_as_line_by_line_however_they_are_written(lines, mode, style):
    assert_read_alike((mode + "\n".join(map(STYLES[style], lines)) + "\n").encode())


@pytest.mark.parametrize("style", [style for style in STYLES if style != "words apart"])
def test_moves_are_rows_however_a_file_writes_them(style):
    line = STYLES[style]("G1 X10.5 Y-3 E.25")
    lines = split(f"; a comment\n{line}\n".encode() * 3)
    assert lines.kind.tolist() == [OTHER, 0] * 3
    assert [lines.words[ord(letter)][1].tolist() for letter in "XYE"] == [[10.5] * 3, [-3.0] * 3, [0.25] * 3]


BETWEEN_MOVES = st.sampled_from(
    [
        "M106 S255", "M204 S1000", "M73 P1", "M105", "M600", "M117 X1 Y2 E3", "M204 S1 ; printing object b",
        "SET_VELOCITY_LIMIT ACCEL=500", "SET_VELOCITY_LIMIT A=5 ; printing object b", "BED_MESH_CLEAR", "MY_MACRO E=5",
         "", ";nothing",
        ";TYPE:Perimeter", ";TYPE:Custom", ";TYPE:Skirt/Brim", ";WIDTH:0.45", ";WIDTH:0.6\r", "; LINE_WIDTH: 0.42",
        ";WIDTH:.5 ", "; WIDTH:0.4", ";WIDTH:nan", ";HEIGHT:0.15", ";LAYER_CHANGE", "; layer 3, Z = 0.4", ";MESH:a",
        "; printing object a", "; stop printing object a", "@Object a", "M486 S1", "M486 S-1", "EXCLUDE_OBJECT_START NAME=a",
        "EXCLUDE_OBJECT NAME=a", "G10", "G11", "G1 E-1 F1800", "G92 E0", "G92 E0 ; again", "G1 F1800 ;", "G1  X7 Y8  E2 ",
    ]
)  # fmt: skip


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.one_of(*[PLAIN] * 4, BETWEEN_MOVES), min_size=40, max_size=200),
    st.sampled_from(["", "M83\n", "G91\n", ";LAYER:0\nM83\n", "; generated by PrusaSlicer 2.4\n;LAYER_CHANGE\n"]),
)
def test_what_is_said_between_moves_is_heard_in_a_long_run_as_line_by_line(lines, mode):
    data = (mode + "G1 X1 Y1 E1\nG1 X9 Y1 E2\n" + "\n".join(lines) + "\n").encode()
    assert_read_alike(data)
    at_once = read_gcode_bytes(data)
    before, gcode.SHORT_RUN = gcode.SHORT_RUN, 10**9
    try:
        by_line = read_gcode_bytes(data)
    finally:
        gcode.SHORT_RUN = before
    for name in ("layer_start", "layer_end_pos", "role", "object_id"):
        np.testing.assert_array_equal(getattr(at_once, name), getattr(by_line, name), name)
    np.testing.assert_allclose(at_once.beads_mm[:, 6:], by_line.beads_mm[:, 6:], rtol=1e-3, atol=1e-3)
    assert (at_once.objects, at_once.cancelled, at_once.slicer) == (by_line.objects, by_line.cancelled, by_line.slicer)
    assert at_once.filament_mm == pytest.approx(by_line.filament_mm, abs=1e-6)
    assert at_once.filament_own_mm == pytest.approx(by_line.filament_own_mm, abs=1e-6)


@pytest.mark.parametrize(
    ("between", "follows"),
    [
        ("M204 S500", True),
        ("SET_VELOCITY_LIMIT ACCEL=500", True),
        ("PARK", False),
        ("M106 S0", True),
        (";WIPE_START", True),
        ("", True),
        ("M600", False),
        ("M105", False),
    ],
)
def test_a_long_runs_retraction_belongs_to_its_layer_unless_something_stands_between(between, follows):
    moves = ";LAYER_CHANGE\n" + "".join(f"G1 X{k} Y{k % 3} E1\n" for k in range(1, 41))
    first = f"{moves}{between}\nG1 E-1 F1800\n"
    ends = read_gcode_bytes(f"M83\n{first}{moves}".encode()).layer_end_pos
    assert ends[0] == len("M83\n") + len(first if follows else moves)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.one_of(PLAIN, ARCS), min_size=30, max_size=60), st.integers(16, 400))
def test_where_a_chunk_is_cut_makes_no_difference(lines, chunk_bytes):
    data = ("M83\n" + "\n".join(lines)).encode()
    before = gcode.CHUNK_BYTES
    gcode.CHUNK_BYTES = chunk_bytes
    try:
        assert_read_alike(data)
    finally:
        gcode.CHUNK_BYTES = before


@settings(max_examples=200, deadline=None)
@given(
    st.binary(max_size=400),
    st.lists(st.sampled_from([b"G1 X1 Y2 E1\n", b"G1 ", b"E", b"\n", b"\r", b"G2 I"]), max_size=20),
)
def test_rubbish_is_read_or_refused_but_never_crashes(rubbish, pieces):
    data = b"".join(piece + rubbish[i * 7 : i * 7 + 7] for i, piece in enumerate(pieces)) + rubbish
    try:
        toolpath = read_gcode_bytes(data)
    except GcodeError as refused:
        assert str(refused)
    else:
        assert np.isfinite(toolpath.beads_mm).all()
        assert (np.diff(toolpath.end_pos) >= 0).all()
        assert (np.diff(toolpath.layer_start) > 0).all()


@settings(max_examples=100, deadline=None)
@given(st.lists(st.binary(max_size=30).filter(lambda raw: b"\0" not in raw), min_size=1, max_size=10))
def test_positions_are_counted_as_octoprint_counts_them(comments):
    """OctoPrint reads with errors="replace" and counts what it would write again (`comm.py`, `_get_next_from_job`)."""
    data, expected = b"M83\nG1 X1 Y1 E1\n", [16]
    for k, comment in enumerate(comments):
        line = b";" + comment.replace(b"\n", b"").replace(b"\r", b"") + b"\n" + f"G1 X{2 + k} Y1 E1\n".encode()
        expected.append(expected[-1] + len(line.decode("utf-8", "replace").encode("utf-8")))
        data += line
    with io.TextIOWrapper(io.BytesIO(data), encoding="utf-8", errors="replace", newline="") as file:
        assert sum(len(line.encode("utf-8")) for line in file) == expected[-1]
    np.testing.assert_array_equal(read_gcode_bytes(data).end_pos, expected)


@pytest.mark.parametrize(
    "line", ["G1 X1 Y2 E3", "G0 X1", "G1 X-1.5 Y.5 F1800", "G2 X1 Y1 I-.5 J2 E1", "G92 E0", "G10", "G11"]
)
def test_usual_lines_are_rows(line):
    assert split(line.encode() + b"\n").kind[0] != OTHER
    assert split(line.encode() + b" ; comment X9\r\n").kind[0] != OTHER


@pytest.mark.parametrize(
    "line",
    [
        "g1 x1",
        "G1X1",
        "G1 X 1",
        "G1 X1 2",
        "G1 X1Y2",
        "G1 X",
        "G1 X1.2.3",
        "G1 X--1",
        "G1 X1-",
        "G92 E0 X1",
        "G10 P1",
        "G1 X12Y2",
        "G1 X1\u00e9",
        "G1 X1234567890.12345",
    ],
)
def test_unusual_lines_are_left_to_the_interpreter(line):
    assert split(line.encode() + 4 * b"\nG1 X1" + b"\n").kind.tolist() == [OTHER, 0, 0, 0, 0]


FIGURES = st.from_regex(r"-?([0-9]{1,7}\.[0-9]{0,7}|\.[0-9]{1,14}|[0-9]{1,15})", fullmatch=True)


@settings(max_examples=200, deadline=None)
@given(st.lists(st.one_of(number(-9999, 9999, 5), FIGURES), min_size=1, max_size=20))
def test_numbers_are_read_to_the_last_bit(numbers):
    lines = split("".join(f"G1 X{text}\n" for text in numbers).encode())
    rows, values = lines.words[ord("X")]
    assert rows.tolist() == list(range(len(numbers)))
    assert values.tolist() == [float(text) for text in numbers]


@pytest.mark.parametrize(
    "said", ["0.45", "0.449999", ".5", "1", "12.", "0.45\r", "", "0.4.5", "-0.4", "nan", "0x1", "0,4", "4e-1", " 0.4"]
)
def test_widths_that_are_read_together_are_read_as_one_by_one(said, monkeypatch):
    moves = "".join(f"G1 X{10 + n % 7} Y{n} E{0.1 * n:.2f}\n" for n in range(1, 41))
    parts = [f";WIDTH:{width}\nG92 E0\n{moves}" for width in ("0.61", said, "0.47")]
    data = ("M82\nG1 Z0.2\n" + "".join(parts)).encode()
    together = read_gcode_bytes(data).beads_mm[:, 6]
    monkeypatch.setattr("octoprint_moop.core.gcode.remarks._WIDTHS", ())
    assert np.array_equal(together, read_gcode_bytes(data).beads_mm[:, 6])
    assert set(together[:40]) == {np.float32(0.61)} and set(together[80:]) == {np.float32(0.47)}
    if said[0:3] == "0.4" and said.rstrip().count(".") == 1 and "," not in said:
        assert set(together[40:80]) == {np.float32(said)}


def test_every_dialect_is_read_as_line_by_line(shared):
    for path in sorted((shared / "data" / "gcode-zoo").glob("*.gcode")):
        assert_read_alike(path.read_bytes())
