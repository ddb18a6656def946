"""Many prints and many checks in a row: what grows with their number, and should not.

    python benchmarks/endurance.py [--prints 1000] [--checks 10000] [--real-prints 200] [--real-checks 1000] \\
        > benchmarks/results/endurance.json

The watch is the real one, recordings are written, the printer takes no time. Twice: with an eye that answers at once, for
what stays behind in the server, and for fewer prints and checks with the real eye before painted pictures. Memory and open
files of both processes are noted on the way. A week of printing is about ten thousand checks. Prints JSON; `--write` keeps it as
benchmarks/results/endurance.json and puts the table into docs/faults.md.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.tables import ROOT, put, save, table
from octoprint_moop.core.gcode.read import read_gcode
from tests.host.room import PaintedWebcam, box_gcode, header
from tests.machine.endless import Endless


def state(endless: Endless) -> dict[str, Any]:
    """Of this process (the server's part) and of the eye."""
    found: dict[str, Any] = {"threads": threading.active_count()}
    for name, pid in (("server", os.getpid()), ("eye", endless.eye.pid)):
        pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
        found[f"{name}_mb"] = round(pages * os.sysconf("SC_PAGE_SIZE") / 1e6, 1)
        found[f"{name}_files"] = len(list(Path(f"/proc/{pid}/fd").iterdir()))
    return found


def row(
    endless: Endless, job: Path, ends: list[int], prints: int, at: dict[str, int], notes: int = 10
) -> dict[str, Any]:
    began_s, noted, checks, per_check_ms = time.monotonic(), [], 0, []

    def steps() -> Iterator[int]:
        for number, end in enumerate(ends):
            at["pos"] = end
            if len(ends) > 1 and number % max(len(ends) // notes, 1) == 0:
                noted.append({"checks": number, **state(endless)})
            before_s = time.monotonic()
            yield end
            per_check_ms.append((time.monotonic() - before_s) * 1000)

    for number in range(prints):
        if number and number % max(prints // notes, 1) == 0:
            noted.append({"prints": number, **state(endless)})
        checks += endless.print(job, header(), steps())
    noted.append({"prints": prints, "checks": checks, **state(endless)})
    tenth = max(len(per_check_ms) // 10, 1)
    return {
        "prints": prints, "layers": len(ends), "checks": checks, "seconds": round(time.monotonic() - began_s, 1),
        "ms_per_check_first_tenth": round(sum(per_check_ms[:tenth]) / tenth, 1),
        "ms_per_check_last_tenth": round(sum(per_check_ms[-tenth:]) / tenth, 1), "on_the_way": noted,
    }  # fmt: skip


def fast(folder: Path, prints: int, checks: int) -> dict[str, Any]:
    numbers = itertools.count()
    folder.mkdir()
    endless = Endless(folder, lambda: b"\xff\xd8%d\xff\xd9" % next(numbers), "tests.machine.fast_eye", recordings_mb=10)
    found = {}
    for name, layers, count in (("prints_of_one_layer", 1, prints), ("one_long_print", checks, 1)):
        job = folder / f"{layers}.gcode"
        job.write_text("G1 X1\n")
        found[name] = row(endless, job, [100 * (layer + 1) for layer in range(layers)], count, {})
    endless.close()
    return found


def real(folder: Path, prints: int, checks: int) -> dict[str, Any]:
    folder.mkdir()
    webcam, at = PaintedWebcam(), {"pos": 0}
    webcam.file_pos = lambda: at["pos"]
    endless = Endless(folder, webcam.jpeg, recordings_mb=50)
    found = {}
    for name, layers, count in (("prints_of_one_layer", 1, prints), ("one_long_print", checks, 1)):
        job = folder / f"box_{layers}.gcode"
        job.write_text(box_gcode(layers=layers, side_mm=12, lines_per_side=1, height_mm=min(0.3, 50 / layers)))
        webcam.look_at(job)
        found[name] = row(endless, job, read_gcode(job).layer_end_pos.tolist(), count, at)
    endless.close()
    webcam.close()
    return found


def write(figures: dict[str, Any]) -> None:
    save("endurance", "python benchmarks/endurance.py --write", "drawn", figures)
    put(ROOT / "docs" / "faults.md", "endurance", as_table(figures))


def as_table(figures: dict[str, Any]) -> str:
    rows = []
    for eye, found in figures.items():
        for one in found.values():
            first, last = one["on_the_way"][1], one["on_the_way"][-1]
            many = (
                f"{one['prints']} prints of one layer" if one["prints"] > 1 else f"one print of {one['layers']} layers"
            )
            rows.append([
                many, eye, one["checks"], *(f"{first[key]} → {last[key]}" for key in ("server_mb", "eye_mb", "server_files",
                "eye_files", "threads")), one["ms_per_check_first_tenth"], one["ms_per_check_last_tenth"],
            ])  # fmt: skip
    head = ["what", "looked at by", "checks", "server, MB", "eye, MB", "server's open files", "eye's open files",
            "server's threads", "ms a check, first tenth", "last tenth"]  # fmt: skip
    return table(head, rows)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--prints", type=int, default=1000)
    parser.add_argument("--checks", type=int, default=10_000)
    parser.add_argument("--real-prints", type=int, default=200)
    parser.add_argument("--real-checks", type=int, default=1000)
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        found = {
            "an eye that answers at once": fast(Path(folder) / "fast", options.prints, options.checks),
            "the real eye": real(Path(folder) / "real", options.real_prints, options.real_checks),
        }
    print(json.dumps(found, indent=1))
    if options.write:
        write(found)
