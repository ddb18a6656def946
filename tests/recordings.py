"""Recordings made by the demo's simulated webcam, whose painter shares nothing with the renderer under test."""

from __future__ import annotations

import gzip
import json
from pathlib import Path

from octoprint_moop.core.gcode.read import read_gcode
from octoprint_moop.core.header import Header, Printer
from octoprint_moop.demo.run import BED, JOB, MATERIAL, demo_camera
from octoprint_moop.demo.simulate import Scene

PARKED_MM = (0.0, 200.0)
SIZE_PX = (400, 300)


def make_recording(folder: Path, layers: int = 16, reference: bool = True, **scene: object) -> Path:
    """The first `layers` layers of the demo's job, seen small; `scene` goes to `Scene`: faults, nuisances, seed."""
    folder.mkdir(parents=True)
    job = gzip.decompress(JOB.read_bytes())
    (folder / "job.gcode").write_bytes(job)
    toolpath = read_gcode(folder / "job.gcode")
    camera = demo_camera().resized(SIZE_PX)
    header = Header(Printer(250, 210, 210, bed=BED), ((None, camera),), MATERIAL, "job.gcode", len(job))
    (folder / "recording.json").write_text(json.dumps(header.to_json()))
    (folder / "frames").mkdir()
    painted = Scene(toolpath, camera, BED, **scene)
    if reference:
        (folder / "reference.jpg").write_bytes(painted.jpeg(0, (*PARKED_MM, 0.0)))
    with open(folder / "frames.jsonl", "w") as lines:
        for layer in range(layers):
            file_pos = int(toolpath.layer_end_pos[layer])
            position = (*PARKED_MM, float(toolpath.layer_z_mm[layer]) + 0.4)
            name = f"frames/{layer:06d}.jpg"
            (folder / name).write_bytes(painted.jpeg(file_pos, position))
            x, y, z = position
            moment = {
                "frame": name, "file_pos": file_pos, "layer": layer, "position_mm": {"x": x, "y": y, "z": z},
                "time_s": 30.0 * layer, "parked": True,
            }  # fmt: skip
            lines.write(json.dumps(moment) + "\n")
    return folder
