"""What `moop replay` makes of path-traced recordings, and the table of it in docs/decision.md."""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
RESULTS, PAGE = HERE / "results" / "traced.jsonl", HERE.parent / "docs" / "decision.md"
RIGHT_MODES = {
    "extrusion": {"extrusion_failure"}, "under_extrusion": {"extrusion_failure"}, "detachment": {"detachment"},
    "tip_over": {"detachment"}, "layer_shift": {"layer_shift"}, "warping": {"warping"},
    "spaghetti": {"stray_material", "detachment"}, "blob": {"stray_material"},
}  # fmt: skip


def scored(folder: Path) -> dict:
    """One recording, replayed without its truth: what was said, and whether that was right."""
    truth = json.loads((folder / "truth.json").read_text())
    began_s = time.time()
    done = subprocess.run(
        [sys.executable, "-m", "octoprint_moop.cli", "replay", str(folder), "--json"],
        capture_output=True,
        text=True,
        cwd=HERE.parent,
    )
    said = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    checks = [row for row in said if row["type"] == "check"]
    summary = next((row for row in said if row["type"] == "summary"), {})
    fault, failed = truth["fault"] or {}, summary.get("first_failed_layer")
    onset = fault.get("onset_layer")
    visible = fault.get("first_visible_layer")
    errors = {row["layer"]: row["E"] for row in truth["per_frame"]}
    gaps = [
        abs(c["E"] - errors[c["layer"]])
        for c in checks
        if c["verdict"] in ("ok", "suspect") and (onset is None or c["layer"] < onset)
    ]
    caught = bool(fault) and failed is not None and failed >= onset
    moved = [n.split() for n in truth["nuisance"] if n.startswith("camera turned")]
    moved_at = next((int(words[-1]) for words in moved if int(words[4]) >= 10), None)
    return {
        "seed": truth["seed"], "recording": folder.name, "fault": fault.get("kind"), "onset": onset, "visible": visible,
        "largest_E": max(errors.values()), "failed": failed, "caught": caught, "false_alarm": failed is not None and not caught,
        "delay": max(0, failed - (onset if visible is None else visible)) if caught else None, "mode": summary.get("mode"),
        "mode_right": caught and summary.get("mode") in next(v for k, v in RIGHT_MODES.items() if fault["kind"].startswith(k)),
        "object": fault.get("object"), "named": summary.get("failed_objects", []), "objects": len(truth["objects"]),
        "camera_moved_from": moved_at,
        "camera_moved_said": any(c["verdict"] == "camera_moved" and c["layer"] >= moved_at for c in checks) if moved_at is not None else None,
        "reason": next((c["reason"] for c in checks if c["verdict"] == "failed"), ""), "error": done.stderr.strip()[-200:] if done.returncode else "",
        "unusable": sum(c["verdict"] == "unusable" for c in checks), "checks": len(checks), "E_gap": round(float(np.mean(gaps)), 4) if gaps else None,
        "recipe": {k: v for k, v in truth["recipe"].items() if k not in ("seed", "fault")}, "nuisance": truth["nuisance"], "s": round(time.time() - began_s, 1),
    }  # fmt: skip


def scoring(arguments: argparse.Namespace) -> None:
    folders = sorted(f.parent for f in arguments.folder.glob("*/truth.json"))
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    with open(arguments.out, "w") as lines:
        for folder in folders:
            row = scored(folder)
            lines.write(json.dumps(row) + "\n")
            lines.flush()
            told = (
                "FALSE ALARM"
                if row["false_alarm"]
                else "caught"
                if row["caught"]
                else "missed"
                if row["fault"]
                else "quiet"
            )
            print(f"{row['recording']}: {told}, onset {row['onset']}, visible {row['visible']}, failed {row['failed']}, {row['mode']}, "
                  f"E to {row['largest_E']:.3f}, gap {row['E_gap']}, {row['unusable']} unusable, {row['reason']}{row['error']}", flush=True)  # fmt: skip


def table(rows: list[dict]) -> str:
    """Markdown for docs/decision.md."""
    faults = [row for row in rows if row["fault"] and row["visible"] is not None]
    caught = [row for row in faults if row["caught"]]
    delays = sorted(row["delay"] for row in caught)
    early = [row for row in rows if row["false_alarm"]]
    clean = sum(row["checks"] if row["fault"] is None else row["onset"] for row in rows)
    asked = [row for row in caught if row["object"] and row["objects"] > 1]
    knocked = [row for row in rows if row["camera_moved_from"] is not None]
    lines = [
        f"{len(rows)} recordings (rendered: path traced), {sum(row['checks'] for row in rows)} checks, {clean} of them with nothing wrong: "
        f"{len(caught)} of {len(faults)} visible faults caught, median delay {delays[len(delays) // 2] if delays else '–'} layers (at most {delays[-1] if delays else '–'}), "
        f"{sum(row['mode_right'] for row in caught)} of {len(caught)} rightly named, "
        f"{sum(row['named'] == [row['object']] for row in asked)} of {len(asked)} objects rightly named, {len(early)} false alarms, "
        f"{sum(bool(row['camera_moved_said']) for row in knocked)} of {len(knocked)} knocks of the camera told.",
        "",
        "| fault | filament, bed, light | nuisances | true E up to | visible from | failed at | named | |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for row in sorted(rows, key=lambda r: (r["fault"] or "", r["seed"])):
        plan = row["recipe"]
        said = (
            "false alarm"
            if row["false_alarm"]
            else "caught"
            if row["caught"]
            else ("missed" if row["visible"] is not None else "not visible, not said")
            if row["fault"]
            else "quiet"
        )
        where = f"{plan['filament']}, {plan['bed']}, {plan['light']}, bed {plan['motion']}" + (
            "" if plan["parked"] else ", head in view"
        )
        nothing = "–"
        lines.append(
            f"| {(row['fault'] or 'none').replace('_', ' ')} | {where} | {', '.join(row['nuisance']) or nothing} | {row['largest_E']:.3f} | "
            f"{nothing if row['visible'] is None else row['visible']} | {nothing if row['failed'] is None else row['failed']} | {row['mode'] or nothing} | {said} |"
        )
    return "\n".join(lines)


BEGIN, END = "<!-- traced -->", "<!-- /traced -->"


def tabling(arguments: argparse.Namespace) -> None:
    text = table([json.loads(line) for line in arguments.results.read_text().splitlines()])
    page = PAGE.read_text()
    if BEGIN not in page:
        raise SystemExit(f"{PAGE.name} has no {BEGIN} and {END} to put the table between.")
    before, rest = page.split(BEGIN)
    PAGE.write_text(f"{before}{BEGIN}\n{text}\n{END}{rest.split(END)[1]}")
