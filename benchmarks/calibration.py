"""How well lens and pose are found. JSON on standard output; `--write` keeps it, and puts the drawn cameras' table into the document.

    python -m benchmarks.calibration [--cameras 210] [--shared ../shared] [--write]

Drawn: random cameras and plates of which everything is known (`tests/drawn.py`), a sixth of them for each condition.
Rendered: the path-traced pictures of the shared recordings. Beside each pose: the naive method, which takes an
ellipse's centre for the circle's.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.tables import ROOT, put, save, table
from octoprint_moop.core.calibration.assign import assignments
from octoprint_moop.core.calibration.calibrate import Lens, calibrate_lens, lens_difference_px
from octoprint_moop.core.calibration.chessboard import Board
from octoprint_moop.core.calibration.markers import MarkerPlate, find_discs
from octoprint_moop.core.calibration.plate import bed_middle_mm
from octoprint_moop.core.calibration.pose import calibrate_pose
from octoprint_moop.core.camera import Camera
from octoprint_moop.core.errors import CalibrationError
from octoprint_moop.core.header import Header
from octoprint_moop.core.segmentation.segment import HsvThresholds
from tests.drawn import CONDITIONS, random_scene, volume_error_px

_WRONG_PX = 3.0


def naive_pose(image: np.ndarray, lens: Lens, plate: MarkerPlate, colour: HsvThresholds) -> Camera | None:
    """The ellipses' centres taken for the circles', the assignment being ours."""
    discs = find_discs(image, colour)
    guesses = assignments(discs, plate, lens)
    if not guesses or len(guesses[0].pairs) < 4:
        return None
    markers, chosen = zip(*guesses[0].pairs)
    rays = lens.rays(np.array([discs[disc].centre_px for disc in chosen]))
    points_mm = plate.tops_mm()[list(markers)]
    found, rvec, tvec = cv2.solvePnP(points_mm, rays, np.eye(3), None, flags=cv2.SOLVEPNP_ITERATIVE)
    return lens.at(rvec, tvec) if found else None


def drawn(cameras: int, seed: int) -> dict[str, Any]:
    rng = np.random.default_rng(seed)
    rows = []
    for number in range(cameras):
        scene = random_scene(rng, CONDITIONS[number % len(CONDITIONS)])
        lens = Lens.of(scene.camera)
        bed_mm = (scene.printer.width_mm, scene.printer.depth_mm)
        corner_mm = bed_middle_mm(scene.printer) - np.array(bed_mm) / 2
        row: dict[str, Any] = {"condition": CONDITIONS[number % len(CONDITIONS)]}
        started = time.perf_counter()
        try:
            result = calibrate_pose(scene.image, lens, scene.plate, scene.colour)
            error_px = volume_error_px(result.camera, scene.camera, bed_mm, corner_mm=corner_mm)
            row.update(mean_px=float(error_px.mean()), max_px=float(error_px.max()), said_px=result.error_px[0],
                       found=sum(px is not None for px in result.markers_px))  # fmt: skip
        except CalibrationError as refusal:
            row["refused"] = str(refusal)
        row["seconds"] = time.perf_counter() - started
        naive = naive_pose(scene.image, lens, scene.plate, scene.colour)
        if naive is not None:
            row["naive_px"] = float(volume_error_px(naive, scene.camera, bed_mm, corner_mm=corner_mm).mean())
        rows.append(row)
    report: dict[str, Any] = {"cameras": cameras, "seed": seed, "all": _summary(rows)}
    for name in CONDITIONS:
        report[name] = _summary([row for row in rows if row["condition"] == name])
    return report


def _summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    solved = [row for row in rows if "max_px" in row]

    def quantiles(key: str) -> list[float] | None:
        values = [row[key] for row in rows if key in row]
        return [round(float(v), 3) for v in np.quantile(values, [0.5, 0.9, 0.99, 1.0])] if values else None

    return {
        "cameras": len(rows), "solved": len(solved), "refused": len(rows) - len(solved),
        "reasons": sorted({row["refused"][:90] for row in rows if "refused" in row}),
        "all_four_found": sum(row["found"] == 4 for row in solved),
        "wrong (max > 3 px)": sum(row["max_px"] > _WRONG_PX for row in solved),
        "max below 1 px": sum(row["max_px"] < 1 for row in solved),
        "mean_px p50 p90 p99 max": quantiles("mean_px"), "max_px p50 p90 p99 max": quantiles("max_px"),
        "naive mean_px p50 p90 p99 max": quantiles("naive_px"), "seconds p50 p90 p99 max": quantiles("seconds"),
        "true over said error p50 p90": [round(float(v), 2) for v in np.quantile(
            [row["mean_px"] / row["said_px"] for row in solved], [0.5, 0.9])] if solved else None,
    }  # fmt: skip


def rendered(case: Path) -> dict[str, Any]:
    header = Header.from_json(json.loads((case / "recording.json").read_text()))
    true = header.camera()
    told = json.loads((case / "calib" / "calib.json").read_text())
    images = [(path.name, cv2.imread(str(path))) for path in sorted((case / "calib").glob("checkerboard_*.jpg"))]
    found = calibrate_lens(images, Board(*told["inner_corners"], told["square_mm"]))
    plate = MarkerPlate.from_json(json.loads((case / "calib" / "markers.json").read_text()))
    picture = cv2.imread(str(case / "calib" / "markers.jpg"))
    report: dict[str, Any] = {
        "lens": {
            "order": found.order, "rms_px": round(found.rms_px, 4), "said_px": np.round(found.error_px, 3).tolist(),
            "true_px mean max": _mean_max(lens_difference_px(found.lens, Lens.of(true))),
            "true_px with rotation mean max": _mean_max(lens_difference_px(found.lens, Lens.of(true), False)),
        }
    }  # fmt: skip
    bed_mm = (header.printer.width_mm, header.printer.depth_mm)
    for name, lens in (("true lens", Lens.of(true)), ("calibrated lens", found.lens)):
        result = calibrate_pose(picture, lens, plate, header.material)
        naive = naive_pose(picture, lens, plate, header.material)
        report[f"pose with the {name}"] = {
            "rms_px": round(result.rms_px, 3), "said_px": np.round(result.error_px, 3).tolist(),
            "true_px mean max": _mean_max(volume_error_px(result.camera, true, bed_mm)),
            "nearer than 60 mm too": _mean_max(volume_error_px(result.camera, true, bed_mm, 0.0)),
            "naive_px mean max": naive and _mean_max(volume_error_px(naive, true, bed_mm)),
        }  # fmt: skip
    return report


def _mean_max(error_px: np.ndarray) -> list[float]:
    return [round(float(error_px.mean()), 3), round(float(error_px.max()), 3)]


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--cameras", type=int, default=210)
    options.add_argument("--seed", type=int, default=4)
    options.add_argument("--shared", type=Path, default=Path(__file__).resolve().parents[2] / "shared")
    options.add_argument("--write", action="store_true")
    chosen = options.parse_args()
    report: dict[str, Any] = {"drawn": drawn(chosen.cameras, chosen.seed)} if chosen.cameras else {}
    cases = sorted((chosen.shared / "cases").glob("*/recording.json"))
    report["rendered"] = {case.parent.name: rendered(case.parent) for case in cases}
    print(json.dumps(report, indent=1))
    if chosen.write:
        command = f"python -m benchmarks.calibration --cameras {chosen.cameras} --seed {chosen.seed} --write"
        save("calibration", command, "rendered and drawn", report)
        put(ROOT / "docs" / "calibration.md", "calibration-rendered", rendered_table(report["rendered"]))
        if chosen.cameras:
            put(ROOT / "docs" / "calibration.md", "calibration-drawn", drawn_table(report["drawn"]))


def rendered_table(report: dict[str, Any]) -> str:
    head = ["recording", "lens", "pose, true lens", "pose, calibrated lens", "naive, calibrated lens"]
    lines, poses = [], []
    for name, one in report.items():
        known, found = one["pose with the true lens"], one["pose with the calibrated lens"]
        pairs = (
            one["lens"]["true_px mean max"], known["true_px mean max"], found["true_px mean max"], found["naive_px mean max"],
        )  # fmt: skip
        lines.append([name, *(f"{mean:.2f} / {most:.2f}" for mean, most in pairs)])
        poses.append(found["nearer than 60 mm too"][1])
    turned = [one["lens"]["true_px with rotation mean max"] for one in report.values()]
    means = [mean for mean, _ in turned]
    return (
        f"{table(head, lines)}\n\nPoints nearer to the lens than 60 mm included, the worst is {max(poses):.1f} px. The lens's error "
        f"with that common rotation left in: mean {min(means):.2f} to {max(means):.2f} px, at worst "
        f"{max(most for _, most in turned):.2f} px."
    )


def drawn_table(report: dict[str, Any]) -> str:
    head = [
        "condition",
        "cameras",
        "solved",
        "refused",
        "max > 3 px",
        "max < 1 px",
        "mean px: median, 90 %, worst",
        "naive, median",
    ]
    rows = []
    for name in ("all", *CONDITIONS):
        one = report[name]
        median, most, _, worst = one["mean_px p50 p90 p99 max"]
        naive = one["naive mean_px p50 p90 p99 max"]
        rows.append([
            name, one["cameras"], one["solved"], one["refused"], one["wrong (max > 3 px)"], one["max below 1 px"],
            f"{median:.2f}, {most:.2f}, {worst:.2f}", naive and round(naive[0], 2),
        ])  # fmt: skip
    everything = report["all"]
    ratio, seconds = everything["true over said error p50 p90"], everything["seconds p50 p90 p99 max"]
    return (
        f"{table(head, rows)}\n\nThe true error is {ratio[0]} times the told one in the median, {ratio[1]} times at the 90th percentile. "
        f"A pose takes {seconds[0]:.1f} s in the median, {seconds[1]:.1f} s at the 90th percentile, {seconds[3]:.1f} s at worst."
    )


if __name__ == "__main__":
    main()
