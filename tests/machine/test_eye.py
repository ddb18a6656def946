"""The eye itself, asked without a pipe."""

from __future__ import annotations

import json

import pytest

from octoprint_moop.core.errors import MoopError
from octoprint_moop.core.settings import DEFAULTS
from octoprint_moop.machine.eye import Eye

GCODE = "M83\n" + "".join(
    f"G1 Z{z / 5:.1f} F600\nG1 X90 Y90 F9000\nG1 X110 Y90 E1\nG1 X110 Y100 E.5\nG1 X90 Y100 E1\nG1 X90 Y90 E.5\n"
    for z in range(1, 6)
)
HEADER = {
    "format": "moop-recording", "version": 1, "job": {"file": "job.gcode", "bytes": len(GCODE)},
    "printer": {"volume_mm": {"width": 200, "depth": 200, "height": 200}, "origin": "lowerleft",
                "form_factor": "rectangular", "bed_motion": "fixed", "bed_reference_mm": {"x": 0, "y": 0, "z": 0},
                "nozzle_mm": 0.4, "filament_mm": 1.75},
    "camera": {"image_size_px": [64, 48], "K": [[60, 0, 31.5], [0, 60, 23.5], [0, 0, 1]],
               "distortion": [0, 0, 0, 0, 0], "rvec": [3.14159, 0, 0], "tvec_mm": [-100, 100, 300]},
    "material": {"hue_deg": [15, 40], "saturation_min": 0.4, "value_min": 0.25},
}  # fmt: skip


@pytest.mark.parametrize("harm", ["deleted", "damaged"])
def test_a_recording_that_cannot_be_read_costs_an_eye_its_lessons_and_not_the_watching(tmp_path, harm):
    job, recording = tmp_path / "job.gcode", tmp_path / "recording"
    job.write_text(GCODE)
    if harm == "damaged":
        recording.mkdir()
        (recording / "recording.json").write_text(json.dumps(HEADER))
        (recording / "frames.jsonl").write_text("half a li\n{}\n")
    eye = Eye()
    try:
        told, _ = eye.open([], str(job), HEADER, DEFAULTS, str(tmp_path / "cache"), recording=str(recording))
        assert told["layers"] == 5 and any("learned again" in note for note in told["notes"])
    finally:
        eye.close()


def test_a_print_that_cannot_be_opened_is_not_taken_for_the_one_before(tmp_path):
    job = tmp_path / "job.gcode"
    job.write_text(GCODE)
    eye = Eye()
    try:
        eye.open([], str(job), HEADER, DEFAULTS, str(tmp_path / "cache"))
        eye.pictures([])
        with pytest.raises(MoopError):
            eye.open([], str(tmp_path / "gone.gcode"), HEADER, DEFAULTS, str(tmp_path / "cache"))
        with pytest.raises(MoopError, match="No print is being watched"):
            eye.pictures([])
    finally:
        eye.close()
