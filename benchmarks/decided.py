"""What the runs of detection.py say: false alarms with their bounds, faults by kind, and the smallest that is caught.

    python benchmarks/decided.py

Reads results/detection-clean.jsonl and results/detection-mixed.jsonl; writes the tables in docs/decision.md and the curve
docs/images/detection-size.svg. Both are drawn by the simulated webcam, none is photographed or path-traced.
"""

from __future__ import annotations

import json
import math
import sys
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.detection import RIGHT_MODES, rules_table
from benchmarks.tables import RESULTS, ROOT, put, table
from octoprint_moop.core.decision.decide import CUSUM_FAILED, DECISIVE, SLACK

DOCUMENT = ROOT / "docs" / "decision.md"
FIGURE = ROOT / "docs" / "images" / "detection-size.svg"
SIZES_PX = (0, 2, 4, 6, 9, 13, 20, 80)
WITHIN_LAYERS = 3
INKS = {"layer_shift": "#1b6ca8", "warping": "#b5542b", "detachment": "#3a7d44", "blob": "#7a4f9a"}


def read(name: str) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (RESULTS / name).read_text().splitlines()]


def of_version(rows: list[dict[str, Any]], version: str | None = None) -> list[dict[str, Any]]:
    """The rows of one version of the rule; of the newest where none is named."""
    newest = max((row["version"] for row in rows), key=int)
    return [row for row in rows if row["version"] == (version or newest)]


def most_likely_at_most(events: int, trials: int) -> float:
    """Upper end of the 95 % interval of a rate (Poisson; Garwood 1936), by bisection."""

    def chance(mean: float) -> float:
        return sum(math.exp(-mean) * mean**k / math.factorial(k) for k in range(events + 1))

    low, high = 0.0, 10.0 + 5 * events
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if chance(middle) > 0.05 else (low, middle)
    return high / max(trials, 1)


def run_length(sizes: np.ndarray, steps: int = 80) -> float:
    """Checks to a false alarm, on average, if surprises were independent (Brook and Evans 1972).

    The sum is a Markov chain on `steps` values from 0 to its limit; whoever leaves it upwards, or is decisive, is absorbed.
    """
    width = CUSUM_FAILED / steps
    levels = (np.arange(steps) + 0.5) * width
    stays = np.zeros((steps, steps))
    for size, share in zip(*np.unique(np.round(sizes, 2), return_counts=True)):
        if size >= DECISIVE:
            continue
        after = np.maximum(levels + size - SLACK, 0.0)
        inside = after < CUSUM_FAILED if size >= 1 else np.ones(steps, bool)
        to = np.minimum((after / width).astype(int), steps - 1)
        stays[np.flatnonzero(inside), to[inside]] += share / len(sizes)
    return float(np.linalg.solve(np.eye(steps) - stays, np.ones(steps))[0])


def false_alarms(rows: list[dict[str, Any]]) -> str:
    def line(name: str, some: list[dict[str, Any]]) -> list[Any]:
        checks = sum(row["checks"] for row in some)
        judged = checks - sum(row["unusable"] + row["moved"] for row in some)
        alarms = sum("moop" in row["alarms"] for row in some)
        bound = most_likely_at_most(alarms, judged)
        hundred = 1 - (1 - bound) ** 100
        return [name, len(some), judged, sum(row["unusable"] + row["moved"] for row in some), alarms,
                f"{1e4 * alarms / max(judged, 1):.2g}", f"{1e4 * bound:.2g}", f"{100 * hundred:.1f} %"]  # fmt: skip

    versions = sorted({row["version"] for row in rows}, key=int)
    lines = [line(f"version {version}", [r for r in rows if r["version"] == version]) for version in versions]
    newest = of_version(rows)
    lines.append(
        line(f"version {versions[-1]}: seeds that no version had seen", [r for r in newest if not r.get("again")])
    )
    lines.append(line("all versions, each seed once", [row for row in rows if not row.get("again")]))
    lines.append(line(f"version {versions[-1]}: without a nuisance", [row for row in newest if not row["nuisances"]]))
    lines.append(line("with one or two", [row for row in newest if row["nuisances"]]))
    lines.append(
        line("of these, camera nudged or knocked", [r for r in newest if {"nudge", "knock"} & {*r["nuisances"]}])
    )
    lines += [line(f"bed {bed}", [r for r in newest if r["bed"] == bed]) for bed in ("fixed", "y", "z")]
    lines.append(line("head in view", [row for row in newest if not row["parked"]]))
    head = ["clean runs", "runs", "checks judged", "not judged", "false alarms", "per 10,000", "95 %: at most",
            "a print of 100 checks, at most"]  # fmt: skip
    return table(head, lines)


def faults(rows: list[dict[str, Any]]) -> str:
    lines = []
    for fault in [*sorted({row["fault"] for row in rows}), None]:
        some = [row for row in rows if fault in (None, row["fault"])]
        seen = [row for row in some if row["visible"] is not None]
        caught = [row for row in seen if row["alarms"].get("moop", -1) >= row["onset"]]
        delays = [max(row["alarms"]["moop"] - row["visible"], 0) for row in caught]
        right = sum(row["mode"] in RIGHT_MODES[row["fault"]] for row in caught)
        lines.append([
            fault or "all", len(some), len(seen), len(caught), sum(delay <= 1 for delay in delays),
            str(int(np.median(delays))) if delays else "–", right,
        ])  # fmt: skip
    return table(["fault", "runs", "visible", "caught", "delay 0 or 1", "median delay", "rightly named"], lines)


def _by_size(rows: list[dict[str, Any]]) -> tuple[dict[tuple[str, int], list[bool]], dict[int, list[float]]]:
    """Whether each fault was caught soon, by fault and place in SIZES_PX; sizes in mm by place."""
    by_bin: dict[tuple[str, int], list[bool]] = defaultdict(list)
    sizes_mm: dict[int, list[float]] = defaultdict(list)
    for row in rows:
        if row["size_px"] is None or row["fault"] not in INKS:
            continue
        place = int(np.searchsorted(SIZES_PX, row["size_px"], side="right")) - 1
        soon = row["onset"] <= row["alarms"].get("moop", -1) <= (row["visible"] or row["onset"]) + WITHIN_LAYERS
        by_bin[row["fault"], place].append(soon)
        sizes_mm[place].append(row["size_px"] / row["px_per_mm"])
    return by_bin, sizes_mm


def curve(rows: list[dict[str, Any]]) -> str:
    """Markdown beside the figure: size in pixels of a 480 px wide picture, and its middle in mm, against share caught."""
    by_bin, sizes_mm = _by_size(rows)
    lines = []
    for place, (low, high) in enumerate(zip(SIZES_PX, SIZES_PX[1:])):
        shares = [f"{sum(by_bin[f, place])} of {len(by_bin[f, place])}" if by_bin[f, place] else "–" for f in INKS]
        middle = f"{np.median(sizes_mm[place]):.1f}" if sizes_mm[place] else "–"
        lines.append([f"{low} to {high}", middle, *shares])
    return table(["size, px", "median, mm", *INKS], lines)


def _drawn(by_bin: dict[tuple[str, int], list[bool]]) -> str:
    left, top, wide, high = 50, 16, 420, 200
    step = wide / (len(SIZES_PX) - 1)
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 620 270" font-family="sans-serif" font-size="12">',  # noqa: F541
        *(f'<path d="M{left} {top + high * (1 - s)}h{wide}" stroke="#ccc"/>'
          f'<text x="{left - 6}" y="{top + high * (1 - s) + 4}" text-anchor="end">{s:.0%}</text>' for s in (0, 0.5, 1)),
        *(f'<text x="{left + step * (n + 0.5)}" y="{top + high + 18}" text-anchor="middle">{a}–{b}</text>'
          for n, (a, b) in enumerate(zip(SIZES_PX, SIZES_PX[1:]))),
        f'<text x="{left + wide / 2}" y="{top + high + 40}" text-anchor="middle">'
        "size of the fault, pixels (picture 480 px across)</text>",
    ]  # fmt: skip
    for number, (fault, ink) in enumerate(INKS.items()):
        points = []
        for place in range(len(SIZES_PX) - 1):
            seen = by_bin.get((fault, place))
            if not seen:
                continue
            x, share, n = left + step * (place + 0.35 + 0.1 * number), sum(seen) / len(seen), len(seen)
            middle, half = (
                (share + 2 / n) / (1 + 4 / n),
                2 * math.sqrt(share * (1 - share) / n + 1 / n**2) / (1 + 4 / n),
            )
            low_y, high_y = (top + high * (1 - v) for v in (max(middle - half, 0), min(middle + half, 1)))
            y = top + high * (1 - share)
            points.append(f"{x:.1f},{y:.1f}")
            parts.append(f'<path d="M{x:.1f} {low_y:.1f}V{high_y:.1f}" stroke="{ink}" opacity=".4"/>')
            parts.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3.5" fill="{ink}"/>')
        parts.append(f'<polyline points="{" ".join(points)}" fill="none" stroke="{ink}" stroke-width="1.5"/>')
        parts.append(f'<text x="490" y="{40 + 22 * number}" fill="{ink}">{fault.replace("_", " ")}</text>')
    return "\n".join([*parts, "</svg>\n"])


def main() -> None:
    clean, mixed = read("detection-clean.jsonl"), read("detection-mixed.jsonl")
    put(DOCUMENT, "clean", false_alarms(clean))
    first, newest = of_version(mixed, "2"), of_version(mixed)
    put(DOCUMENT, "mixed", faults(first))
    put(DOCUMENT, "mixed-newest", faults(newest))
    put(DOCUMENT, "mixed-rules", rules_table(newest))
    put(DOCUMENT, "size", curve(mixed))
    FIGURE.parent.mkdir(exist_ok=True)
    FIGURE.write_text(_drawn(_by_size(mixed)[0]))
    put(DOCUMENT, "tail", tail(clean))


def tail(clean: list[dict[str, Any]]) -> str:
    """How often clean checks of the newest version surprise. What follows an alarm is no clean check any more."""
    told = [row["surprises"][: row["alarms"].get("moop", len(row["surprises"])) + 1] for row in of_version(clean)]
    sizes = np.array([x for row in told for x in row if x is not None])
    shares = ", ".join(f"{level:g}: {np.mean(sizes >= level):.2%}" for level in (0.3, 0.6, 1.0, DECISIVE))
    return (
        f"Of {len(sizes):,} clean checks, the share with a surprise of at least … {shares}. Were they "
        f"independent, a false alarm would come once in {run_length(sizes):,.0f} checks."
    )


if __name__ == "__main__":
    main()
