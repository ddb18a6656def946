"""One room with a real OctoPrint in it for all tests. MOOP_OCTOPRINT names another server's interpreter."""

from __future__ import annotations

import os
import sys

import pytest

pytest.importorskip("octoprint")

from .room import Room


@pytest.fixture(scope="session")
def shared_room(tmp_path_factory):
    with Room(tmp_path_factory.mktemp("room"), os.environ.get("MOOP_OCTOPRINT", sys.executable)) as room:
        room.set_up()
        room.save(capture="park")  # its webcam shows no head, so none may stand before the print
        room.warm_up()
        yield room


@pytest.fixture
def room(shared_room):
    yield shared_room
    shared_room.settle_down()
