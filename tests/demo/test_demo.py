"""The demo from its command line: a real server, a virtual printer, the plugin, and a fault."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time

import pytest

pytest.importorskip("octoprint")


def moop(*arguments, **options):
    return subprocess.Popen(
        [sys.executable, "-m", "octoprint_moop.cli", *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        text=True, **options,
    )  # fmt: skip


def alive_in(folder):
    """Processes that have `folder` in their command line."""
    found = []
    for pid in filter(str.isdigit, os.listdir("/proc")):
        try:
            with open(f"/proc/{pid}/cmdline", "rb") as file:
                if str(folder).encode() in file.read():
                    found.append(pid)
        except OSError:  # gone meanwhile
            pass
    return found


@pytest.mark.slow
def test_a_print_that_stops_extruding_pauses_within_three_layers_and_nothing_is_left_running(tmp_path):
    demo = moop("demo", "--once", "--json", "--fault", "extrusion_stop", "--fault-layer", "12", "--keep", tmp_path / "b")
    out, err = demo.communicate(timeout=400)
    assert demo.returncode == 0, err
    outcome = json.loads(out)
    assert outcome["paused"] and outcome["fault_layer"] == 12
    assert 0 <= outcome["layer"] - 12 <= 3
    assert outcome["mode"] == "extrusion_failure"
    assert not alive_in(tmp_path)


@pytest.mark.slow
def test_whoever_ends_the_demo_ends_all_of_it(tmp_path):
    demo = moop("demo", "--fault", "none", "--keep", tmp_path / "b")
    for line in demo.stdout:
        if line.startswith("Printing"):
            break
    assert alive_in(tmp_path)
    time.sleep(1)
    demo.send_signal(signal.SIGTERM)
    demo.communicate(timeout=60)
    assert demo.returncode == 0
    assert not alive_in(tmp_path)


def test_a_layer_that_the_job_does_not_have_is_refused_in_one_line():
    demo = moop("demo", "--once", "--fault", "warping", "--fault-layer", "500")
    _, err = demo.communicate(timeout=60)
    assert demo.returncode == 2
    assert err.strip().splitlines() == ["moop: There is no layer 500; the job has 0 to 66."]
