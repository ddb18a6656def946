"""How long watching keeps the server's other threads waiting: the send loop's stalls that are our doing.

    python benchmarks/host_stall.py [--beads 1000000] [--seconds 20] [--rounds 4] [--write]

A real server prints the same file again and again with its virtual printer: unwatched and watched in turn (held and
checked at each layer), and watched once while the file is read. A thread in the server wakes every millisecond and notes
how late it is; besides, each call of this plugin's hooks in the threads that feed the printer is timed. The file's first
layers are small, so that checks are frequent; the beads that make it large come after. Rounds are told apart, since other
work on the machine comes and goes: figures of one run are to be compared with each other, not with another machine's.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.tables import ROOT, put, save, table
from octoprint_moop.demo.server import DemoServer
from tests.host.room import PaintedWebcam, box_gcode, header


def large_gcode(beads: int) -> str:
    """Small layers first, then one tall spiral of as many beads."""
    turns = np.arange(beads) * 0.02
    radius = 40 + 5 * np.sin(turns * 7)
    x, y, z = 100 + radius * np.cos(turns), 100 + radius * np.sin(turns), 60 + np.floor(turns / 6.2832) * 0.2
    heights = np.flatnonzero(np.diff(z, prepend=0))
    lines = [f"G1 X{a:.3f} Y{b:.3f} E0.02" for a, b in zip(x, y)]
    for at in heights:
        lines[at] = f"G1 Z{z[at]:.2f} F3000\n{lines[at]}"
    return box_gcode(layers=200, side_mm=12) + "\n".join(lines) + "\n"


def percentiles(values: np.ndarray, unit: str) -> dict[str, Any]:
    if not len(values):
        return {"count": 0}
    levels = {f"p{p:g}_{unit}": round(float(np.percentile(values, p)), 3) for p in (50, 99, 99.9)}
    return {"count": len(values), **levels, f"max_{unit}": round(float(values.max()), 3)}


class Ticks:
    """What the ticker has written, by stretches of time."""

    def __init__(self, path: Path) -> None:
        self._path, self._read = path, 0

    def since(self) -> tuple[np.ndarray, np.ndarray]:
        """(ms late, microseconds in hooks: (n, 2) by the clock and of the processor) since the last call."""
        lines = [json.loads(line) for line in self._path.read_text().splitlines()[self._read :]]
        self._read += len(lines)
        late_ms = np.array([value for line in lines for value in line["late_ms"]])
        hooks_us = np.array([pair for line in lines for pair in line["hooks_us"]]).reshape(-1, 2)
        return late_ms, hooks_us


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--beads", type=int, default=1_000_000)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--rounds", type=int, default=4)
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    late: dict[str, list[np.ndarray]] = {"reading": [], "unwatched": [], "watched": []}
    hooks: dict[str, list[np.ndarray]] = {"reading": [], "unwatched": [], "watched": []}
    checks = 0
    with tempfile.TemporaryDirectory() as folder:
        webcam = PaintedWebcam()
        job = Path(folder) / "large.gcode"
        job.write_text(large_gcode(options.beads))
        size = job.stat().st_size
        moop = {"_config_version": 1, "settle_s": 0.0, "on_failed": "none"}
        analysis = {"gcodeAnalysis": {"runAt": "never"}}  # the core's own reading would be measured with ours
        server = DemoServer(
            Path(folder) / "server", snapshot_url=webcam.url, settings={"plugins": {"moop": moop}, **analysis},
            plugins={"ticker": Path(__file__).with_name("ticker.py")},
        )  # fmt: skip

        def stretch(name: str) -> None:
            server.api("POST", "/api/job", json={"command": "start"})
            time.sleep(options.seconds)
            late_ms, hooks_us = ticks.since()
            late[name].append(late_ms)
            hooks[name].append(hooks_us)
            server.api("POST", "/api/job", json={"command": "cancel"})
            server.wait_state({"Operational"}, 60)
            time.sleep(3)  # the ticker writes every two seconds
            ticks.since()

        with server:
            server.api("POST", "/plugin/moop/setup", json=header())
            time.sleep(10)  # what a server does when it has started
            ticks = Ticks(server.basedir / "data" / "ticker" / "late_ms.json")
            ticks.since()
            server.upload(job, print=False)
            stretch("reading")
            for _ in range(options.rounds):
                for name in ("unwatched", "watched"):
                    watched = name == "watched"
                    server.api("POST", "/api/settings", json={"plugins": {"moop": {"watch_prints": watched}}})
                    stretch(name)
                    checks += server.api("GET", "/plugin/moop/status")["checks"] if watched else 0
        webcam.close()
    figures: dict[str, Any] = {"beads": options.beads, "bytes": size, "rendered": True, "rounds": options.rounds}
    figures["checks"], figures["load"] = checks, round(os.getloadavg()[0], 1)
    for name in late:
        figures[name] = {
            "late_by_round": [percentiles(values, "ms") for values in late[name]],
            "late": percentiles(np.concatenate(late[name]), "ms"),
            "hooks_clock": percentiles(np.concatenate(hooks[name])[:, 0], "us"),
            "hooks_processor": percentiles(np.concatenate(hooks[name])[:, 1], "us"),
        }
    for level in ("p50_ms", "p99_ms", "p99.9_ms", "max_ms"):
        differences = [
            watched[level] - unwatched[level]
            for watched, unwatched in zip(figures["watched"]["late_by_round"], figures["unwatched"]["late_by_round"])
        ]
        figures[f"watched_minus_unwatched_{level}"] = round(float(np.median(differences)), 3)
    print(json.dumps(figures, indent=1))
    if options.write:
        write(figures)


def write(figures: dict[str, Any]) -> None:
    save("host_stall", "python benchmarks/host_stall.py --write", "drawn", figures)
    put(ROOT / "docs" / "threads-and-processes.md", "host_stall", as_table(figures))


def as_table(figures: dict[str, Any]) -> str:
    rows = []
    for name in ("unwatched", "watched", "reading"):
        found = figures[name]
        late, clock, processor = found["late"], found["hooks_clock"], found["hooks_processor"]
        rows.append([
            name, clock["count"], clock["p50_us"], clock["p99.9_us"], processor["p99.9_us"], processor["max_us"],
            late["p99_ms"], late["p99.9_ms"],
        ])  # fmt: skip
    head = ["", "calls of our hooks", "median, µs", "p99.9, µs", "p99.9, µs of processor", "longest, µs of processor",
            "a thread is late, p99, ms", "p99.9, ms"]  # fmt: skip
    more = figures["watched_minus_unwatched_p99.9_ms"]
    return (
        f"{table(head, rows)}\n\n{figures['checks']} checks in {figures['rounds']} rounds, a job of "
        f"{figures['beads']:,} beads, on two cores under a load of {figures['load']:.0f}: what a thread is late is then mostly the "
        f"machine's doing (median over the rounds of watched less unwatched at p99.9: {more:+.1f} ms)."
    )


if __name__ == "__main__":
    main()
