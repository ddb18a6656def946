"""Whole prints before the simulated webcam, each with its own camera, filament, light, nuisances and fault.

    python benchmarks/simulated.py [--prints 24] [--seed 0] [--gcode FILE …]

JSON on standard output. The pictures are SIMULATED: their figures compare versions of the code, they are no promise
for a printer. The camera that the checks are told of differs a little from the one that takes the pictures, as after
a calibration.
A fault counts as visible from the first layer in which the true masks with and without it differ by E >= 0.015.
"""

from __future__ import annotations

import argparse
import colorsys
import json
import sys
from collections import defaultdict
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np

from octoprint_moop.core.camera import BedMotion, Camera
from octoprint_moop.core.gcode import read_gcode
from octoprint_moop.core.header import Header, Moment, Printer
from octoprint_moop.core.inspection import Inspector
from octoprint_moop.core.toolpath import Toolpath
from octoprint_moop.demo.faults import KINDS, Fault
from octoprint_moop.demo.painter import Light
from octoprint_moop.demo.room import SURFACES
from octoprint_moop.demo.run import unpack_job
from octoprint_moop.demo.simulate import Nuisance, Scene
from octoprint_moop.machine.renderers import open_renderer

VISIBLE_RATIO = 0.015
MOST_LAYERS = 70
MODES = {
    "extrusion_stop": "extrusion_failure", "detachment": "detachment", "warping": "warping",
    "layer_shift": "layer_shift", "spaghetti": "stray_material",
}  # fmt: skip


@dataclass(frozen=True)
class Trial:
    """One print: the scene as it is, the same without its fault, and what the checks are told."""

    toolpath: Toolpath
    layers: int
    scene: Scene
    faultless: Scene
    header: Header
    fault: Fault | None
    about: dict[str, object]

    def moment(self, layer: int) -> Moment:
        position = (0.0, 200.0, float(self.toolpath.layer_z_mm[layer]))
        end = int(self.toolpath.layer_end_pos[layer])
        return Moment(f"{layer:06d}.jpg", end, layer, position, 30.0 * layer, parked=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--prints", type=int, default=24)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--gcode", type=Path, nargs="*", default=[])
    parser.add_argument("--each", action="store_true", help="Tell each print on standard error.")
    wanted = parser.parse_args()
    with TemporaryDirectory() as folder:
        jobs = [read_gcode(path) for path in (unpack_job(Path(folder)), *wanted.gcode)]
    results = []
    with open_renderer() as renderer:
        for number in range(wanted.prints):
            trial = make_trial(np.random.default_rng([wanted.seed, number]), jobs, number)
            results.append(run(trial, renderer))
            if wanted.each:
                print(json.dumps({"print": number, **trial.about, **results[-1]}), file=sys.stderr, flush=True)
    print(json.dumps(summary(results), indent=1))


def make_trial(rng: np.random.Generator, jobs: list[Toolpath], number: int) -> Trial:
    """Kinds of fault take turns, every third print has none."""
    toolpath = jobs[int(rng.integers(len(jobs)))]
    layers = min(toolpath.layers, MOST_LAYERS)
    bed = BedMotion("y", (0.0, 200.0, 0.0)) if rng.random() < 0.7 else BedMotion()
    camera = random_camera(rng, toolpath)
    kind = None if number % 3 == 2 else KINDS[(number - number // 3) % len(KINDS)]
    fault = None
    if kind is not None:
        onset = int(rng.integers(max(layers // 5, 2), max(2 * layers // 3, 3)))
        fault = Fault(kind, onset, strength=float(rng.uniform(0.7, 1.3)))
    hue, saturation, value = rng.random(), rng.choice([0.0, 0.6, 0.9], p=[0.2, 0.3, 0.5]), rng.uniform(0.35, 0.95)
    red, green, blue = colorsys.hsv_to_rgb(hue, saturation, value)
    light = Light(
        level=float(rng.uniform(0.6, 1.15)), drift_ratio=float(rng.uniform(0, 0.12)),
        noise_ratio=float(rng.uniform(0.008, 0.03)), jpeg_quality=int(rng.integers(70, 95)),
        towards=(float(rng.uniform(-0.8, 0.8)), float(rng.uniform(-0.8, 0.3)), 0.8),
    )  # fmt: skip
    nuisances = tuple(
        Nuisance(name, int(rng.integers(2, layers)), int(rng.integers(1, 3)) if name in ("hand", "black") else 10**6,
                 float(rng.uniform(0.2, 0.8)))
        for name in ("dim", "hand", "nudge", "white_balance", "black") if rng.random() < 0.2
    )  # fmt: skip
    look = {
        "material_bgr": (255 * blue, 255 * green, 255 * red), "light": light, "nuisances": nuisances,
        "seed": int(rng.integers(1 << 30)), "surface": str(rng.choice(SURFACES)),
    }  # fmt: skip
    told = replace(
        camera, rvec=camera.rvec + rng.normal(0, 0.0008, 3), tvec_mm=camera.tvec_mm + rng.normal(0, 0.15, 3),
    )  # fmt: skip
    return Trial(
        toolpath, layers,
        Scene(toolpath, camera, bed, faults=(fault,) if fault else (), **look),
        Scene(toolpath, camera, bed, **look),
        Header(Printer(250.0, 210.0, 210.0, bed=bed), ((None, told),), None), fault,
        {"fault": kind, "bgr": [round(c) for c in look["material_bgr"]], "surface": look["surface"],
         "bed": bed.kind, "nuisances": [f"{n.kind} {n.layer}" for n in nuisances]},
    )  # fmt: skip


def random_camera(rng: np.random.Generator, toolpath: Toolpath) -> Camera:
    """Before the bed, 20° to 55° above it, at a distance from which the print fills a good part of the picture."""
    labelled = toolpath.beads_mm[toolpath.layer_start[min(2, toolpath.layers - 1)] :, :3].astype(np.float64)
    low, high = labelled.min(axis=0), labelled.max(axis=0)
    target = (low + high) / 2
    size = max(float(np.linalg.norm(high - low)), 20.0)
    focal, azimuth, elevation = rng.uniform(550, 800), np.radians(rng.uniform(-50, 50)), np.radians(rng.uniform(20, 55))
    outward = np.array([np.sin(azimuth) * np.cos(elevation), -np.cos(azimuth) * np.cos(elevation), np.sin(elevation)])
    eye = target + outward * focal * size / rng.uniform(260, 420)
    ahead = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    camera_from_room = np.stack([right, np.cross(ahead, right), ahead])
    return Camera(
        (640, 480), np.array([[focal, 0.0, 319.5], [0.0, focal, 239.5], [0.0, 0.0, 1.0]]),
        np.array([rng.uniform(-0.2, 0.05), 0.04, 0.0, 0.0, 0.0]),
        cv2.Rodrigues(camera_from_room)[0].ravel(), -camera_from_room @ eye,
    )  # fmt: skip


def run(trial: Trial, renderer: object) -> dict[str, object]:
    """What came of one print, up to its first failed check and two layers of grace."""
    first = trial.moment(0)
    reference = decode(trial.scene.jpeg(0, first.position_mm))
    inspector = Inspector(trial.header, trial.toolpath, renderer, reference_bgr=reference)
    total = np.count_nonzero(trial.faultless.truth(trial.toolpath.bytes, first.position_mm))
    visible, failed, verdicts = None, None, []
    for layer in range(trial.layers):
        moment = trial.moment(layer)
        if visible is None and trial.fault is not None and layer >= trial.fault.layer:
            masks = (scene.truth(moment.file_pos, moment.position_mm) for scene in (trial.scene, trial.faultless))
            if np.count_nonzero(np.bitwise_xor(*masks)) >= VISIBLE_RATIO * total:
                visible = layer
        frame = decode(trial.scene.jpeg(moment.file_pos, moment.position_mm, layer))
        check = inspector.check(frame, moment)
        verdicts.append(check.verdict)
        if check.verdict == "failed":
            failed = check
            break
    return {
        "onset": trial.fault.layer if trial.fault else None, "visible": visible,
        "failed": failed.moment.layer if failed else None, "mode": failed.mode if failed else None,
        "kind": trial.fault.kind if trial.fault else None, "checks": len(verdicts),
        "verdicts": {name: verdicts.count(name) for name in sorted(set(verdicts))},
        "reason": failed.reason if failed else "",
    }  # fmt: skip


def decode(jpeg: bytes) -> np.ndarray:
    return cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)


def summary(results: list[dict[str, object]]) -> dict[str, object]:
    """False alarms over all checks before a fault's onset; for each kind of fault how many were seen, and how late."""
    clean_checks = false_alarms = 0
    kinds: dict[str, list[dict[str, object]]] = defaultdict(list)
    for result in results:
        onset, failed = result["onset"], result["failed"]
        good = result["checks"] if onset is None else min(result["checks"], onset)
        clean_checks += good
        early = failed is not None and (onset is None or failed < onset)
        false_alarms += early
        if onset is not None and not early and result["visible"] is not None:
            kinds[result["kind"]].append(result)
    table = {}
    for kind, rows in sorted(kinds.items()):
        seen = [row for row in rows if row["failed"] is not None]
        late = [row["failed"] - row["visible"] for row in seen]
        table[kind] = {
            "prints": len(rows), "seen": len(seen), "within_3_layers": sum(layers <= 3 for layers in late),
            "median_layers_late": float(np.median(late)) if late else None, "most_layers_late": max(late, default=None),
            "mode_right": sum(row["mode"] == MODES[kind] for row in seen),
        }  # fmt: skip
    return {"prints": len(results), "clean_checks": clean_checks, "false_alarms": false_alarms, "faults": table}


if __name__ == "__main__":
    main()
