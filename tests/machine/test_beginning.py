"""Where a file is held for the picture of the empty bed."""

import pytest

from octoprint_moop.machine.beginning import bare_ends

HEAT = "M140 S60\nM104 S200\nG28\nM109 S200\n"
PRIME = "G1 X0 Y-3 Z0.2 F3000\nG92 E0\nG1 X60 E9 F1000\n"
TRAVEL = "G1 Z0.4 F600\nG92 E0\nM204 S800\nG1 X100 Y90 F9000 ; to the print\n;TYPE:Skirt\n\nG1 E0.8 F2100\n"
BEAD = "G1 X120 E0.7 F1200\n"


def lines_before(text: str) -> list[str]:
    """The commands after which the file may be held, for the bead that is the last line."""
    data = text.encode()
    return [data[:end].decode().rstrip().split("\n")[-1] for end in bare_ends(data, len(data))]


@pytest.mark.parametrize(
    ("text", "commands"),
    [
        (HEAT + TRAVEL + BEAD, ["M204 S800", "G1 E0.8 F2100"]),
        (HEAT + PRIME, ["M109 S200", "G92 E0"]),
        ("START_PRINT BED=60\nG1 X5 Y5\nG1 X100 Y90 F9000\n" + BEAD, ["START_PRINT BED=60", "G1 X100 Y90 F9000"]),
        ("G28\n" + BEAD, ["G28"]),
        ("G1 X5 Y5\n" + BEAD, ["G1 X5 Y5"]),
        (BEAD, []),
    ],
)
def test_a_file_is_held_where_the_travel_to_the_first_bead_begins_and_where_it_ends(text, commands):
    assert lines_before(text) == commands


def test_a_wait_on_the_way_is_not_passed_over():
    """Before it the nozzle may be cold, and the head over the bed."""
    text = "G28\nG1 X5 Y5\nM109 S200\nG1 X100 Y90\n" + BEAD
    assert lines_before(text) == ["M109 S200", "G1 X100 Y90"]


def test_a_long_preamble_is_not_read_to_its_beginning():
    text = "; a thumbnail\n" * 100_000 + "G28\nG1 X1 Y1\n" + BEAD
    assert len(bare_ends(text.encode(), len(text))) == 2
