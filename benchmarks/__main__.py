"""Every benchmark there is: `python -m benchmarks [NAME …]` measures, keeps the results, and rewrites the documents' tables.

Without names all of them run, one after the other, for some hours; `--list` names them, and says of each what its figures are
from: photographs, rendered (path-traced) recordings, drawings of the simulated webcam, or no pictures at all. Each is a script of its own
with more options. `../shared`, or MOOP_SHARED, is where recordings, photographs and G-code are looked for.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from dataclasses import dataclass

from .tables import ROOT

SHARED = os.environ.get("MOOP_SHARED", str(ROOT.parent / "shared"))
CASES = sorted(str(path.parent) for path in ROOT.parent.glob("shared/cases/*/recording.json"))


@dataclass(frozen=True)
class Benchmark:
    """`commands` are run in turn from the project's folder; `pictures` is one of `tables.PICTURES`, or several."""

    about: str
    pictures: str
    commands: tuple[tuple[str, ...], ...]


def _script(name: str, *arguments: str) -> tuple[str, ...]:
    return (sys.executable, "-m", f"benchmarks.{name}", *arguments)


BENCHMARKS = {
    "gcode": Benchmark("reading G-code", "none", (
        _script("gcode", "--write", f"{SHARED}/data/gcode-zoo/prusaslicer_2.6.1_benchy.gcode",
                f"{SHARED}/data/gcode-zoo/cura_multi.gcode"),)),
    "slicers": Benchmark("layers and filament against the slicers' own words", "none", (_script("slicers", "--write"),)),
    "render": Benchmark("drawing the expected mask", "none", (
        _script("render", "--write", "--plot", "docs/images/render-cost.svg"),)),
    "truth": Benchmark("the expected mask against true masks", "rendered", (_script("truth", "--write", *CASES),)),
    "roads": Benchmark("the mesh against the G-code", "rendered", (_script("roads", "--write", *CASES),)),
    "check": Benchmark("what a whole check costs", "rendered", (_script("check", "--cases", f"{SHARED}/cases", "--write"),)),
    "eye_memory": Benchmark("memory with a large job", "none", (_script("eye_memory", "--write"),)),
    "calibration": Benchmark("lens and pose", "rendered and drawn", (_script("calibration", "--shared", SHARED, "--write"),)),
    "selfcheck": Benchmark("a calibration that is off, put right by the print", "rendered", (
        _script("selfcheck", "--shared", SHARED, "--write"),)),
    "segmentation": Benchmark("which pixels are filament", "photographed and rendered", (
        _script("segmentation", "--json", "benchmarks/results/segmentation.json", "--gallery", "docs/images"),
        _script("segmentation_heldout", "--json", "benchmarks/results/segmentation-heldout.json"),
        _script("segmentation_table"),)),
    "cases": Benchmark("failures in recordings, also with the camera from calibration pictures", "rendered", (
        _script("cases"),)),
    "detection": Benchmark("failures and false alarms in many drawn runs", "rendered and drawn", (
        _script("detection", "run", "--kind", "composited", "--runs", "200"),
        _script("detection", "run", "--kind", "simulated", "--runs", "200"),
        _script("detection", "run", "--kind", "clean", "--runs", "900"),)),
    "turns": Benchmark("a camera that was turned", "drawn", (_script("turns", "--write"),)),
    "host_stall": Benchmark("how long the server's other threads wait", "drawn", (_script("host_stall", "--write"),)),
    "large_at_once": Benchmark("a large file, uploaded and printed at once", "drawn", (_script("large_at_once", "--write"),)),
    "endurance": Benchmark("a thousand prints, ten thousand checks", "drawn", (_script("endurance", "--write"),)),
}  # fmt: skip


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(BENCHMARKS))
    parser.add_argument("--list", action="store_true", help="name them, and what their figures are from")
    chosen = parser.parse_args()
    unknown = [name for name in chosen.names if name not in BENCHMARKS]
    if unknown:
        parser.error(f"There is no benchmark {unknown[0]!r}. There are {', '.join(BENCHMARKS)}.")
    if chosen.list:
        for name, one in BENCHMARKS.items():
            print(f"{name:14s} {one.about} ({one.pictures if one.pictures != 'none' else 'no pictures'})")
        return 0
    failed = []
    for name in chosen.names or BENCHMARKS:
        for command in BENCHMARKS[name].commands:
            print("$", "python", *command[1:], file=sys.stderr, flush=True)
            if subprocess.run(command, cwd=ROOT, stdout=subprocess.DEVNULL).returncode:
                failed.append(name)
    if failed:
        print(f"Failed: {', '.join(failed)}. What they have said stands above.", file=sys.stderr)
    return bool(failed)


if __name__ == "__main__":
    sys.exit(main())
