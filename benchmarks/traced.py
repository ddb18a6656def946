"""Held-out path-traced recordings, with truth: other printers, cameras, filaments, lights, beds, faults and nuisances.

    python benchmarks/traced.py make --first 0 --count 5 --out FOLDER        # makes FOLDER/NN-words, one for each seed
    python benchmarks/traced.py score FOLDER [--out benchmarks/results/traced.jsonl]
    python benchmarks/traced.py table [benchmarks/results/traced.jsonl]      # puts the table into docs/decision.md

Everything about a recording follows from its seed. `make` needs `pip install mitsuba` and PrusaSlicer; a seed whose folder is complete is left alone.
Known unrealisms: a fault's motion is made up, not simulated; boxes and rods for a printer; no depth of field.
"""

from __future__ import annotations

import argparse
import colorsys
import json
import os
import shutil
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.traced_score import RESULTS, scoring, tabling

HERE = Path(__file__).resolve().parent
SHARED = Path(os.environ.get("MOOP_SHARED", HERE.parents[1] / "shared"))
VISIBLE_E, VISIBLE_FRAMES = 0.015, 3
CYCLE = (
    "detachment", None, "layer_shift_small", "extrusion_stop", "spaghetti", None, "warping", "tip_over", "blob", None,
    "under_extrusion", "layer_shift_large", "spaghetti_first_layer", None, "detachment", "extrusion_stop",
)  # fmt: skip
NUISANCES = (
    "dimmed", "exposure", "white_balance", "hand", "nudge", "knock", "noise", "strings", "repeated", "black", "moving_light",
)  # fmt: skip
PRINTERS = (
    ("y", (250, 210, 210), False), ("y", (220, 220, 250), False), ("z", (256, 256, 256), False), ("fixed", (300, 300, 280), False),
    ("y", (180, 180, 180), False), ("fixed", (200, 200, 260), True), ("z", (220, 220, 220), False), ("y", (235, 235, 250), False),
)  # fmt: skip
ZOO = (
    "cura_3.6.0_calcube", "slic3r_multi", "dsf_simplify3d", "s3d_4.0.0_bamarillo", "superslicer_multi", "dsf_slic3r",
    "prusaslicer_2.6.1_benchy", "cura_multi",
)  # fmt: skip


@dataclass(frozen=True)
class Recipe:
    """What one seed makes."""

    seed: int
    fault: str | None
    nuisances: tuple[str, ...]
    filament: str
    bed: str
    light: str
    motion: str
    volume_mm: tuple[float, float, float]
    delta: bool
    parked: bool
    model: str
    misfit_px: float
    layer_mm: float

    @property
    def name(self) -> str:
        words = [
            f"{self.seed:03d}",
            self.fault or "good",
            self.filament,
            self.bed,
            self.light,
            self.motion,
            *self.nuisances,
        ]
        return "-".join(word.replace(" ", "_") for word in words)


def recipe(seed: int) -> Recipe:
    """Seeds that follow one another differ in everything: each list is walked in its own stride."""
    from benchmarks.traced_surfaces import BEDS, FILAMENTS, LIGHTS

    rng = np.random.default_rng([seed, 3])
    fault = CYCLE[seed % len(CYCLE)]
    names = tuple(FILAMENTS)
    count = int(rng.choice([0, 1, 2])) if fault else int(rng.choice([1, 2, 3]))
    motion, volume, delta = PRINTERS[seed * 3 % len(PRINTERS)]
    multi = seed % 3 == 2 or rng.random() < 0.2
    if seed % 5 == 3 and not delta and volume[0] >= 200:
        model = ZOO[seed // 5 % len(ZOO)]
        motion, volume = motion, (250, 210, 210) if volume[0] < 250 else volume
    else:
        kinds = ("star", "tower", "plate", "bracket", "arch", "tee", "dome", "cross", "stairs", "puck")
        small = [k for k in kinds if k != "plate"]
        model = "+".join(rng.choice(small, int(rng.integers(2, 5)), replace=False)) if multi else str(rng.choice(kinds))
        if fault == "tip_over" and not multi:
            model = "tower"
    return Recipe(
        seed, fault, tuple(sorted(str(n) for n in rng.choice(NUISANCES, count, replace=False))), names[seed * 5 % len(names)],
        BEDS[seed * 3 % len(BEDS)], LIGHTS[seed * 2 % len(LIGHTS)], motion, volume, delta, bool(rng.random() < 0.75),
        model, float(rng.choice([0.0, 0.5, 1.2], p=[0.5, 0.3, 0.2])), float(rng.choice([0.28, 0.32, 0.4])),
    )  # fmt: skip


def aim(look: object, low: np.ndarray, high: np.ndarray, head_in_view: bool, rng: np.random.Generator) -> object:
    """A camera that looks at this print from somewhere in front, as people mount them."""
    from benchmarks.traced_scene import Eye

    size = (640, 480)
    focal = 480 + 220 * rng.random()
    strength = rng.random()
    distortion = np.array([-0.28 * strength, 0.08 * strength, rng.normal(0, 4e-4), rng.normal(0, 4e-4), 0.0])
    middle, extent = (low + high) / 2, float(np.linalg.norm(high - low))
    share = 0.32 + 0.22 * rng.random()
    distance = max(extent * focal / (share * size[0]), 120.0)
    azimuth, height = np.radians(-90 + rng.uniform(-55, 55)), np.radians(rng.uniform(16, 48))
    if head_in_view:  # from below the head's side, where people put such a camera
        azimuth, height = np.radians(-90 + rng.choice([-1, 1]) * rng.uniform(35, 75)), np.radians(rng.uniform(10, 26))
    centre = middle + distance * np.array(
        [np.cos(height) * np.cos(azimuth), np.cos(height) * np.sin(azimuth), np.sin(height)]
    )
    target = middle + rng.normal(0, extent * 0.05, 3)
    ahead = (target - centre) / np.linalg.norm(target - centre)
    right = np.cross(ahead, [0, 0, 1])
    right /= np.linalg.norm(right)
    roll = rng.normal(0, 0.03)
    down = np.cross(ahead, right)
    right, down = right * np.cos(roll) + down * np.sin(roll), down * np.cos(roll) - right * np.sin(roll)
    rotation = np.stack([right, down, ahead])
    K = np.array(
        [[focal, 0, size[0] / 2 - 0.5 + rng.normal(0, 5)], [0, focal, size[1] / 2 - 0.5 + rng.normal(0, 5)], [0, 0, 1]]
    )
    return Eye(size, K, distortion, rotation, -rotation @ centre)


def misfitted(eye: object, box: np.ndarray, rms_px: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """rvec and tvec that are wrong by so many pixels over the corners of the print."""
    rvec = cv2.Rodrigues(eye.rotation)[0].ravel()
    turn, step = rng.normal(0, 0.002, 3), rng.normal(0, 0.6, 3)

    def seen(k: float) -> np.ndarray:
        return cv2.projectPoints(box, rvec + k * turn, eye.tvec_mm + k * step, eye.K, eye.distortion)[0][:, 0]

    unit = np.sqrt(((seen(1) - seen(0)) ** 2).sum(axis=1).mean())
    return rvec + rms_px / unit * turn, eye.tvec_mm + rms_px / unit * step


def thresholds(frame_bgr: np.ndarray, matter: np.ndarray) -> dict:
    """What a careful user would pick on a picture: most of the filament's pixels lie within."""
    colours = frame_bgr[cv2.erode(matter.astype(np.uint8), np.ones((3, 3))) > 0][::7, ::-1] / 255.0
    if len(colours) < 20:
        return {"hue_deg": [0, 360], "saturation_min": 0.0, "value_min": 0.5}
    hsv = np.array([colorsys.rgb_to_hsv(*c) for c in colours])
    angle = hsv[:, 0] * 2 * np.pi
    centre = np.arctan2((np.sin(angle) * hsv[:, 1]).sum(), (np.cos(angle) * hsv[:, 1]).sum())
    off = np.degrees(np.angle(np.exp(1j * (angle - centre))))
    low, high = np.percentile(off, [3, 97]) + np.degrees(centre)
    grey = np.median(hsv[:, 1]) < 0.2
    hue = [0, 360] if grey else [round(float(low) % 360), round(float(high) % 360)]
    return {
        "hue_deg": hue, "saturation_min": 0.0 if grey else round(min(float(np.percentile(hsv[:, 1], 5)), 0.9), 2),
        "value_min": round(float(np.percentile(hsv[:, 2], 5)), 2),
    }  # fmt: skip


class Nuisances:
    """When and how much, for each nuisance of a recipe."""

    def __init__(self, names: tuple[str, ...], frames: int, seed: int) -> None:
        rng = np.random.default_rng([seed, 8])
        self.names, self.said = names, []
        at = {name: int(rng.integers(3, max(4, frames - 5))) for name in NUISANCES}
        draws = {name: rng.random(4) for name in NUISANCES}
        self.dim_from = at["dimmed"] if "dimmed" in names else None
        self.dim = 0.35 + 0.35 * draws["dimmed"][0]
        self.drift = draws["exposure"] if "exposure" in names else None
        self.warm = draws["white_balance"] if "white_balance" in names else None
        self.light = draws["moving_light"] if "moving_light" in names else None
        self.hand = {at["hand"], at["hand"] + (draws["hand"][0] < 0.5)} if "hand" in names else set()
        self.repeated = {at["repeated"], at["repeated"] + 1} if "repeated" in names else set()
        self.black = {at["black"]} if "black" in names else set()
        self.noise = 1.8 if "noise" in names else 1.0
        self.quality = int(38 + 20 * draws["noise"][0]) if "noise" in names else int(72 + 20 * draws["noise"][1])
        self.strings = int(8 + 25 * draws["strings"][0]) if "strings" in names else 0
        self.turn_from, self.turn_px = None, 0.0
        for name, low, high in (("nudge", 2, 7), ("knock", 12, 30)):
            if name in names:
                self.turn_from, self.turn_px = at[name], low + (high - low) * draws[name][0]
                self.turn_way = draws[name][1] * 2 * np.pi
                self.said.append(f"camera turned by about {round(self.turn_px)} px from layer {at[name]}")
        for name in names:
            if name not in ("nudge", "knock"):
                when = f" at layer {at[name]}" if name in ("dimmed", "hand", "repeated", "black") else ""
                self.said.append(f"{name.replace('_', ' ')}{when}")

    def eye(self, eye: object, number: int) -> object:
        if self.turn_from is None or number < self.turn_from:
            return eye
        angle = self.turn_px / eye.K[0, 0]
        return eye.turned(angle * np.array([np.sin(self.turn_way), np.cos(self.turn_way), 0.1]))

    def exposure(self, number: int) -> float:
        return (
            1.0 if self.drift is None else float(1 + 0.3 * np.sin(number / (4 + 8 * self.drift[0]) + 6 * self.drift[1]))
        )

    def warmth(self, number: int) -> float:
        return 0.0 if self.warm is None else float(0.14 * np.sin(number / (4 + 8 * self.warm[0]) + 6 * self.warm[1]))

    def lamps(self, number: int) -> tuple[float, float]:
        key = self.dim if self.dim_from is not None and number >= self.dim_from else 1.0
        ambient = 0.6 + 0.4 * key
        if self.light is not None:  # the sun comes and goes behind clouds
            key *= float(0.65 + 0.35 * np.sin(number / (2.5 + 4 * self.light[0]) + 6 * self.light[1]))
        return key, ambient


def make(seed: int, out: Path, frames_limit: int = 36, every: int = 1) -> Path:
    from benchmarks.traced_models import sliced
    from benchmarks.traced_print import Fault, Growth, read_beads
    from benchmarks.traced_scene import Studio
    from benchmarks.traced_sensor import Sensor
    from benchmarks.traced_surfaces import Look

    plan = recipe(seed)
    folder = out / plan.name
    if (folder / "truth.json").is_file():
        return folder
    began_s, cpu_s = time.time(), time.process_time()
    rng = np.random.default_rng([seed, 4])
    shutil.rmtree(folder, ignore_errors=True)
    (folder / "frames").mkdir(parents=True)
    w, d, h = plan.volume_mm
    bed_low = np.array([-w / 2, -d / 2]) if plan.delta else np.zeros(2)
    centre = bed_low + np.array([w, d]) / 2 + rng.normal(0, 12, 2)
    job = folder / "job.gcode"
    if plan.model in ZOO:
        shutil.copy(SHARED / "data" / "gcode-zoo" / f"{plan.model}.gcode", job)
    else:
        sliced(job, plan.model.split("+"), (round(centre[0], 1), round(centre[1], 1)), plan.layer_mm, rng)
    beads = read_beads(job)
    body = beads.ends_mm[beads.layer >= min(2, beads.layers - 1)].reshape(-1, 3)
    low, high = np.append(body[:, :2].min(0), 0.0), body.max(0)
    count = min(beads.layers, frames_limit)
    fault, object_id = None, None
    if plan.fault:
        onset = 1 if plan.fault == "spaghetti_first_layer" else int(rng.integers(5, max(6, min(count - 8, 14))))
        count = min(count, onset + 11)
        if len(beads.objects) > 1 and not plan.fault.startswith(("layer_shift", "extrusion", "under")):
            alive = [k for k in range(len(beads.objects)) if beads.layer[beads.object_id == k].max() >= onset + 3]
            object_id = int(rng.choice(alive))
        fault = Fault(plan.fault, onset, object_id, float(rng.choice([0.7, 1.0, 1.4])), seed)
    trouble = Nuisances(plan.nuisances, count, seed)
    growth = Growth(beads, fault, trouble.strings, seed)
    seen_high = high.copy()
    seen_high[2] = min(high[2], float(beads.ends_mm[beads.layer == count - 1][..., 2].max()) * 1.6)
    if plan.motion == "y":
        park = (0.0, d - 10.0, None)
        reference = (0.0, d - 10.0, 0.0) if plan.parked else (0.0, float((low + high)[1] / 2), 0.0)
    else:
        park = (float(bed_low[0]), float(bed_low[1] + d - 5), None)
        reference = (*park[:2], 0.0)
    look = Look(
        plan.filament, plan.bed, plan.light, plan.motion, plan.volume_mm, plan.delta, reference, seed, plan.delta
    )
    frame_low, frame_high = low.copy(), seen_high.copy()
    if plan.motion == "z":  # the top stays at the nozzle's height, the bed sinks
        frame_low[2], frame_high[2] = -seen_high[2], 4.0
    eye = aim(look, frame_low, frame_high, not plan.parked, rng)
    studio = Studio(look, eye)
    sensor = Sensor(seed, trouble.noise * (2.2 if plan.light == "dim" else 1.0), trouble.quality)

    def nozzle_room(position: tuple) -> np.ndarray:
        x, y, z = position
        return np.array([x, reference[1] if plan.motion == "y" else y, reference[2] if plan.motion == "z" else z])

    def save(picture: np.ndarray, name: str) -> None:
        cv2.imwrite(str(folder / name), picture, [cv2.IMWRITE_JPEG_QUALITY, trouble.quality])

    top = float(beads.ends_mm[beads.layer_end(count - 1), 1, 2])
    lastly = (park[0], park[1] if plan.parked else reference[1], top + 0.4)
    empty_at = (reference[0], reference[1], 12.0) if plan.motion != "z" else reference
    empty_nozzle = nozzle_room((park[0], park[1] if plan.motion != "y" else reference[1], 12.0))
    rgb, _ = studio.picture(None, empty_at if plan.motion != "z" else reference, empty_nozzle, 1000 + seed)
    complete = growth.clean(count - 1)
    sensor.meter(rgb, *studio.picture(complete, lastly, nozzle_room(lastly), 2000 + seed))
    save(sensor.develop(rgb, -1), "reference.jpg")
    lines, truths, totals, time_s, material = [], [], {}, 40.0, None
    lengths = np.linalg.norm(np.diff(beads.ends_mm, axis=1)[:, 0], axis=1)
    previous, scene_before = None, None
    for number in range(every - 1, count, every):
        last = beads.layer_end(number)
        time_s += float(lengths[beads.layer == number].sum()) / 45 + 4
        z = float(beads.ends_mm[last, 1, 2])
        position = (
            (park[0], park[1], round(z + 0.4, 3))
            if plan.parked
            else tuple(float(v) for v in beads.ends_mm[last, 1].round(3))
        )
        at_eye = trouble.eye(eye, number)
        key, ambient = trouble.lamps(number)
        matter = growth.actual(number)
        hand = (low + high) / 2 * [1, 1, 0] + [0, 0, z] if number in trouble.hand else None
        scene_now = (at_eye is eye, key, tuple(look.shift_mm(position)), hand is None or number)
        window = None
        if plan.parked and scene_now == scene_before and number % 5:  # what stands still need not be traced anew
            window = studio.window(matter, position, at_eye)
        scene_before = scene_now
        rgb, seen = studio.picture(
            matter,
            position,
            nozzle_room(position),
            seed * 1000 + number,
            eye=at_eye,
            key=key,
            ambient=ambient,
            hand_mm=hand,
            window=window,
        )
        mask = studio.mask(matter, position, at_eye)
        clean = mask
        if (fault and number >= fault.onset) or trouble.strings:
            clean = studio.mask(growth.clean(number), position, at_eye)
        where = (
            tuple(look.shift_mm(position)),
            number >= trouble.turn_from if trouble.turn_from is not None else False,
        )
        if where not in totals:
            totals[where] = int(studio.mask(growth.clean(None), position, at_eye).sum())
        name = f"frames/{number:06d}"
        frame = sensor.develop(rgb, number, exposure=trouble.exposure(number), warmth=trouble.warmth(number))
        if number in trouble.black:
            frame = (sensor.develop(rgb * 0.0, number) * 0.6).astype(np.uint8)
        if number in trouble.repeated and previous:
            shutil.copy(folder / previous, folder / f"{name}.jpg")
        else:
            save(frame, f"{name}.jpg")
        previous = f"{name}.jpg"
        cv2.imwrite(str(folder / f"{name}.mask.png"), mask.astype(np.uint8) * 255)
        hidden = int((mask & ~seen).sum())
        if hidden:
            cv2.imwrite(str(folder / f"{name}.visible.png"), seen.astype(np.uint8) * 255)
        if material is None and number >= min(4, count - 1):
            material = thresholds(frame, seen)
        lines.append({
            "frame": f"{name}.jpg", "file_pos": int(beads.file_pos[last]), "layer": number,
            "position_mm": dict(zip("xyz", position)), "time_s": round(time_s, 1), "parked": plan.parked,
        })  # fmt: skip
        xor = int((mask != clean).sum())
        truths.append({
            "layer": number, "expected_px": int(clean.sum()), "actual_px": int(mask.sum()), "xor_px": xor, "total_px": totals[where],
            "E": round(xor / max(totals[where], 1), 5), "occluded_px": hidden,
        })  # fmt: skip
    box = (
        np.array([[x, y, zz] for x in (low[0], high[0]) for y in (low[1], high[1]) for zz in (0.0, high[2])])
        + look.shift_mm((*park[:2], 0.0)) * plan.parked
    )
    rvec, tvec = misfitted(eye, box, plan.misfit_px, np.random.default_rng([seed, 12]))
    header = {
        "format": "moop-recording", "version": 1, "job": {"file": "job.gcode", "bytes": job.stat().st_size},
        "printer": {
            "volume_mm": dict(zip(("width", "depth", "height"), plan.volume_mm)), "origin": "center" if plan.delta else "lowerleft",
            "form_factor": "circular" if plan.delta else "rectangular", "bed_motion": plan.motion,
            "bed_reference_mm": dict(zip("xyz", reference)), "nozzle_mm": 0.6 if plan.layer_mm > 0.33 else 0.4, "filament_mm": 1.75,
        },
        "camera": {
            "image_size_px": list(eye.size), "K": eye.K.tolist(), "distortion": eye.distortion.tolist(),
            "rvec": rvec.tolist(), "tvec_mm": tvec.tolist(),
        },
        "material": material,
    }  # fmt: skip
    (folder / "recording.json").write_text(json.dumps(header, indent=1))
    (folder / "frames.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    told = None
    if fault:
        steady = [
            min(t["E"] for t in truths[n : n + VISIBLE_FRAMES]) >= VISIBLE_E
            for n in range(len(truths) - VISIBLE_FRAMES + 1)
        ]
        visible = next(
            (truths[n]["layer"] for n in range(len(steady)) if truths[n]["layer"] >= fault.onset and steady[n]), None
        )
        told = {
            "kind": fault.kind, "object": beads.objects[object_id] if object_id is not None else None, "onset_layer": fault.onset,
            "first_visible_layer": visible, "description": f"{fault.kind} of size {fault.size}",
        }  # fmt: skip
    truth = {
        "fault": told, "nuisance": trouble.said, "objects": list(beads.objects), "layers": beads.layers, "seed": seed,
        "about": plan.name, "recipe": asdict(plan), "per_frame": truths,
    }  # fmt: skip
    (folder / "truth.json").write_text(json.dumps(truth))
    print(
        f"{plan.name}: {count} frames, {time.time() - began_s:.0f} s, {time.process_time() - cpu_s:.0f} s of CPU",
        flush=True,
    )
    return folder


def making(arguments: argparse.Namespace) -> None:
    cv2.setNumThreads(1)
    for seed in range(arguments.first, arguments.first + arguments.count):
        make(seed, arguments.out, arguments.frames, arguments.every)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(required=True)
    making_them = commands.add_parser("make")
    making_them.add_argument("--first", type=int, default=0)
    making_them.add_argument("--count", type=int, default=1)
    making_them.add_argument("--frames", type=int, default=36)
    making_them.add_argument(
        "--every", type=int, default=1, help="picture each so many-th layer only, for a quick look"
    )
    making_them.add_argument("--out", type=Path, required=True)
    making_them.set_defaults(act=making)
    scoring_them = commands.add_parser("score")
    scoring_them.add_argument("folder", type=Path)
    scoring_them.add_argument("--out", type=Path, default=RESULTS)
    scoring_them.set_defaults(act=scoring)
    showing = commands.add_parser("table")
    showing.add_argument("results", type=Path, nargs="?", default=RESULTS)
    showing.set_defaults(act=tabling)
    arguments = parser.parse_args()
    arguments.act(arguments)


if __name__ == "__main__":
    main()
