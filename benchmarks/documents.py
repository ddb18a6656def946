"""Every table of the documents, made again from benchmarks/results: `python -m benchmarks.documents`.

With --check nothing is written, and it fails where a document says something else than the results. Each benchmark puts
its own table into the document as well; this is for when a table's form changes, and for the test that holds them equal.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Callable

from . import (
    calibration,
    cases,
    check,
    decided,
    detection,
    endurance,
    eye_memory,
    gcode,
    host_stall,
    large_at_once,
    render,
    roads,
    segmentation_table,
    selfcheck,
    slicers,
    traced_score,
    truth,
    turns,
)
from .tables import RESULTS, ROOT, put


def figures(name: str) -> Any:
    found = json.loads((RESULTS / f"{name}.json").read_text(encoding="utf-8"))
    return found.get("figures", found)


def rows(name: str) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (RESULTS / f"{name}.jsonl").read_text(encoding="utf-8").splitlines()]


def _segmentation(part: str) -> str:
    return segmentation_table.parts(figures("segmentation"), figures("segmentation-heldout"))[part]


TABLES: dict[str, dict[str, Callable[[], str]]] = {
    "calibration.md": {
        "calibration-rendered": lambda: calibration.rendered_table(figures("calibration")["rendered"]),
        "calibration-drawn": lambda: calibration.drawn_table(figures("calibration")["drawn"]),
        "selfcheck": lambda: selfcheck.as_table(figures("selfcheck")),
    },
    "decision.md": {
        "tail": lambda: decided.tail(rows("detection-clean")),
        "cases": lambda: cases.as_table(figures("cases")),
        "clean": lambda: decided.false_alarms(rows("detection-clean")),
        "mixed": lambda: decided.faults(decided.of_version(rows("detection-mixed"), "2")),
        "mixed-newest": lambda: decided.faults(decided.of_version(rows("detection-mixed"))),
        "size": lambda: decided.curve(rows("detection-mixed")),
        "mixed-rules": lambda: detection.rules_table(decided.of_version(rows("detection-mixed"))),
        "turns": lambda: turns.as_table(figures("turns")),
        "rivals": lambda: detection.as_tables(rows("detection")),
        "fresh": lambda: detection.rules_table(rows("detection-fresh")),
        "traced": lambda: traced_score.table(rows("traced")),
        "traced-fresh": lambda: traced_score.table(rows("traced-fresh")),
    },
    "faults.md": {
        "endurance": lambda: endurance.as_table(figures("endurance")),
        "large_at_once": lambda: large_at_once.as_table(figures("large_at_once")),
    },
    "rendering.md": {
        "slicers": lambda: slicers.as_table(figures("slicers")["files"]),
        "gcode": lambda: gcode.as_tables(figures("gcode")),
        "truth": lambda: truth.as_table(figures("truth")),
        "roads": lambda: roads.as_table(figures("roads")),
        "render": lambda: render.as_table(figures("render")),
        "render-at-a-position": lambda: render.at_a_position_told(figures("render")),
        "check": lambda: check.as_table(figures("check")["checks"]),
        "eye_memory": lambda: eye_memory.as_table(figures("eye_memory")),
    },
    "segmentation.md": {
        part: lambda part=part: _segmentation(part)  # type: ignore[misc]
        for part in ("photographed", "heldout", "cost", "rendered", "machine")
    },
    "threads-and-processes.md": {"host_stall": lambda: host_stall.as_table(figures("host_stall"))},
}


def differing() -> Iterator[tuple[Path, str, str]]:
    """(document, mark, what belongs there) of each table that says something else than its results."""
    for name, tables in TABLES.items():
        document = ROOT / "docs" / name
        page = document.read_text(encoding="utf-8")
        for mark, made in tables.items():
            found = re.search(rf"<!-- {re.escape(mark)} -->\n(.*?)<!-- /{re.escape(mark)} -->", page, re.DOTALL)
            text = made().strip() + "\n"
            if found is None or found[1] != text:
                yield document, mark, text


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--check", action="store_true", help="write nothing; fail where a table is not its results'")
    wanted = parser.parse_args()
    stale = list(differing())
    for document, mark, text in stale:
        print(f"{document.name}: {mark} {'is not what benchmarks/results say' if wanted.check else 'is written'}")
        if not wanted.check:
            put(document, mark, text)
    return 1 if wanted.check and stale else 0


if __name__ == "__main__":
    sys.exit(main())
