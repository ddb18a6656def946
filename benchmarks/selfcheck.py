"""What a print's own correction of the camera is worth: recordings replayed with a camera that is some pixels off.

    python -m benchmarks.selfcheck [--shared ../shared] [--off 1,2,3] [--seed 1] [--write]

Each recording is replayed up to its failure with the camera that took it, turned and moved at random so that the print
is seen so many pixels off (root mean square), with and without the correction by the first good layers. JSON on
standard output; `--write` keeps it as results/selfcheck.json and puts the table into docs/calibration.md.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.tables import ROOT, put, save, table
from octoprint_moop.core.calibration import selfcheck
from octoprint_moop.core.camera import Camera
from octoprint_moop.core.gcode.read import read_gcode
from octoprint_moop.core.inspection import Inspector
from octoprint_moop.core.toolpath import Toolpath
from octoprint_moop.machine.recording import Recording
from octoprint_moop.machine.renderers import open_renderer


def seen_points_mm(toolpath: Toolpath, recording: Recording) -> np.ndarray:
    """(N, 3) of the print above its first layer, in the room at the first capture."""
    shift_mm = recording.header.printer.bed.room_from_print_mm(recording.moments[0].position_mm)
    beads = toolpath.beads_mm[toolpath.beads_mm[:, 5] > 1.5 * toolpath.layer_z_mm[0]]
    return beads[:: max(1, len(beads) // 300), :3].astype(float) + shift_mm


def apart_px(camera: Camera, other: Camera, points_mm: np.ndarray) -> np.ndarray:
    return np.asarray(np.linalg.norm(camera.project(points_mm) - other.project(points_mm), axis=1))


def nudged(camera: Camera, off_px: float, seed: int, points_mm: np.ndarray) -> Camera:
    """A camera that sees the points so far off, root mean square: half turned, half moved, at random."""
    rng = np.random.default_rng(seed)
    turn, shift_mm = 0.002 * rng.normal(size=3), 0.6 * rng.normal(size=3)
    share = 1.0
    for _ in range(4):
        other = replace(camera, rvec=camera.rvec + share * turn, tvec_mm=camera.tvec_mm + share * shift_mm)
        share *= off_px / float(np.sqrt((apart_px(camera, other, points_mm) ** 2).mean()))
    return replace(camera, rvec=camera.rvec + share * turn, tvec_mm=camera.tvec_mm + share * shift_mm)


def replayed(recording: Recording, toolpath: Toolpath, thought: Camera, correct: bool) -> dict[str, Any]:
    header, true = replace(recording.header, cameras=((None, thought),)), recording.header.camera()
    kept, selfcheck.CORRECTED_UNTIL = selfcheck.CORRECTED_UNTIL, selfcheck.CORRECTED_UNTIL if correct else 0
    errors, failed, told, suspect = [], None, None, 0
    try:
        with open_renderer() as renderer:
            inspector = Inspector(header, toolpath, renderer, reference_bgr=recording.reference())
            for moment in recording.moments:
                check = inspector.check(recording.frame(moment), moment)
                told = check.to_json()["calibration_error_px"]
                if check.verdict == "failed":
                    failed = moment.layer
                    break
                suspect += check.verdict == "suspect"
                errors += [] if check.comparison is None else [check.comparison.error_ratio]
            found = inspector.camera(recording.moments[0])
    finally:
        selfcheck.CORRECTED_UNTIL = kept
    points_mm = seen_points_mm(toolpath, recording)
    return {
        "E": round(float(np.mean(errors)), 4), "failed": failed, "suspect": suspect, "told_px": told,
        "off_px": round(float(apart_px(found, true, points_mm).mean()), 2),
    }  # fmt: skip


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--shared", type=Path, default=ROOT.parent / "shared")
    options.add_argument("--off", default="1,2,3")
    options.add_argument("--seed", type=int, default=1)
    options.add_argument("--write", action="store_true")
    chosen = options.parse_args()
    rows = []
    for case in sorted((chosen.shared / "cases").glob("*/recording.json")):
        recording = Recording.open(case.parent)
        with recording.job_path() as path:
            toolpath = read_gcode(path)
        true, points_mm = recording.header.camera(), seen_points_mm(toolpath, recording)
        rows.append({"recording": case.parent.name, "off_px": 0, "with": replayed(recording, toolpath, true, True)})
        for off_px in map(float, chosen.off.split(",")):
            thought = nudged(true, off_px, chosen.seed, points_mm)
            row = {name: replayed(recording, toolpath, thought, name == "with") for name in ("without", "with")}
            rows.append({"recording": case.parent.name, "off_px": off_px, **row})
            print(json.dumps(rows[-1]), flush=True)
    if chosen.write:
        save("selfcheck", f"python -m benchmarks.selfcheck --off {chosen.off} --seed {chosen.seed}", "rendered", rows)
        put(ROOT / "docs" / "calibration.md", "selfcheck", as_table(rows))


def as_table(rows: list[dict[str, Any]]) -> str:
    head = ["recording", "camera off, px", "off once corrected", "E without", "E with", "failed at, without", "with"]
    return table(head, [
        [row["recording"], row["off_px"], row["with"]["off_px"], row.get("without", {}).get("E"), row["with"]["E"],
         row.get("without", {}).get("failed"), row["with"]["failed"]]
        for row in rows
    ])  # fmt: skip


if __name__ == "__main__":
    main()
