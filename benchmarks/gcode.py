"""How fast G-code is read, and in how much memory: `python benchmarks/gcode.py FILE.gcode …`.

Prints JSON; `--write` keeps it as benchmarks/results/gcode.json and puts the table into docs/rendering.md. Files smaller than
`--speed-mb` are repeated to these sizes. The speed is CPU time against OctoPrint's own gcodeInterpreter on the same file, in turns within one run
(the ratio of medians; absolute times belong to the machine); beside it what the whole command takes, of which starting Python and NumPy is
the same for every file. The memory is the peak of a fresh process that reads the
file's body repeated to `--copies-mb`, without and with a cache, and then from the cache.
"""

from __future__ import annotations

import argparse
import itertools
import json
import re
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, Callable

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.tables import ROOT, put, save, table
from octoprint_moop.core.gcode.read import read_gcode

ONE_READING = """
import json, re, sys, time
from octoprint_moop.core.gcode import read_gcode
before = time.process_time()
toolpath = read_gcode(sys.argv[1], cache_dir=sys.argv[2] or None)
seconds = time.process_time() - before
peak_mb = int(re.search(r"VmHWM:\\s*(\\d+)", open("/proc/self/status").read()).group(1)) / 1024
print(json.dumps({"cpu_s": round(seconds, 3), "peak_mb": round(peak_mb, 1), "beads": len(toolpath)}))
"""


def cpu_s(work: Callable[[], object]) -> float:
    before = time.process_time()
    work()
    return time.process_time() - before


def command_cpu_s(path: Path) -> float:
    """CPU time of `moop index --json`, the start of the program included."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [sys.executable, "-m", "octoprint_moop.cli", "index", "--json", str(path)]
    subprocess.run(command, check=True, capture_output=True, cwd=ROOT)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def octoprint_reading(path: Path) -> Callable[[], object]:
    from octoprint.util.gcodeInterpreter import gcode

    return lambda: gcode().load(str(path))


def compared(path: Path, runs: int) -> dict[str, object]:
    read_gcode(path)
    ours, theirs, commands = [], [], []
    for _ in range(runs):
        ours.append(cpu_s(lambda: read_gcode(path)))
        commands.append(command_cpu_s(path))
        theirs.append(cpu_s(octoprint_reading(path)))
    median, their_median = statistics.median(ours), statistics.median(theirs)
    megabytes = path.stat().st_size / 1e6
    return {
        "file": path.name,
        "megabytes": round(megabytes, 1),
        "moop_cpu_s": round(median, 3),
        "moop_command_cpu_s": round(statistics.median(commands), 3),
        "octoprint_cpu_s": round(their_median, 3),
        "moop_mb_per_s": round(megabytes / median, 1),
        "times_less_cpu": round(their_median / median, 1),
        "times_less_cpu_command": round(their_median / statistics.median(commands), 1),
    }


def repeated(path: Path, megabytes: float, target: Path) -> None:
    """The file's first part once, and from its first layer comment on until the size is reached."""
    data = path.read_bytes()
    layer = re.search(rb"^;\s?(?:LAYER|layer|CHANGE_LAYER)", data, re.MULTILINE)
    begin = layer.start() if layer else 0
    with open(target, "wb") as file:
        file.write(data[:begin])
        while file.tell() < megabytes * 1e6:
            file.write(b"G92 E0\n" + data[begin:])


def memory(path: Path, megabytes: float) -> dict[str, object]:
    with tempfile.TemporaryDirectory() as folder:
        large, kept = Path(folder) / "large.gcode", Path(folder) / "kept"
        repeated(path, megabytes, large)
        found: dict[str, object] = {"megabytes": round(large.stat().st_size / 1e6, 1)}
        for name, cache in (("no_cache", ""), ("building_cache", str(kept)), ("from_cache", str(kept))):
            command = [sys.executable, "-c", ONE_READING, str(large), cache]
            found[name] = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
        return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("files", type=Path, nargs="+")
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--copies-mb", type=float, default=100.0)
    parser.add_argument("--speed-mb", type=float, nargs="+", default=[10.0, 50.0])
    parser.add_argument("--write", action="store_true")
    arguments = parser.parse_args()
    speed = []
    with tempfile.TemporaryDirectory() as folder:
        for megabytes, path in itertools.product(arguments.speed_mb, arguments.files):
            measured = path
            if path.stat().st_size < megabytes * 1e6:
                measured = Path(folder) / path.name
                repeated(path, megabytes, measured)
            speed.append(compared(measured, arguments.runs))
    figures = {"speed": speed, "memory": memory(arguments.files[0], arguments.copies_mb)}
    print(json.dumps(figures, indent=1))
    if arguments.write:
        save("gcode", f"python benchmarks/gcode.py --runs {arguments.runs} --write FILE.gcode …", "none", figures)
        put(ROOT / "docs" / "rendering.md", "gcode", as_tables(figures))


def as_tables(figures: dict[str, Any]) -> str:
    speed = table(
        ["file, repeated", "MB", "MOOP, s of CPU", "MB/s", "OctoPrint's gcodeInterpreter, s", "times less", "all of `moop index`, s", "times less"],
        [[row["file"], row["megabytes"], row["moop_cpu_s"], row["moop_mb_per_s"], row["octoprint_cpu_s"], row["times_less_cpu"],
          row["moop_command_cpu_s"], row["times_less_cpu_command"]] for row in figures["speed"]],
    )  # fmt: skip
    found = figures["memory"]
    ways = {"no_cache": "without a cache", "building_cache": "making the cache", "from_cache": "from the cache"}
    memory_rows = [
        [f"{found['megabytes']} MB, {words}", found[way]["cpu_s"], found[way]["peak_mb"]] for way, words in ways.items()
    ]
    return speed + "\n\n" + table(["a fresh process reads", "s of CPU", "peak memory, MB"], memory_rows)


if __name__ == "__main__":
    main()
