"""How much memory the eye needs, the child process that does all the looking, with a very large job open.

    python benchmarks/eye_memory.py [--megabytes 100] [--checks 12] [--write] > eye_memory.json

The job is made here: a wavy vase full of infill, short moves, as long as asked for. The child is the product's own,
asked over its pipe as the plugin asks it: `index` (at upload), `open` (at the print's begin, once reading the file and once
from the cache), checks of frames in which that print grows. Linux only: resident memory (VmRSS: what is the child's own, and
what is mapped from files and could be given up) after each question, and the most that it ever was (VmHWM).
"""

from __future__ import annotations

import argparse
import json
import re
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.tables import ROOT, machine, put, save, table
from octoprint_moop.core.camera import BedMotion, Camera
from octoprint_moop.core.header import Header, Printer
from octoprint_moop.machine.link import EyeLink

SIZE_PX = (640, 480)
MIDDLE_MM, LAYER_MM = 110.0, 0.2
PATIENCE_S = 1800.0


def write_job(path: Path, megabytes: float) -> None:
    """Three walls and sparse rings, in moves of half a millimetre, layer by layer until the file is long enough."""
    turn = np.linspace(0, 2 * np.pi, 380)
    layer = 0
    with open(path, "w", encoding="ascii") as file:
        file.write("; generated\nG21\nG90\nM83\nG28\n")
        while file.tell() < megabytes * 1e6:
            file.write(f";LAYER_CHANGE\n;Z:{LAYER_MM * (layer + 1):.2f}\nG1 Z{LAYER_MM * (layer + 1):.2f} F600\n")
            for number, radius_mm in enumerate((30.0, 29.55, 29.1, *np.arange(28.0, 2, -1.0))):
                wavy = radius_mm * (1 + 0.05 * np.sin(5 * turn + layer / 40))
                x, y = MIDDLE_MM + wavy * np.cos(turn), MIDDLE_MM + wavy * np.sin(turn)
                kind = "External perimeter" if number == 0 else "Perimeter" if number < 3 else "Internal infill"
                file.write(f";TYPE:{kind}\nG1 X{x[0]:.3f} Y{y[0]:.3f} F9000\n")
                file.write("".join(f"G1 X{a:.3f} Y{b:.3f} E0.01663 F1800\n" for a, b in zip(x[1:], y[1:])))
            layer += 1


def camera() -> Camera:
    """Looks at the bed's middle from the front, from half a metre away."""
    back = np.array([0.0, 400.0, -250.0]) / np.hypot(400, 250)
    right = np.array([1.0, 0.0, 0.0])
    rotation = np.stack([right, np.cross(back, right), back])
    at_mm = np.array([MIDDLE_MM, MIDDLE_MM, 25.0]) - 470 * back
    return Camera(
        SIZE_PX, [[620, 0, 319.5], [0, 620, 239.5], [0, 0, 1]], np.zeros(5),
        cv2.Rodrigues(rotation)[0].ravel(), -rotation @ at_mm,
    )  # fmt: skip


def frame(rng: np.random.Generator) -> bytes:
    """A bed with structure. Nothing is printed on it: what is found does not matter here."""
    patches = rng.integers(60, 120, (60, 80, 3)).astype(np.uint8)
    picture = cv2.resize(patches, SIZE_PX, interpolation=cv2.INTER_CUBIC)
    noisy = np.clip(picture + rng.normal(0, 2, picture.shape), 0, 255).astype(np.uint8)
    return cv2.imencode(".jpg", noisy)[1].tobytes()


def resident(pid: int) -> dict[str, float]:
    """MB: all, the child's own, mapped from files, and the most so far."""
    status = Path(f"/proc/{pid}/status").read_text("ascii")
    names = {"resident_mb": "VmRSS", "own_mb": "RssAnon", "mapped_mb": "RssFile", "most_mb": "VmHWM"}
    return {
        name: round(int(re.search(rf"{field}:\s*(\d+)", status).group(1)) / 1024, 1)  # type: ignore[union-attr]
        for name, field in names.items()
    }


def watched(job: Path, cache: Path, checks: int) -> dict[str, Any]:
    """The child asked everything in turn, and what it needed after each."""
    printer = Printer(220.0, 220.0, 300.0, bed=BedMotion("fixed"))
    header = Header(printer, ((None, camera()),), None).to_json()
    link, rows, rng = EyeLink(), [], np.random.default_rng(1)
    bed = frame(np.random.default_rng(2))

    def ask(do: str, *blobs: bytes, **arguments: Any) -> dict[str, Any]:
        began_s = time.perf_counter()
        answer, _ = link.ask(do, *blobs, timeout_s=PATIENCE_S, **arguments)
        rows.append({"after": do, "s": round(time.perf_counter() - began_s, 2), **resident(link.pid)})
        return answer

    def open_job() -> dict[str, Any]:
        return ask("open", bed, job=str(job), header=header, settings={}, cache=str(cache))

    try:
        ask("index", job=str(job), cache=str(cache))
        ends = open_job()["ends"]
        for number in np.linspace(1, len(ends) - 1, checks).astype(int):
            at = {"x": 0.0, "y": 200.0, "z": LAYER_MM * (int(number) + 1)}
            moment = {"frame": f"{number}.jpg", "file_pos": ends[number], "layer": int(number), "position_mm": at,
                      "time_s": float(number), "parked": True}  # fmt: skip
            ask("check", frame(rng), moment=moment)
        open_job()
    finally:
        link.close()
    return {"most_mb": max(row["most_mb"] for row in rows), "layers": len(ends), "questions": rows}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--megabytes", type=float, default=100.0, help="size of the job that is made")
    parser.add_argument("--checks", type=int, default=12)
    parser.add_argument("--job", type=Path, help="a job of your own, instead")
    parser.add_argument("--write", action="store_true", help="also into results/ and the document")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        job = options.job or Path(folder) / "large.gcode"
        if options.job is None:
            write_job(job, options.megabytes)
        result = {
            "megabytes": round(job.stat().st_size / 1e6, 1),
            "reading": watched(job, Path(folder) / "cache", options.checks),
            "from_cache": watched(job, Path(folder) / "cache", options.checks),
        }  # fmt: skip
    json.dump({"machine": machine(), **result}, sys.stdout, indent=1)
    print()
    if options.write:
        save("eye_memory", "python benchmarks/eye_memory.py --write", "none", result)
        put(ROOT / "docs" / "rendering.md", "eye_memory", as_table(result))


def as_table(result: dict[str, Any]) -> str:
    """Resident memory after each question, in MB."""
    head = ["the file is", "after", "resident", "its own", "mapped", "most so far"]
    lines = []
    for way, name in (("reading", "read"), ("from_cache", "in the cache")):
        questions = result[way]["questions"]
        shown = [*questions[:3], questions[-2], questions[-1]]
        for row in shown:
            lines.append(
                [name, row["after"], *(round(row[key]) for key in ("resident_mb", "own_mb", "mapped_mb", "most_mb"))]
            )
    return table(head, lines)


if __name__ == "__main__":
    main()
