"""How many failures are caught, how late, rightly named, and how often there is a false alarm.

    python benchmarks/detection.py run --kind composited --first 0 --runs 200 [--out benchmarks/results/detection.jsonl]
    python benchmarks/detection.py table [benchmarks/results/detection.jsonl]

`composited` puts faults and nuisances into the rendered recordings of `../shared/cases` (composited.py), `simulated`
draws them with the demo's simulated webcam; `mixed` puts them into prints that this webcam painted at 480x360, and `clean`
only nuisances, at 320x240, into half of the runs: each painted print serves VARIANTS runs, on beds that move and with the head in view
too. A run is drawn from its seed alone and written as one line of JSON, so that a benchmark that was
stopped goes on where it was. The calibration handed to the check is wrong by up to 3 px in half of the runs.

Three older rules look at the very same frames:
    jump        Lyngby et al. 2017: E rises by more than 0.02 from one layer to the next
    blobs       after Baumann and Roller 2016: the largest spot that differs from the frame before, by brightness
    finished    after Straub 2015: share of the print's window that differs from a good print's frame of that layer
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import sys
import time
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.composited import FAULTS, FIRST_LAYER_FAULTS, NUISANCES, Base, Story
from benchmarks.painted import PaintedStory
from octoprint_moop.core.camera import Camera
from octoprint_moop.core.checks import Check
from octoprint_moop.core.decision.course import Courses
from octoprint_moop.core.decision.decide import CAMERA_MOVED, FAILED, SUSPECT, UNUSABLE
from octoprint_moop.core.inspection import Inspector
from octoprint_moop.core.toolpath import Toolpath
from octoprint_moop.machine.renderers import open_renderer

HERE = Path(__file__).resolve().parent
SHARED = Path(os.environ.get("MOOP_SHARED", HERE.parents[1] / "shared"))
KINDS = ("composited", "simulated", "mixed", "clean")
RESULTS = HERE / "results" / "detection.jsonl"
VISIBLE_E, VISIBLE_FRAMES = 0.015, 3
VARIANTS = 6
SMALL_PX = {"clean": (320, 240), "mixed": (480, 360)}
RULES = ("moop", "jump", "blobs", "finished")
RIGHT_MODES = {
    "extrusion": {"extrusion_failure"}, "under_extrusion": {"extrusion_failure"}, "detachment": {"detachment"},
    "tip_over": {"detachment"}, "layer_shift": {"layer_shift"}, "warping": {"warping"},
    "nothing": {"extrusion_failure"}, "one_missing": {"extrusion_failure", "detachment"},
    "dragged": {"extrusion_failure", "stray_material", "detachment"},
    "spaghetti": {"stray_material", "detachment"}, "sagging": {"stray_material"}, "blob": {"stray_material"},
}  # fmt: skip


def misfit(camera: Camera, toolpath: Toolpath, rng: np.random.Generator, rms_px: float) -> Camera:
    """The camera with a pose that is wrong by `rms_px` over the corners of the print's box."""
    low, high = toolpath.bounds_mm()
    box = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (0.0, high[2])])
    turn, step = rng.normal(0, 0.002, 3), rng.normal(0, 0.6, 3)

    def wrong(size: float) -> Camera:
        return replace(camera, rvec=camera.rvec + size * turn, tvec_mm=camera.tvec_mm + size * step)

    return wrong(rms_px / np.sqrt(((wrong(1).project(box) - camera.project(box)) ** 2).sum(axis=1).mean()))


@dataclass(eq=False)
class Rivals:
    """The older rules' alarms: the first number of a frame for each."""

    window: tuple[slice, slice]
    alarms: dict[str, int] = field(default_factory=dict)
    _error_ratio: float | None = None
    _previous: np.ndarray | None = None

    def look(self, number: int, frame_bgr: np.ndarray, check: Check, finished_bgr: np.ndarray | None) -> None:
        grey = cv2.GaussianBlur(cv2.cvtColor(frame_bgr, cv2.COLOR_BGR2GRAY)[self.window], (5, 5), 0)
        if check.comparison is not None:
            error_ratio = check.comparison.error_ratio
            if self._error_ratio is not None and error_ratio - self._error_ratio > 0.02:
                self.alarms.setdefault("jump", number)
            self._error_ratio = error_ratio
        if self._previous is not None:
            changed = (cv2.absdiff(grey, self._previous) > 25).astype(np.uint8)
            _, _, stats, _ = cv2.connectedComponentsWithStats(
                cv2.morphologyEx(changed, cv2.MORPH_OPEN, np.ones((3, 3)))
            )
            if len(stats) > 1 and stats[1:, cv2.CC_STAT_AREA].max() > 150:
                self.alarms.setdefault("blobs", number)
        self._previous = grey
        if finished_bgr is not None:
            other = cv2.GaussianBlur(cv2.cvtColor(finished_bgr, cv2.COLOR_BGR2GRAY)[self.window], (5, 5), 0)
            if (cv2.absdiff(grey, other) > 25).mean() > 0.01:
                self.alarms.setdefault("finished", number)


def composited_story(seed: int, bases: list[Base], rng: np.random.Generator) -> Story:
    base = bases[rng.integers(len(bases))]
    fault = None if rng.random() < 0.3 else str(rng.choice(FAULTS))
    count = int(rng.choice([0, 0, 1, 1, 2]))
    nuisances = tuple(str(n) for n in rng.choice(NUISANCES, size=count, replace=False))
    return Story(base, seed, fault, nuisances, float(rng.choice([0.6, 1.0, 1.5])))


def drawn_story(kind: str, seed: int, bases: list[Base], rng: np.random.Generator) -> Story | PaintedStory:
    if kind == "composited":
        return composited_story(seed, bases, rng)
    if kind == "simulated":
        return PaintedStory.drawn(seed, rng, SHARED / "data" / "gcode-zoo")
    base = painted_base(seed // VARIANTS, still=kind == "mixed")
    count = 0 if seed % 2 else int(rng.choice([1, 1, 2]))
    fitting = [one for one in NUISANCES if kind == "clean" or one != "nudge"]
    nuisances = tuple(str(one) for one in rng.choice(fitting, size=count, replace=False))
    fault = None
    if kind == "mixed":
        fault = str(rng.choice(FIRST_LAYER_FAULTS if rng.random() < 0.2 else FAULTS))
    return Story(base, seed, fault, nuisances, float(rng.choice([0.25, 0.5, 1.0, 1.5])))


@lru_cache(maxsize=1)
def painted_base(seed: int, still: bool) -> Base:
    return PaintedStory.good(
        seed, SHARED / "data" / "gcode-zoo", SMALL_PX["mixed" if still else "clean"], still
    ).painted()


def one_run(kind: str, seed: int, renderer: object, bases: list[Base]) -> dict:
    """Everything about one run, ready for JSON."""
    rng = np.random.default_rng([seed, 9])
    story = drawn_story(kind, seed, bases, rng)
    rms_px = float(rng.choice([0.0, 0.5, 1.0, 2.0, 3.0], p=[0.4, 0.15, 0.2, 0.15, 0.1]))
    header = story.header
    if rms_px:
        header = replace(header, cameras=((None, misfit(header.camera(), story.toolpath, rng, rms_px)),))
    inspector = Inspector(header, story.toolpath, renderer, reference_bgr=story.reference)
    print_px = cv2.boundingRect(np.where(story.clean_mask(len(story) - 1), np.uint8(255), np.uint8(0)))
    x, y, w, h = print_px
    rivals = Rivals((slice(max(y - 20, 0), y + h + 20), slice(max(x - 20, 0), x + w + 20)))
    errors, verdicts, failed, began_s = [], [], None, time.process_time()
    checks_s, sizes = 0.0, []
    courses = Courses("medium")
    for number in range(len(story)):
        picture = story.picture(number)
        errors.append(float(np.count_nonzero(picture.mask != story.clean_mask(number)) / story.total_px(number)))
        before_s = time.process_time()
        check = inspector.check(picture.frame, story.moment(number))
        checks_s += time.process_time() - before_s
        assert inspector.look is not None
        ruling = courses.rule(inspector.look, story.moment(number))[1]
        sizes.append(None if ruling is None else round(ruling.worst.leading.size, 2))
        if kind != "clean":
            rivals.look(number, picture.frame, check, story.finished(number))
        verdicts.append(check.verdict)
        if failed is None and check.verdict == FAILED:
            failed = (number, check)
        if story.fault and number > story.onset + 16:
            break
    visible = None
    if story.fault:
        steady = [min(errors[n : n + VISIBLE_FRAMES]) >= VISIBLE_E for n in range(len(errors) - VISIBLE_FRAMES + 1)]
        visible = next((n for n in range(story.onset, len(steady)) if steady[n]), None)
    alarms = {**rivals.alarms, **({"moop": failed[0]} if failed else {})}
    return {
        "kind": kind, "seed": seed, "base": story.name, "fault": story.fault, "strength": story.strength,
        "nuisances": list(story.nuisances), "misfit_px": rms_px, "onset": story.onset if story.fault else None,
        "visible": visible, "alarms": alarms, "checks": len(verdicts), "object": story.object_name,
        "mode": failed[1].mode if failed else None, "reason": failed[1].reason if failed else "",
        "named": [one["name"] for one in failed[1].objects if one["verdict"] == FAILED] if failed else [],
        "unusable": verdicts.count(UNUSABLE), "moved": verdicts.count(CAMERA_MOVED), "largest_E": max(errors),
        "size_px": getattr(story, "size_px", None), "px_per_mm": getattr(story, "px_per_mm", None),
        "surprises": sizes, "suspects": verdicts.count(SUSPECT), "failures": verdicts.count(FAILED), "bed": header.printer.bed.kind,
        "parked": story.moment(0).parked, "frame_px": list(header.camera().image_size_px),
        "ms": round(1000 * checks_s / len(verdicts), 1), "s": round(time.process_time() - began_s, 1),
    }  # fmt: skip


def run(arguments: argparse.Namespace) -> None:
    cv2.setNumThreads(1)
    out: Path = arguments.out
    out.parent.mkdir(parents=True, exist_ok=True)
    rows = read(out) if out.is_file() else []
    done = {(row["kind"], row["seed"]) for row in rows}
    bases = []
    if arguments.kind == "composited":
        bases = [
            Base.open(folder) for folder in sorted((SHARED / "cases").iterdir()) if (folder / "truth.json").is_file()
        ]
    with open_renderer() as renderer, open(out, "a") as lines:
        for seed in range(arguments.first, arguments.first + arguments.runs):
            if (arguments.kind, seed) not in done:
                row = one_run(arguments.kind, seed, renderer, bases)
                lines.write(json.dumps(row) + "\n")
                lines.flush()
                print(row["seed"], row["fault"], row["onset"], row["visible"], row["alarms"], row["mode"], flush=True)


def read(path: Path) -> list[dict]:
    return [json.loads(line) for line in path.read_text().splitlines()]


def score(rows: list[dict], rule: str) -> dict:
    """caught, delays, false alarms of one rule. Only faults that become visible are asked for."""
    faults = [row for row in rows if row["fault"] and row["visible"] is not None]
    caught = [row for row in faults if row["alarms"].get(rule, -1) >= row["onset"]]
    delays = [max(0, row["alarms"][rule] - row["visible"]) for row in caught]
    early = [
        row for row in rows if rule in row["alarms"] and (row["fault"] is None or row["alarms"][rule] < row["onset"])
    ]
    return {
        "faults": len(faults), "caught": len(caught), "delay_median": statistics.median(delays) if delays else None,
        "delay_at_most_1": sum(delay <= 1 for delay in delays), "false_alarms": len(early), "runs": len(rows),
        "clean_checks": sum(row["checks"] if row["fault"] is None else row["onset"] for row in rows),
    }  # fmt: skip


def rules_table(rows: list[dict]) -> str:
    """What each rule makes of the same frames."""
    lines = ["| frames | rule | faults caught | delay 0 or 1 | median delay | runs with a false alarm | clean checks |",
             "| --- | --- | --- | --- | --- | --- | --- |"]  # fmt: skip
    for kind in sorted({row["kind"] for row in rows}):
        for rule in RULES:
            one = score([row for row in rows if row["kind"] == kind], rule)
            lines.append(
                f"| {kind} | {rule} | {one['caught']} of {one['faults']} | {one['delay_at_most_1']} | {one['delay_median']:g} | "
                f"{one['false_alarms']} of {one['runs']} | {one['clean_checks']:,} |"
            )
    return "\n".join(lines)


def as_tables(rows: list[dict]) -> str:
    """Markdown for docs/decision.md: the rules side by side, and ours by fault and by how large the fault is."""
    parts = [rules_table(rows)]
    for kind in sorted({row["kind"] for row in rows}):
        mine = [row for row in rows if row["kind"] == kind]
        lines = [
            f"| {kind}: fault | caught | delay 0 or 1 | mode right | object right |",
            "| --- | --- | --- | --- | --- |",
        ]
        for fault in sorted({row["fault"] for row in mine if row["fault"]}):
            own = [row for row in mine if row["fault"] == fault]
            one = score(own, "moop")
            caught = [r for r in own if r["visible"] is not None and r["alarms"].get("moop", -1) >= r["onset"]]
            right = sum(row["mode"] in RIGHT_MODES[fault] for row in caught)
            asked = [row for row in caught if row["object"]]
            named = sum(row["named"] == [row["object"]] for row in asked)
            lines.append(
                f"| {fault} | {one['caught']} of {one['faults']} | {one['delay_at_most_1']} | {right} | {named} of {len(asked)} |"
            )
        parts.append("\n".join(lines))
        lines = [f"| {kind}: largest true E | caught |", "| --- | --- |"]
        for low, high in ((0.0, 0.01), (0.01, 0.02), (0.02, 0.04), (0.04, 0.1), (0.1, 9.0)):
            own = [row for row in mine if row["fault"] and low <= row["largest_E"] < high]
            caught = sum(row["alarms"].get("moop", -1) >= row["onset"] for row in own)
            lines.append(f"| {low} to {high} | {caught} of {len(own)} |")
        parts.append("\n".join(lines))
    return "\n\n".join(parts)


def table(arguments: argparse.Namespace) -> None:
    print(as_tables(read(arguments.results)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(required=True)
    running = commands.add_parser("run")
    running.add_argument("--kind", choices=KINDS, default="composited")
    running.add_argument("--first", type=int, default=0)
    running.add_argument("--runs", type=int, default=30)
    running.add_argument("--out", type=Path, default=RESULTS)
    running.set_defaults(act=run)
    showing = commands.add_parser("table")
    showing.add_argument("results", type=Path, nargs="?", default=RESULTS)
    showing.set_defaults(act=table)
    arguments = parser.parse_args()
    arguments.act(arguments)


if __name__ == "__main__":
    main()
