from __future__ import annotations

import pytest

from octoprint_moop.core.gcode.read import read_gcode
from octoprint_moop.demo.run import unpack_job


@pytest.fixture(scope="session")
def toolpath(tmp_path_factory):
    """The demo's own job: a tug (object 0) and a bracket (object 1)."""
    return read_gcode(unpack_job(tmp_path_factory.mktemp("job")))
