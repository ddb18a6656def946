"""What must not grow: with the number of prints, and with the number of checks. benchmarks/endurance.py has larger ones."""

from __future__ import annotations

import gc
import itertools
import threading
import time
import tracemalloc
from pathlib import Path

import pytest

from octoprint_moop.machine import clock, watch
from octoprint_moop.machine.jobs import Job
from octoprint_moop.machine.webcam import Webcam

from .endless import Endless

HEADER = {
    "printer": {"volume_mm": {"width": 200, "depth": 200, "height": 200}, "origin": "lowerleft", "bed_motion": "fixed"}
}


@pytest.fixture
def endless(tmp_path):
    numbers = itertools.count()
    made = Endless(tmp_path, lambda: b"\xff\xd8%d\xff\xd9" % next(numbers), "tests.machine.fast_eye", recordings_mb=10)
    yield made
    made.close()


def left() -> tuple[int, int, int]:
    """Open files, threads, and bytes of Python's memory."""
    gc.collect()
    return len(list(Path("/proc/self/fd").iterdir())), threading.active_count(), tracemalloc.get_traced_memory()[0]


@pytest.mark.parametrize(("prints", "layers"), [(15, 1), (2, 100)])
def test_many_prints_and_many_checks_leave_nothing_behind(endless, tmp_path, prints, layers):
    job = tmp_path / f"{layers}.gcode"
    job.write_text("G1 X1\n")
    ends = [100 * (layer + 1) for layer in range(layers)]

    def run() -> None:
        assert sum(endless.print(job, HEADER, ends) for _ in range(prints)) == prints * layers

    tracemalloc.start()
    try:
        run()
        before = left()
        run()
        after = left()
    finally:
        tracemalloc.stop()
    assert after[0] <= before[0] + 2 and after[1] <= before[1] + 2
    assert after[2] - before[2] < 200_000, "what a second time leaves is not what the first did"


def test_looks_in_vain_do_not_hold_a_print_up_at_every_layer(endless, tmp_path):
    """A webcam that hangs costs its time limit each time; a tenth of the print's time is enough for that."""
    works, asked_s = [], []

    def find(name):
        asked_s.append(time.monotonic())
        if works:
            return "painted", lambda: [b"\xff\xd8%d\xff\xd9" % len(asked_s)]
        time.sleep(0.1)
        raise OSError("no answer")

    endless.watch._looks._webcam = Webcam(find)
    job = tmp_path / "100.gcode"
    job.write_text("G1 X1\n")
    endless.watch.job_started(Job(job.name, str(job), HEADER))
    endless.wait(lambda: endless.ledger.status["watching"])
    ends = itertools.count(100, 100)
    assert [endless.comes_by(next(ends)) for _ in range(5)] == [True, True, False, False, False]
    assert endless.ledger.status["blind_code"] == "frame"
    works.append(True)
    endless.wait(lambda: endless.comes_by(next(ends)) or time.sleep(0.05), 5)
    assert asked_s[2] - asked_s[1] > 9 * 0.1, "left alone for nine times as long"
    assert endless.comes_by(next(ends)), "and all is as before"
    endless.watch.job_over("done")


def test_a_connection_that_shows_no_line_of_the_print_is_told(endless, tmp_path, monkeypatch):
    """As connectors may do that hand the whole file over."""
    monkeypatch.setattr(clock, "NO_LINE_S", 0.2)
    monkeypatch.setattr(watch, "TICK_S", 0.1)
    job = tmp_path / "3.gcode"
    job.write_text("G1 X1\n")
    endless.watch.job_started(Job(job.name, str(job), HEADER))
    endless.wait(lambda: endless.ledger.status["blind_code"] == "not_held")
    assert "No line of this print" in endless.ledger.status["blind"]
