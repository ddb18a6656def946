"""Recordings with truth, replayed: with the header's camera, and with lens and pose found from the calibration pictures.

    python benchmarks/cases.py [RECORDING ...]

Without a name, all of `../shared/cases`. Recordings are rendered, not photographed. Writes results/cases.json and the
table in docs/decision.md.
"""

from __future__ import annotations

import json
import os
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.detection import RIGHT_MODES
from benchmarks.tables import ROOT, put, save, table
from octoprint_moop.core.calibration.calibrate import calibrate_lens
from octoprint_moop.core.calibration.chessboard import Board
from octoprint_moop.core.calibration.markers import MarkerPlate
from octoprint_moop.core.calibration.pose import calibrate_pose_any_colour
from octoprint_moop.core.camera import Camera
from octoprint_moop.core.checks import Summary
from octoprint_moop.core.inspection import Inspector
from octoprint_moop.core.settings import SEGMENTATIONS, Settings
from octoprint_moop.machine.recording import Recording, read_frame
from octoprint_moop.machine.renderers import open_renderer

SHARED = Path(os.environ.get("MOOP_SHARED", ROOT.parent / "shared"))


def found_camera(folder: Path) -> Camera:
    """Lens and pose as the set-up finds them from the pictures in calib/. Raises CalibrationError."""
    board = json.loads((folder / "calib.json").read_text())
    columns, rows = board["inner_corners"]
    pictures = [(path.name, read_frame(path)) for path in sorted(folder.glob("checkerboard_*.jpg"))]
    lens = calibrate_lens(pictures, Board(columns, rows, board["square_mm"])).lens
    plate = MarkerPlate.from_json(json.loads((folder / "markers.json").read_text()))
    return calibrate_pose_any_colour(read_frame(folder / "markers.jpg"), lens, plate).camera


def replayed(folder: Path, camera: str, segmentation: str, renderer: Any) -> dict[str, Any]:
    recording, truth = Recording.open(folder), json.loads((folder / "truth.json").read_text())
    header, road = recording.header, recording.road()
    misfit_px = 0.0
    if camera == "calibrated":
        found, true = found_camera(folder / "calib"), header.camera()
        misfit_px = _apart_px(found, true, road.toolpath.beads_mm[::37, 3:6].astype(float))
        header = replace(header, cameras=((None, found),))
    settings = Settings(segmentation=segmentation)
    inspector = Inspector(header, road.toolpath, renderer, settings, recording.reference())
    checks = [inspector.check(recording.frame(moment), moment) for moment in recording.moments]
    summary, fault = Summary.of(checks), truth.get("fault")
    onset, visible = (fault["onset_layer"], fault["first_visible_layer"]) if fault else (None, None)
    failed = summary.first_failed_layer
    well = [check for check in checks if check.comparison is not None and (onset is None or check.moment.layer < onset)]
    caught = fault is not None and failed is not None and failed >= onset
    return {
        "recording": folder.name, "camera": camera, "segmentation": segmentation, "misfit_px": round(misfit_px, 2),
        "E_mean": round(float(np.mean([check.comparison.error_ratio for check in well])), 4),
        "fault": fault["kind"] if fault else None, "visible": visible, "failed": failed, "mode": summary.mode,
        "delay": max(0, failed - visible) if caught and visible is not None else None,
        "mode_right": caught and summary.mode in RIGHT_MODES.get(fault["kind"], {summary.mode}),
        "false_alarm": failed is not None and (fault is None or failed < onset),
        "reason": next((check.reason for check in checks if check.verdict == "failed"), ""), "checks": len(checks),
    }  # fmt: skip


def _apart_px(found: Camera, true: Camera, points_mm: np.ndarray) -> float:
    """Root mean square over those of the print's points that are in the picture, the bed at its reference."""
    here, there = true.project(points_mm), found.project(points_mm)
    seen = np.isfinite(here).all(axis=1) & (here > 0).all(axis=1) & (here < np.array(true.image_size_px)).all(axis=1)
    return float(np.sqrt(((here - there)[seen] ** 2).sum(axis=1).mean()))


def main() -> None:
    cv2.setNumThreads(1)
    folders = [Path(name) for name in sys.argv[1:]] or sorted(SHARED.glob("cases/*/truth.json"))
    folders = [folder.parent if folder.name == "truth.json" else folder for folder in folders]
    rows = []
    with open_renderer() as renderer:
        for folder in folders:
            cameras = ("header", "calibrated") if (folder / "calib" / "calib.json").is_file() else ("header",)
            for camera in cameras:
                for segmentation in SEGMENTATIONS:
                    rows.append(replayed(folder, camera, segmentation, renderer))
                    print(json.dumps(rows[-1]), flush=True)
    if len(sys.argv) == 1:
        save("cases", "python benchmarks/cases.py", "rendered", rows)
        write_table()


def write_table() -> None:
    rows = json.loads((ROOT / "benchmarks" / "results" / "cases.json").read_text())["figures"]
    put(ROOT / "docs" / "decision.md", "cases", as_table(rows))


def as_table(rows: list[dict[str, Any]]) -> str:
    head = [
        "recording",
        "camera",
        "its misfit, px",
        "segmentation",
        "mean E before any fault",
        "fault visible",
        "failed",
        "called",
        "false alarm",
    ]
    return table(head, [
        [row["recording"], row["camera"], row["misfit_px"], row["segmentation"], f"{row['E_mean']:.4f}", row["visible"], row["failed"],
         row["mode"], "yes" if row["false_alarm"] else "no"] for row in rows
    ])  # fmt: skip


if __name__ == "__main__":
    main()
