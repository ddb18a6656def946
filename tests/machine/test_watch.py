"""The watch, on a printer that takes no time: what it owes the print while the eye is busy, and from print to print."""

from __future__ import annotations

import errno
import itertools
import os
import threading
from dataclasses import replace

import pytest

from octoprint_moop.core.errors import GcodeError
from octoprint_moop.machine import clock, recorder, watch
from octoprint_moop.machine.jobs import Job
from octoprint_moop.machine.webcam import Webcam

from .endless import Endless
from .test_endless import HEADER


@pytest.fixture
def endless(tmp_path):
    numbers = itertools.count()
    made = Endless(tmp_path, lambda: b"\xff\xd8%d\xff\xd9" % next(numbers), "tests.machine.fast_eye", record=False)
    yield made
    made.close()


def begin(endless, folder, layers=9):
    job = folder / f"{layers}.gcode"
    job.write_text("G1 X1\n")
    endless.watch.job_started(Job(job.name, str(job), HEADER, key="local:x"))
    endless.wait(lambda: endless.ledger.status["watching"])


def slow(endless, do):
    """Questions of this kind are asked only when the event that comes second is set; the first says that one is due."""
    due, go_on, ask = threading.Event(), threading.Event(), endless.eye.ask

    def asking(what, *blobs, **arguments):
        if what == do:
            due.set()
            assert go_on.wait(20)
        return ask(what, *blobs, **arguments)

    endless.eye.ask = asking
    return due, go_on


@pytest.mark.parametrize(
    "change",
    [
        lambda watching: watching.apply(replace(watching._settings, hue_max_deg=40.0)),
        lambda watching: watching.mesh_changed("local:x", {"path": "model.stl"}),
    ],
    ids=["another colour", "a model"],
)
def test_a_print_is_not_held_while_the_eye_learns_it_anew(endless, tmp_path, change):
    """With three hundred pictures to be gone through again the nozzle would stand on the print for a minute."""
    begin(endless, tmp_path)
    assert endless.comes_by(100)
    due, go_on = slow(endless, "open")
    change(endless.watch)
    assert due.wait(5)
    assert endless.watch.holds.line_queuing("G1 X1", 200) is None and endless.printer.holds == 0
    go_on.set()
    endless.wait(lambda: endless.comes_by(300))
    endless.watch.job_over("done")


def test_what_ended_the_watching_of_one_print_is_not_said_of_the_next(endless, tmp_path, monkeypatch):
    monkeypatch.setattr(watch, "TICK_S", 0.02)
    begin(endless, tmp_path)
    for pos in (110, 210, 310):
        endless.watch.holds.line_queuing("G1 X1", pos)
    endless.wait(lambda: endless.ledger.status["blind_code"] == "file_changed")
    endless.watch.job_over("done")
    said = []
    endless.ledger._tell = lambda kind, payload: said.append(payload) if kind == "blind" else None
    begin(endless, tmp_path)
    endless.watch.holds.line_queuing("G1 X1", 50)
    threading.Event().wait(0.2)
    assert endless.ledger.status["watching"]
    assert {payload["code"] for payload in said} <= {"reading"}
    endless.watch.job_over("done")


def test_a_connection_that_could_not_be_held_is_not_held_against_the_next_print(endless, tmp_path, monkeypatch):
    monkeypatch.setattr(watch, "TICK_S", 0.02)
    begin(endless, tmp_path)
    endless.printer.set_job_on_hold = lambda value, blocking=True: None
    assert endless.watch.holds.line_queuing("G1 X1", 100) is None
    endless.wait(lambda: endless.ledger.status["blind_code"] == "not_held")
    endless.watch.job_over("done")
    del endless.printer.set_job_on_hold
    begin(endless, tmp_path)
    endless.watch.holds.line_queuing("G1 X1", 50)
    threading.Event().wait(0.2)
    assert endless.ledger.status["watching"]
    endless.watch.job_over("done")


def test_a_print_that_is_watched_only_once_somebody_asks_for_it_is_recorded_from_there_on(endless, tmp_path):
    endless.watch.apply(replace(endless.watch._settings, record=True, watch_prints=False))
    job = tmp_path / "9.gcode"
    job.write_text("G1 X1\n")
    endless.watch.job_started(Job(job.name, str(job), HEADER))
    endless.wait(lambda: endless.ledger.status["blind_code"] == "off")
    assert endless.ledger.status["recording"] is None
    endless.watch.watch_this_print(True)
    endless.wait(lambda: endless.ledger.status["watching"])
    assert endless.comes_by(100)
    endless.wait(lambda: len(endless.ledger.checks) == 1)
    kept = tmp_path / "recordings" / endless.ledger.status["recording"]
    assert len((kept / "frames.jsonl").read_text().splitlines()) == 1
    endless.watch.job_over("done")


def test_a_disk_that_fills_up_in_mid_print_is_told_until_the_next_print_begins(endless, tmp_path, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    endless.watch.apply(replace(endless.watch._settings, record=True))
    begin(endless, tmp_path)
    name = endless.ledger.status["recording"]
    assert (tmp_path / "recordings" / name).is_dir() and endless.ledger.status["not_recorded"] == ""
    monkeypatch.setattr(recorder, "_append", full)
    assert endless.comes_by(100)
    endless.wait(lambda: endless.ledger.status["not_recorded"])
    assert endless.ledger.status["recording"] is None and endless.ledger.status["watching"]
    endless.watch.job_over("done")
    endless.wait(lambda: endless.ledger.status["blind_code"] == "idle")
    assert "not recorded any more: the disk is almost full" in endless.ledger.status["not_recorded"]
    endless.watch.apply(replace(endless.watch._settings, record=False))
    begin(endless, tmp_path)
    assert endless.ledger.status["not_recorded"] == ""
    endless.watch.job_over("done")


def test_a_machine_that_can_start_no_eye_is_told_of_it(endless, tmp_path, monkeypatch):
    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("octoprint_moop.machine.link.tempfile.TemporaryFile", full)
    monkeypatch.setattr(watch, "REVIVALS", 0)
    job = tmp_path / "3.gcode"
    job.write_text("G1 X1\n")
    endless.watch.job_started(Job(job.name, str(job), HEADER))
    endless.wait(lambda: endless.ledger.status["blind_code"] == "eye", 5)
    assert "No space left on device" in endless.ledger.status["blind"]
    endless.watch.job_over("done")


def test_a_script_that_heats_for_minutes_before_the_file_is_no_connection_that_shows_nothing(
    endless, tmp_path, monkeypatch
):
    monkeypatch.setattr(clock, "NO_LINE_S", 0.1)
    monkeypatch.setattr(watch, "TICK_S", 0.02)
    endless.watch.holds.line_sent("M190", {"source:script", "script:beforePrintStarted"})
    begin(endless, tmp_path)
    threading.Event().wait(0.4)
    assert endless.ledger.status["watching"]
    endless.watch.job_over("disconnected", lost=True)
    begin(endless, tmp_path)
    endless.wait(lambda: endless.ledger.status["blind_code"] == "not_held", 5)
    endless.watch.job_over("done")


def test_another_webcam_in_the_settings_is_for_the_next_print(endless, tmp_path):
    """The camera's place is that of the webcam with which the print began."""
    chosen, looked = ["front"], []

    def find(name):
        looked.append(name or chosen[0])
        return looked[-1], lambda: [b"\xff\xd8%d\xff\xd9" % len(looked)]

    endless.watch._looks._webcam = Webcam(find)
    job = tmp_path / "9.gcode"
    job.write_text("G1 X1\n")
    endless.watch.job_started(Job(job.name, str(job), HEADER, webcam="front"))
    endless.wait(lambda: endless.ledger.status["watching"])
    assert endless.comes_by(100)
    chosen[0] = "side"
    assert endless.comes_by(200)
    assert looked == ["front", "front"]
    endless.watch.job_over("done")


def test_what_cannot_be_learned_anew_does_not_end_the_watching(endless, tmp_path):
    """The file was deleted meanwhile, and nothing is recorded: the eye still knows what it has read."""
    begin(endless, tmp_path)
    assert endless.comes_by(100)
    ask = endless.eye.ask

    def asking(what, *blobs, **arguments):
        if what == "open":
            raise GcodeError("There is no file 9.gcode. Check the name.")
        return ask(what, *blobs, **arguments)

    endless.eye.ask = asking
    endless.watch.apply(replace(endless.watch._settings, hue_max_deg=40.0))
    endless.wait(lambda: endless.ledger.status["blind_code"] == "gcode")
    endless.wait(lambda: endless.comes_by(200), 5)
    endless.wait(lambda: endless.ledger.status["watching"], 5)
    endless.watch.job_over("done")
