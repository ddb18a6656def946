import pytest

from octoprint_moop.machine.parking import Modes, Park, read_modes

PARK = Park((0.0, 200.0), lift_mm=1.0, retract_mm=0.8, speed_mm_s=150, height_mm=210)


class Firmware:
    """A firmware that knows nothing but moves. g90_counts: G90 and G91 change the filament's mode, too."""

    def __init__(self, g90_counts: bool) -> None:
        self.at, self.feed = dict.fromkeys("XYZE", 0.0), 0.0
        self.relative, self.relative_e, self.g90_counts = False, False, g90_counts

    def do(self, commands):
        for command in commands:
            word, *rest = command.split()
            if word in ("G90", "G91"):
                self.relative = word == "G91"
                self.relative_e = self.relative if self.g90_counts else self.relative_e
            elif word in ("M82", "M83"):
                self.relative_e = word == "M83"
            for part in rest if word in ("G0", "G1") else ():
                axis, value = part[0], float(part[1:])
                if axis == "F":
                    self.feed = value
                else:
                    relative = self.relative_e if axis == "E" else self.relative
                    self.at[axis] = value + (self.at[axis] if relative else 0.0)
        return self

    @property
    def state(self):
        return {k: round(v, 6) for k, v in self.at.items()}, self.feed, self.relative, self.relative_e


FILES = {
    "relative filament": ["G90", "M83", "G1 X10 Y20 Z0.4 F9000", "G1 X30 E0.5 F1800"],
    "absolute filament": ["G90", "M82", "G1 X10 Y20 Z0.4 F9000", "G1 X30 E12.5 F1800"],
    "nothing said": ["G1 X10 Y20 Z0.4 F9000", "G1 X30 E12.5 F1800"],
    "a hop between": ["G90", "M83", "G1 X10 Y20 Z0.4 F9000", "G91", "G1 Z0.2", "G90", "M83", "G1 X30 E0.5 F1800"],
    "a hop that leaves the filament in doubt": ["M83", "G1 X1 Z0.4 F9000", "G91", "G1 Z0.2", "G90", "G1 X3 F1800"],
}


@pytest.mark.parametrize("g90_counts", [False, True])
@pytest.mark.parametrize("name", FILES)
def test_the_printer_is_as_it_was_when_the_head_comes_back(name, g90_counts):
    text = ("\n".join(FILES[name]) + "\n").encode()
    (modes,) = read_modes(text, [len(text)])
    firmware = Firmware(g90_counts).do(FILES[name])
    before, at = firmware.state, dict(firmware.at)
    away, back = PARK.moves((at["X"], at["Y"], at["Z"]), at["E"], modes)
    firmware.do(away)
    assert (firmware.at["X"], firmware.at["Y"]) == (0.0, 200.0)
    assert firmware.at["Z"] == pytest.approx(at["Z"] + 1)
    if name != "a hop that leaves the filament in doubt":
        assert firmware.at["E"] == pytest.approx(at["E"] - 0.8)
    firmware.do(back)
    assert firmware.state == before


@pytest.mark.parametrize("last", ["G91", "G20"])
def test_nothing_is_moved_where_the_file_is_relative_or_in_inches(last):
    text = f"G90\nG1 X1 F900\n{last}\n".encode()
    assert PARK.moves((1, 1, 1), 0.0, read_modes(text, [len(text)])[0]) is None


def test_nothing_is_moved_from_where_no_printer_can_stand():
    assert PARK.moves((1, 1, 999), 0.0, Modes(True, False, 900.0)) is None


def test_the_head_is_not_lifted_out_of_the_printers_top():
    away, _ = PARK.moves((1, 1, 209.5), 0.0, Modes(True, True, 900.0))
    assert "G1 Z210.000 F600" in away


def test_comments_do_not_change_modes_and_each_end_has_its_own():
    text = b"G90\nM83\nG1 X1 F900\n; G91 M82\nG1 X2 ; F7\nM82\nG1 X3 F1200\n"
    ends = [text.index(b"; G91"), text.index(b"M82\nG1 X3"), len(text)]
    modes = read_modes(text, ends)
    assert modes == [Modes(True, True, 900.0), Modes(True, True, 900.0), Modes(True, False, 1200.0)]
