"""How long watching keeps the server's other threads waiting: the send loop's stalls that are our doing.

    python benchmarks/host_stall.py [--beads 1000000] [--seconds 25] [--rounds 2] [--write]

A real server prints the same file again and again with its virtual printer: unwatched, and watched from an empty cache, in turn.
Watched, the file is read at the beginning and then held and checked at each layer. Its first layers are small, so that checks are
frequent; the beads that make it large come after. Once a second somebody looks, as an open page would. A thread in the server wakes every
millisecond and notes how late it is, and what was at work where it was late; besides, each call of this plugin's hooks
in the threads that feed the printer is timed.

Twice, where that is allowed: with a server that runs in real time (SCHED_FIFO), before everything else on the machine, which leaves the
interpreter's lock as what a thread waits for; and with an ordinary one, which waits for processors too. Rounds are told
apart, since other work on the machine comes and goes: figures of one run are to be compared with each other.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.tables import ROOT, put, save, table
from octoprint_moop.demo.server import DemoServer
from tests.host.room import SLOWLY, PaintedWebcam, box_gcode, header


def large_gcode(beads: int) -> str:
    """Small layers first, then one tall spiral of as many beads."""
    turns = np.arange(beads) * 0.02
    radius = 40 + 5 * np.sin(turns * 7)
    x, y, z = 100 + radius * np.cos(turns), 100 + radius * np.sin(turns), 60 + np.floor(turns / 6.2832) * 0.2
    heights = np.flatnonzero(np.diff(z, prepend=0))
    lines = [f"G1 X{a:.3f} Y{b:.3f} E0.02" for a, b in zip(x, y)]
    for at in heights:
        lines[at] = f"G1 Z{z[at]:.2f} F3000\n{lines[at]}"
    return box_gcode(layers=200, side_mm=12, feed_mm_min=SLOWLY) + "\n".join(lines) + "\n"


def percentiles(values: np.ndarray, unit: str) -> dict[str, Any]:
    if not len(values):
        return {"count": 0}
    levels = {f"p{p:g}_{unit}": round(float(np.percentile(values, p)), 3) for p in (50, 99, 99.9)}
    return {"count": len(values), **levels, f"max_{unit}": round(float(values.max()), 3)}


class Ticks:
    """What the ticker has written, by stretches of time."""

    def __init__(self, path: Path) -> None:
        self._path, self._read = path, 0

    def since(self) -> Stretch:
        """All since the last call."""
        lines = [json.loads(line) for line in self._path.read_text().splitlines()[self._read :]]
        self._read += len(lines)
        late_ms = np.array([value for line in lines for value in line["late_ms"]])
        hooks_us = np.array([pair for line in lines for pair in line["hooks_us"]]).reshape(-1, 2)
        return Stretch(late_ms, hooks_us, [blamed for line in lines for blamed in line["blamed"]])


@dataclass(frozen=True)
class Stretch:
    """late_ms : of each tick; hooks_us : (n, 2), by the clock and of the processor; blamed : (ms, ours, others) of late ones"""

    late_ms: np.ndarray
    hooks_us: np.ndarray
    blamed: list[tuple[float, list[str], list[str]]]

    def ours_ms(self) -> np.ndarray:
        """As late_ms, without what no code of ours was at work in."""
        found = np.zeros_like(self.late_ms)
        ours = [late_ms for late_ms, ours, _ in self.blamed if ours]
        found[: len(ours)] = ours
        return found


class Looker:
    """Somebody who looks once a second: status, checks and the newest pictures."""

    def __init__(self, server: DemoServer) -> None:
        self._server, self._over = server, threading.Event()
        self._thread = threading.Thread(target=self._look, daemon=True)
        self._thread.start()

    def _look(self) -> None:
        while not self._over.wait(1.0):
            last = self._server.api("GET", "/plugin/moop/status")["last_check"]
            self._server.api("GET", "/plugin/moop/checks")
            for kind in ("frame.jpg", "seen.png", "expected.png") if last else ():
                self._server.request("GET", f"/plugin/moop/checks/{last['id']}/{kind}")

    def close(self) -> None:
        self._over.set()
        self._thread.join(30)


def in_real_time(folder: Path) -> str:
    """A program that runs Python in real time; "" where that is not allowed here."""
    program = folder / "python_in_real_time"
    program.write_text(f'#!/bin/sh\nexec chrt --fifo 1 {sys.executable} "$@"\n')
    program.chmod(0o755)
    try:
        allowed = subprocess.run([str(program), "-c", ""], capture_output=True).returncode == 0
    except OSError:
        allowed = False
    return str(program) if allowed else ""


def step_back() -> None:
    """Painting is no work that a webcam would give to the server's machine."""
    os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), 19)


def measure(folder: Path, python: str, job: Path, seconds: float, rounds: int) -> dict[str, Any]:
    """The figures of one server."""
    found: dict[str, list[Stretch]] = {"unwatched": [], "watched": []}
    checks = 0
    webcam = PaintedWebcam()
    webcam.before = step_back
    moop = {"_config_version": 1, "settle_s": 0.0, "on_failed": "none"}
    analysis = {"gcodeAnalysis": {"runAt": "never"}}  # the core's own reading would be measured with ours
    server = DemoServer(
        folder, octoprint_python=python, snapshot_url=webcam.url, settings={"plugins": {"moop": moop}, **analysis},
        plugins={"ticker": Path(__file__).with_name("ticker.py")},
    )  # fmt: skip
    with server:
        server.api("POST", "/plugin/moop/setup", json=header())
        server.upload(job, print=False)
        time.sleep(15)  # what a server does when it has started, and with a large file
        ticks = Ticks(server.basedir / "data" / "ticker" / "late_ms.json")
        looker = Looker(server)
        for _ in range(rounds):
            for name in found:
                watched = name == "watched"
                server.api("POST", "/api/settings", json={"plugins": {"moop": {"watch_prints": watched}}})
                shutil.rmtree(server.basedir / "data" / "moop" / "cache", ignore_errors=True)
                time.sleep(3)  # the ticker writes every two seconds
                ticks.since()
                server.api("POST", "/api/job", json={"command": "start"})
                time.sleep(seconds)
                found[name].append(ticks.since())
                checks += server.api("GET", "/plugin/moop/status")["checks"] if watched else 0
                server.api("POST", "/api/job", json={"command": "cancel"})
                server.wait_state({"Operational"}, 60)
        looker.close()
    webcam.close()
    figures: dict[str, Any] = {"checks": checks, "load": round(os.getloadavg()[0], 1)}
    for name, stretches in found.items():
        hooks = np.concatenate([stretch.hooks_us for stretch in stretches])
        blamed = Counter(place for stretch in stretches for _, ours, _ in stretch.blamed for place in ours)
        figures[name] = {
            "late_by_round": [percentiles(stretch.late_ms, "ms") for stretch in stretches],
            "late": percentiles(np.concatenate([stretch.late_ms for stretch in stretches]), "ms"),
            "late_with_ours_at_work": percentiles(np.concatenate([stretch.ours_ms() for stretch in stretches]), "ms"),
            "at_work": dict(blamed.most_common(12)),
            "longest": sorted((late for stretch in stretches for late in stretch.blamed), reverse=True)[:8],
            "hooks_clock": percentiles(hooks[:, 0], "us"),
            "hooks_processor": percentiles(hooks[:, 1], "us"),
        }
    for level in ("p50_ms", "p99_ms", "p99.9_ms", "max_ms"):
        differences = [
            watched[level] - unwatched[level]
            for watched, unwatched in zip(figures["watched"]["late_by_round"], figures["unwatched"]["late_by_round"])
        ]
        figures[f"watched_minus_unwatched_{level}"] = round(float(np.median(differences)), 3)
    return figures


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--beads", type=int, default=1_000_000)
    parser.add_argument("--seconds", type=float, default=25.0)
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        job = folder / "large.gcode"
        job.write_text(large_gcode(options.beads))
        figures: dict[str, Any] = {"beads": options.beads, "bytes": job.stat().st_size, "rounds": options.rounds}
        for name, python in (("in real time", in_real_time(folder)), ("ordinary", sys.executable)):
            if python:
                figures[name] = measure(folder / name.replace(" ", "_"), python, job, options.seconds, options.rounds)
    print(json.dumps(figures, indent=1))
    if options.write:
        write(figures)


def write(figures: dict[str, Any]) -> None:
    save("host_stall", "python benchmarks/host_stall.py --write", "drawn", figures)
    put(ROOT / "docs" / "threads-and-processes.md", "host_stall", as_table(figures))


def as_table(figures: dict[str, Any]) -> str:
    rows, notes = [], []
    for server in ("in real time", "ordinary"):
        for name in ("unwatched", "watched") if server in figures else ():
            found = figures[server][name]
            late, ours = found["late"], found["late_with_ours_at_work"]
            clock, processor = found["hooks_clock"], found["hooks_processor"]
            rows.append([
                server, name, late["p99_ms"], late["p99.9_ms"], ours["p99.9_ms"], ours["max_ms"],
                clock["count"], clock["p50_us"], clock["p99.9_us"], processor["p99.9_us"],
            ])  # fmt: skip
        if server in figures:
            one = figures[server]
            more = one["watched_minus_unwatched_p99.9_ms"]
            notes.append(f"{server} {more:+.1f} ms ({one['checks']} checks, under a load of {one['load']:.0f})")
    head = ["server", "", "a thread is late, p99, ms", "p99.9, ms", "with ours at work, p99.9, ms", "longest, ms",
            "calls of our hooks", "median, µs", "p99.9, µs", "p99.9, µs of processor"]  # fmt: skip
    return (
        f"{table(head, rows)}\n\nA job of {figures['beads']:,} beads, read and then checked at each layer, {figures['rounds']} rounds of "
        f"each, on two cores with other work. Watched less unwatched at p99.9, median over the rounds: {', '.join(notes)}."
    )


if __name__ == "__main__":
    main()
