"""One room with a real OctoPrint in it for all tests. MOOP_OCTOPRINT names another server's interpreter."""

from __future__ import annotations

import os
import sys
from contextlib import contextmanager

import pytest

pytest.importorskip("octoprint")

from .room import Room

NO_HEAD = '{"head": []}'


@contextmanager
def open_room(folder):
    with Room(folder, os.environ.get("MOOP_OCTOPRINT", sys.executable)) as room:
        room.set_up()
        room.save(capture="park", head=NO_HEAD)  # its webcam shows none, so none may stand before the print
        room.warm_up()
        yield room


@pytest.fixture(scope="session")
def shared_room(tmp_path_factory):
    with open_room(tmp_path_factory.mktemp("room")) as room:
        yield room


@pytest.fixture
def room(shared_room):
    yield shared_room
    shared_room.settle_down()


@pytest.fixture
def saved(room):
    """Save settings for one test."""
    now = room.server.api("GET", "/api/settings")["plugins"]["moop"]
    names = (
        "capture", "on_failed", "on_suspect", "on_blind", "blind_min", "longest_s", "every_layers", "cool_after_min",
        "bed_off_after_min", "gcode_paused", "gcode_resumed", "min_interval_s", "watch_prints", "webcam", "record",
        "check_timeout_s", "head",
    )  # fmt: skip
    before = {name: now[name] for name in names}
    yield room.save
    room.save(**before)
