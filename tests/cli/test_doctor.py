"""The doctor names what does not work and the command that mends it, and never breaks down itself."""

from __future__ import annotations

import itertools
import json
import sys

import cv2
import numpy as np
from click.testing import CliRunner

from octoprint_moop.cli import doctor as module
from octoprint_moop.cli.doctor import OK, PROBLEM, WARNING, doctor, library, webcam
from octoprint_moop.demo.webcam import SnapshotServer


def jpeg(grey):
    return cv2.imencode(".jpg", np.full((48, 64, 3), grey, np.uint8))[1].tobytes()


def test_what_works_here_is_said_with_versions_and_the_renderer():
    answer = json.loads(CliRunner().invoke(doctor, ["--json"]).stdout)
    found = {finding["name"]: finding for finding in answer["findings"]}
    assert found["numpy"]["detail"] == np.__version__
    assert found["opencv-python-headless"]["state"] == OK
    assert answer["renderer"] == found["renderer"]["detail"]
    assert answer["ok"]


def test_a_renderer_that_was_asked_for_is_the_one_in_use(monkeypatch):
    monkeypatch.setenv("MOOP_RENDERER", "opencv")
    assert json.loads(CliRunner().invoke(doctor, ["--json"]).stdout)["renderer"].startswith("OpenCV")


def test_a_missing_library_is_named_with_the_command_that_installs_it():
    found = library("moop-has-no-such-library", "nothing", vital=True)
    assert found.state == PROBLEM
    assert found.mend == f"{sys.executable} -m pip install --upgrade moop-has-no-such-library"


def test_a_library_whose_import_kills_the_process_is_a_finding():
    found = library("numpy", "os; os.kill(os.getpid(), 4)", vital=False)
    assert found.state == WARNING
    assert "signal 4" in found.detail


def test_without_a_vital_library_nothing_else_is_tried(monkeypatch):
    monkeypatch.setattr(module, "LIBRARIES", (("numpy", "no_such_module", True),))
    monkeypatch.setattr(module, "renderer", lambda: 1 / 0)
    result = CliRunner().invoke(doctor, [])
    assert result.exit_code == 0
    assert "No module named 'no_such_module'" in result.stdout


def test_a_webcam_is_told_from_a_page_a_frozen_one_and_none_at_all():
    greys = itertools.cycle((jpeg(10), jpeg(20)))
    for take, state, word in (
        (lambda: next(greys), OK, "64 x 48 px"),
        (lambda: jpeg(10), WARNING, "same picture"),
        (lambda: b"<html>", PROBLEM, "no picture"),
    ):
        with SnapshotServer(take) as server:
            found = webcam(server.url)
        assert (found.state, word in found.detail) == (state, True)
    assert "does not answer" in webcam(server.url).detail
    assert webcam("no address").state == PROBLEM
