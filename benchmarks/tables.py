"""What was measured, on which machine, and its way into the documents. `python -m benchmarks` runs everything.

A result is `results/NAME.json`: machine, date, the command that makes it again, what kind of pictures it is from, and the figures. A
document's table stands between `<!-- NAME -->` and `<!-- /NAME -->`, and is only ever written by a script.
"""

from __future__ import annotations

import datetime
import json
import os
import platform
import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "benchmarks" / "results"

PICTURES = ("photographed", "rendered", "drawn", "none")
"""What figures can be from: photographs; path-traced recordings; the simulated webcam's drawings; no pictures at all."""


def machine() -> dict[str, Any]:
    """What a figure belongs to; ratios within one run are all that two machines have in common."""
    return {
        "processor": _processor(), "cores": os.cpu_count(), "python": platform.python_version(),
        "numpy": np.__version__, "opencv": cv2.__version__,
    }  # fmt: skip


def _processor() -> str:
    try:
        names = re.findall(r"^(?:model name|Model)\s*:\s*(.+)$", Path("/proc/cpuinfo").read_text(), re.MULTILINE)
    except OSError:
        names = []
    return names[0] if names else platform.machine()


def save(name: str, command: str, pictures: str, figures: Any) -> Path:
    """Writes results/NAME.json. `pictures` is one of PICTURES, or some, joined by "and"; `command` makes the same figures again."""
    assert set(pictures.split(" and ")) <= set(PICTURES), pictures
    path = RESULTS / f"{name}.json"
    result = {
        "date": datetime.date.today().isoformat(), "machine": machine(), "command": command, "pictures": pictures,
        "figures": figures,
    }  # fmt: skip
    path.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    return path


def put(document: Path, name: str, text: str) -> None:
    """Replaces what stands between NAME's marks. Raises ValueError where the document has no such marks."""
    before = document.read_text(encoding="utf-8")
    marks = re.compile(rf"(<!-- {re.escape(name)} -->\n).*?(<!-- /{re.escape(name)} -->)", re.DOTALL)
    if not marks.search(before):
        raise ValueError(f"{document.name} has no marks <!-- {name} --> … <!-- /{name} -->.")
    document.write_text(marks.sub(lambda found: f"{found[1]}{text.strip()}\n{found[2]}", before), encoding="utf-8")


def table(head: list[str], rows: list[list[Any]]) -> str:
    """Markdown; numbers to the right."""
    aligned = ["---:" if rows and isinstance(cell, (int, float)) else "---" for cell in (rows[0] if rows else head)]
    lines = [head, aligned, *rows]
    return "\n".join("| " + " | ".join(_cell(cell) for cell in line) + " |" for line in lines)


def _cell(cell: Any) -> str:
    if cell is None:
        return "–"
    return f"{cell:.3g}" if isinstance(cell, float) else str(cell)
