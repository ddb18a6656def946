"""Puts the figures of benchmarks/results/segmentation*.json into docs/segmentation.md, between its markers.

python benchmarks/segmentation_table.py
"""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
RESULTS, PAGE = ROOT / "benchmarks" / "results", ROOT / "docs" / "segmentation.md"
COLOURS = ("black", "white", "blue", "green", "pink", "red", "yellow", "brown", "orange")


def table(heads: list[str], rows: list[list[str]]) -> str:
    return "\n".join("| " + " | ".join(row) + " |" for row in [heads, ["---"] * len(heads), *rows])


def photographed(found: dict) -> str:
    rows = []
    for what in next(iter(found["iou"].values())):
        cells = []
        for colour in ("all", *COLOURS):
            names = [name for name, own in found["colours"].items() if colour in ("all", own)]
            values = [value for name in names for value in found["iou"][name][what]]
            cells.append(f"{np.median(values):.2f}" if values else "")
        nearer = [one for rows in found["nearer_to_truth"].values() for one in rows.get(what, [])]
        rows.append([what, *cells, f"{100 * np.mean(nearer):.1f} %" if nearer else ""])
    return table(["median IoU", "all", *COLOURS, "nearer to the truth"], rows)


def held_out(found: dict) -> str:
    folds = ["as they are", "a print left out", "a printer left out"]
    rows = [[what, *(f"{found[fold][what]:.3f}" for fold in folds)] for what in found["as they are"]]
    return table(["", "constants as they are", *folds[1:]], rows)


def rendered(found: dict) -> str:
    columns = list(next(iter(found.values())))
    return table(["", *columns], [[name, *(f"{row[c]:.2f}" for c in columns)] for name, row in found.items()])


def machine(found: dict) -> str:
    return (
        f"Measured {found['date']} on {found['processor']}, {found['cores']} cores, Python {found['python']}, "
        f"OpenCV {found['opencv']}, numpy {found['numpy']}."
    )


def main() -> None:
    figures = json.loads((RESULTS / "segmentation.json").read_text())
    others = json.loads((RESULTS / "segmentation-heldout.json").read_text())
    page = PAGE.read_text()
    for name, text in parts(figures, others).items():
        page, count = re.subn(
            rf"(<!-- {name} -->\n).*?(<!-- /{name} -->)",
            lambda m, text=text: m[1] + text + "\n" + m[2],
            page,
            flags=re.S,
        )
        if count != 1:
            raise SystemExit(f"{PAGE.name} has {count} places for {name!r}, and wants one.")
    PAGE.write_text(page)


def parts(figures: dict, others: dict) -> dict[str, str]:
    """Mark -> what stands there."""
    return {
        "photographed": photographed(figures["photographed"]),
        "heldout": held_out(others),
        "cost": table(["", "times imdecode, p50"], [[k, f"{v:.1f}"] for k, v in figures["cost_ratio_p50"].items()]),
        "rendered": rendered(figures["rendered_median_iou"]),
        "machine": machine(figures["machine"]),
    }


if __name__ == "__main__":
    main()
