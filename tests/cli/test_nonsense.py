"""What is typed wrongly, or names what makes no sense: one line that says so, exit status 2, never a traceback."""

from __future__ import annotations

import json

import pytest
from click.testing import CliRunner

from octoprint_moop.cli import main
from octoprint_moop.cli import replay as replaying


def said(*arguments: str) -> str:
    """The one line on standard error."""
    done = CliRunner().invoke(main, list(arguments), prog_name="moop")
    assert done.exit_code == 2, (done.output, done.exception)
    assert len(done.stderr.splitlines()) == 1, done.stderr
    assert done.stderr.startswith("moop: ") and not done.stdout
    return done.stderr


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["nonsense"], "No such command 'nonsense'"),
        (["--nonsense"], "--nonsense"),
        (["index"], "Missing argument 'FILE'"),
        (["index", "a.gcode", "b.gcode"], "b.gcode"),
        (["replay", "x", "--layer-height-mm", "thick"], "'thick'"),
        (["replay", "x", "--mesh-at", "1,2"], "--mesh"),
        (["replay", "x", "--report", "/nowhere/at/all.html"], "/nowhere/at"),
        (["mask", "x", "-o", "x.png"], "exactly one"),
        (["mask", "x", "-o", "x.png", "--file-pos", "-5"], "-5"),
        (["segment", "x.jpg", "-o", "out"], "--learn"),
        (["demo", "--fault", "nonsense"], "warping"),
        (["demo", "--port", "99999999"], "65535"),
        (["demo", "--seed", "-1"], "-1"),
        (["demo", "--fault-layer", "-1"], "-1"),
        (["calibrate", "lens"], "IMAGES"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_what_is_typed_wrongly_is_told_in_one_line(arguments, says):
    line = said(*arguments)
    assert says in line and "--help" in line


def test_the_file_that_is_wrong_is_named(tmp_path):
    for name, text in (("lens.json", "[]"), ("rings.json", "{}"), ("clicks.json", "3")):
        (tmp_path / name).write_text(text)
    lens, rings, clicks = (str(tmp_path / name) for name in ("lens.json", "rings.json", "clicks.json"))
    assert rings in said("calibrate", "pose", "x.jpg", "--lens", lens, "--markers", rings)
    (tmp_path / "rings.json").write_text(
        json.dumps({"outer_diameter_mm": 16, "height_mm": 1, "centres_mm": [[0, 0], [99, 0], [99, 99], [0, 99]]})
    )
    assert lens in said("calibrate", "pose", "x.jpg", "--lens", lens, "--markers", rings)
    assert clicks in said("calibrate", "points", "x.jpg", clicks)
    assert clicks in said("markers", "--profile", clicks)


@pytest.mark.parametrize(
    "header",
    [
        {"cameras": True},
        {"job": "x"},
        {"job": {"file": "a\0b", "bytes": 1}},
        {"job": {"file": "a" * 5000, "bytes": 1}},
        {"camera": {"image_size_px": [10**6, 10**6], "K": [[600, 0, 5], [0, 600, 5], [0, 0, 1]],
                    "distortion": [0, 0, 0, 0, 0], "rvec": [0, 0, 0], "tvec_mm": [0, 0, 500]}},
    ],
    ids=["cameras", "job", "a name with a NUL", "a long name", "a huge camera"],
)  # fmt: skip
def test_a_recording_whose_header_makes_no_sense_is_refused(tmp_path, header):
    whole = {
        "format": "moop-recording", "version": 1, "job": {"file": "job.gcode", "bytes": 0},
        "printer": {"volume_mm": {"width": 200, "depth": 200, "height": 200}, "origin": "lowerleft",
                    "form_factor": "rectangular", "bed_motion": "fixed", "bed_reference_mm": {"x": 0, "y": 0, "z": 0},
                    "nozzle_mm": 0.4, "filament_mm": 1.75},
        "camera": {"image_size_px": [64, 48], "K": [[60, 0, 31.5], [0, 60, 23.5], [0, 0, 1]],
                   "distortion": [0, 0, 0, 0, 0], "rvec": [3.14159, 0, 0], "tvec_mm": [0, 0, 500]},
        "material": {"hue_deg": [15, 40], "saturation_min": 0.4, "value_min": 0.25},
    }  # fmt: skip
    (tmp_path / "recording.json").write_text(json.dumps({**whole, **header}))
    (tmp_path / "frames.jsonl").touch()
    assert str(tmp_path) in said("replay", str(tmp_path))


def test_a_place_that_is_none_is_refused(tmp_path):
    from octoprint_moop.cli.mask import _position_mm
    from octoprint_moop.core.errors import MoopError

    with pytest.raises(MoopError, match="three numbers"):
        _position_mm("nan,0,0")


def test_a_bug_of_ours_is_one_line_too_and_its_traceback_is_for_who_asks(monkeypatch):
    def broken(*_):
        raise RuntimeError("this\nwas unexpected")

    monkeypatch.setattr(replaying, "_settings", broken)
    assert "RuntimeError: this was unexpected" in said("replay", "x")
    monkeypatch.setenv("MOOP_TRACEBACK", "1")
    done = CliRunner().invoke(main, ["replay", "x"])
    assert isinstance(done.exception, RuntimeError)
