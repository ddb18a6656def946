"""Nothing is moved unless it is known where the printer stands, and nothing hits anything."""

from __future__ import annotations

import pytest

from octoprint_moop.core.errors import CalibrationError
from octoprint_moop.machine.homing import Homing, short_move_mm

PRINTER = {"volume_mm": {"width": 200, "depth": 200, "height": 200}, "origin": "lowerleft"}


def sent(*commands):
    homing = Homing()
    for command in commands:
        homing.sent(command.split()[0].split(".")[0], command)
    return homing


@pytest.mark.parametrize(
    ("commands", "known"),
    [
        ([], False),
        (["G28"], True),
        (["G28 W"], True),
        (["G28 X Y"], False),
        (["G28 X0 Y0", "G28 Z"], True),
        (["G28", "M84"], False),
        (["G28", "M84", "G28 X"], False),
        (["G28", "G1 X5"], True),
        (["G28 ; XY"], True),
    ],
)
def test_the_position_is_known_once_all_axes_are_homed_and_the_motors_hold(commands, known):
    assert sent(*commands).known is known


def test_a_new_connection_knows_nothing():
    homing = sent("G28")
    homing.lost()
    assert not homing.known


def test_the_head_goes_up_and_towards_the_middle():
    assert short_move_mm((0, 0, 0), PRINTER) == (60, 30)
    assert short_move_mm((100, 190, 5), PRINTER) == (-60, 30)


def test_from_the_top_the_head_goes_down_but_only_far_above_the_bed():
    assert short_move_mm((100, 100, 195), PRINTER)[1] == -30
    with pytest.raises(CalibrationError, match="no room"):
        short_move_mm((5, 5, 45), {**PRINTER, "volume_mm": {"width": 200, "depth": 200, "height": 70}})


def test_a_position_outside_the_bed_is_not_believed():
    with pytest.raises(CalibrationError, match="outside its bed"):
        short_move_mm((100, 400, 5), PRINTER)
    assert short_move_mm((-90, -90, 5), {**PRINTER, "origin": "center"}) == (60, 30)
    with pytest.raises(CalibrationError, match="outside its bed"):
        short_move_mm((-90, -90, 5), PRINTER)
