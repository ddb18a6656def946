"""The demo from its command line: a real server, a virtual printer, the plugin, and a fault."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
import urllib.request

import pytest

pytest.importorskip("octoprint")

from octoprint_moop.demo.notebook import Witness
from octoprint_moop.demo.run import Demo


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
    fault = ("--fault", "extrusion_stop", "--fault-layer", "12")
    demo = moop("demo", "--once", "--json", *fault, "--keep", tmp_path / "b")
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


@pytest.mark.slow
def test_a_fault_that_is_set_off_by_hand_pauses_the_print(tmp_path):
    with Demo(tmp_path) as demo:
        demo.print_job()
        while demo.server.api("GET", "/plugin/moop/status")["checks"] < 6:
            time.sleep(0.2)
        with urllib.request.urlopen(f"{demo.webcam.address}/fault/detachment", data=b"", timeout=10) as answer:
            layer = int(re.search(rb"layer (\d+)", answer.read()).group(1)) - 1  # people count from one
        outcome = demo.wait_for_the_end()
    assert outcome.paused
    assert 0 <= outcome.layer - layer <= 3


def test_the_webcam_sees_whatever_file_is_printed(tmp_path):
    demo = Demo(tmp_path / "base", fault="detachment")
    other = tmp_path / "other.gcode"
    other.write_text("M83\nG1 X100 Y100 Z0.3\nG1 X150 Y100 E3\n")
    Witness(tmp_path / "base" / "notebook").job(str(other))
    assert demo._take()
    assert len(demo.scene.toolpath) == 1
    Witness(tmp_path / "base" / "notebook").job(str(demo.job))
    assert demo._take()
    assert demo.scene.toolpath is demo.toolpath


def test_a_layer_that_the_job_does_not_have_is_refused_in_one_line():
    demo = moop("demo", "--once", "--fault", "warping", "--fault-layer", "500")
    _, err = demo.communicate(timeout=60)
    assert demo.returncode == 2
    assert err.strip().splitlines() == ["moop: There is no layer 500; the job has 0 to 66."]
