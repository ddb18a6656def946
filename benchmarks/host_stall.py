"""How long watching keeps the server's other threads waiting: the send loop's stalls that are our doing.

    python benchmarks/host_stall.py [--beads 1000000] [--seconds 60] > host_stall.json

A real server prints the same file twice with its virtual printer: unwatched, then watched (the file is indexed, held
and checked at each layer). A thread in the server wakes every millisecond and notes how late it is. The file's first
layers are small, so that checks are frequent; the beads that make it large come after. Figures of one run are to be
compared with each other, not with another machine's.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

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


def lateness(path: Path, since: int) -> dict[str, Any]:
    late_ms = np.array([value for line in path.read_text().splitlines()[since:] for value in json.loads(line)])
    return {
        "ticks": len(late_ms),
        **{f"p{p:g}_ms": round(float(np.percentile(late_ms, p)), 3) for p in (50, 99, 99.9)},
        "max_ms": round(float(late_ms.max()), 3),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--beads", type=int, default=1_000_000)
    parser.add_argument("--seconds", type=float, default=60.0)
    options = parser.parse_args()
    figures: dict[str, Any] = {"beads": options.beads, "rendered": True}
    with tempfile.TemporaryDirectory() as folder:
        webcam = PaintedWebcam()
        job = Path(folder) / "large.gcode"
        job.write_text(large_gcode(options.beads))
        figures["bytes"] = job.stat().st_size
        moop = {"_config_version": 1, "settle_s": 0.0, "on_failed": "none", "watch_prints": False}
        server = DemoServer(
            Path(folder) / "server", snapshot_url=webcam.url, settings={"plugins": {"moop": moop}},
            plugins={"ticker": Path(__file__).with_name("ticker.py")},
        )  # fmt: skip
        with server:
            server.api("POST", "/plugin/moop/setup", json=header())
            server.upload(job, print=False)
            ticks = server.basedir / "data" / "ticker" / "late_ms.json"
            time.sleep(60)  # the core's own analysis of the file, and the eye's
            for name, watched in (("unwatched", False), ("watched", True)):
                server.api("POST", "/api/settings", json={"plugins": {"moop": {"watch_prints": watched}}})
                began = len(ticks.read_text().splitlines())
                server.api("POST", "/api/job", json={"command": "start"})
                time.sleep(options.seconds)
                figures[name] = lateness(ticks, began)
                figures[name]["checks"] = server.api("GET", "/plugin/moop/status")["checks"]
                server.api("POST", "/api/job", json={"command": "cancel"})
                server.wait_state({"Operational"}, 60)
        webcam.close()
    for p in ("p50_ms", "p99_ms", "p99.9_ms", "max_ms"):
        figures[f"watched_minus_unwatched_{p}"] = round(figures["watched"][p] - figures["unwatched"][p], 3)
    print(json.dumps(figures, indent=1))


if __name__ == "__main__":
    main()
