"""A large file that is uploaded and printed at once: it prints, it is read meanwhile, and then it is watched.

    python benchmarks/large_at_once.py [--mb 100] [--write]

A real server with its virtual printer and a webcam that shows what was sent. Noted: how long until the first line leaves, until the file
is read and watched, how many lines leave in a second meanwhile, before and after, and how much memory either process takes. Prints
JSON; `--write` keeps it as benchmarks/results/large_at_once.json and puts the table into docs/faults.md.
"""

from __future__ import annotations

import argparse
import itertools
import json
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.host_stall import large_gcode
from benchmarks.tables import ROOT, put, save, table
from tests.host.conftest import open_room
from tests.host.room import Room
from tests.host.test_faults import eye_pids

CHECKS = 5


def write_job(path: Path, least_mb: float) -> None:
    """A file of at least that size: small layers, so that checks come soon, and then the same tall thing again and again."""
    start, _, tall = large_gcode(200_000).partition("G1 Z60.00 F3000\n")
    with path.open("w") as file:
        file.write(start)
        for _ in itertools.takewhile(lambda _: file.tell() < least_mb * 1e6, itertools.count()):
            file.write(f"G1 Z60.00 F3000\n{tall}")


def memory_mb(pid: int, what: str) -> float:
    """VmRSS or VmHWM, the most so far."""
    (line,) = (line for line in Path(f"/proc/{pid}/status").read_text().splitlines() if line.startswith(what))
    return round(int(line.split()[1]) / 1000, 1)


def measure(room: Room, job: Path) -> dict[str, Any]:
    server = room.server._process
    assert server is not None
    for pid in eye_pids(room):
        Path(f"/proc/{pid}/clear_refs").write_text("5")  # what is the most is counted anew
    before_mb, began_s = memory_mb(server.pid, "VmRSS"), time.monotonic()
    room._sent_from = len(room._sent_lines())
    room.server.upload(job)
    found: dict[str, Any] = {"mb": round(job.stat().st_size / 1e6, 1), "upload_s": since(began_s)}
    room.wait("the first line leaves", lambda: room.sent_pos() > 0, 120)
    found["first_line_s"] = since(began_s)
    rates, eye_mb, reading = [], 0.0, False
    while not (room.status["watching"] and room.status["job"] == job.name):
        at_s, sent = time.monotonic(), len(room._sent_lines())
        time.sleep(1)
        rates.append((len(room._sent_lines()) - sent) / (time.monotonic() - at_s))
        eye_mb = max([eye_mb, *(memory_mb(pid, "VmHWM") for pid in eye_pids(room))])
        reading = reading or room.status["reading"] is not None
        assert since(began_s) < 900, room.status
    found["watched_s"] = since(began_s)
    checks = room.wait_checks(CHECKS, 120)
    eye_mb = max([eye_mb, *(memory_mb(pid, "VmHWM") for pid in eye_pids(room))])
    found.update(
        told_to_be_reading=reading, lines_while_reading=sum(map(round, rates)), least_lines_per_s=round(min(rates), 1),
        verdicts=sorted({check["verdict"] for check in checks}), first_layer_checked=checks[0]["layer"],
        worst_E=max(check["E"] for check in checks), eye_most_mb=eye_mb, server_before_mb=before_mb,
        server_after_mb=memory_mb(server.pid, "VmRSS"),
    )  # fmt: skip
    return found


def since(began_s: float) -> float:
    return round(time.monotonic() - began_s, 1)


def as_table(figures: dict[str, Any]) -> str:
    head = ["file, MB", "uploaded after, s", "first line sent, s", "read and watched, s", "least lines a second while reading",
            "first layer checked", "verdicts", "eye at most, MB", "server, MB"]  # fmt: skip
    row = [
        figures[name]
        for name in ("mb", "upload_s", "first_line_s", "watched_s", "least_lines_per_s", "first_layer_checked")
    ]
    server = f"{figures['server_before_mb']} → {figures['server_after_mb']}"
    return table(head, [[*row, ", ".join(figures["verdicts"]), figures["eye_most_mb"], server]])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--mb", type=float, default=100)
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        job, small = folder / "large.gcode", folder / "as_seen.gcode"
        write_job(job, options.mb)
        write_job(small, 1)
        with open_room(folder / "room") as room:
            room.webcam.look_at(small)  # the same at the same positions, as far as it goes
            room.webcam.mask(0)  # drawn before anybody waits for it
            figures = measure(room, job)
            room.settle_down()
    print(json.dumps(figures, indent=1))
    if options.write:
        save("large_at_once", "python benchmarks/large_at_once.py --write", "drawn", figures)
        put(ROOT / "docs" / "faults.md", "large_at_once", as_table(figures))


if __name__ == "__main__":
    main()
