"""Which way of drawing works on this machine: OpenGL on hardware, OpenGL in software, or OpenCV.

OpenGL is tried in a process of its own with a time-out, since a broken driver may crash or hang. The environment
variable MOOP_RENDERER asks for one: `gl` (any OpenGL), `software` (Mesa's llvmpipe) or `opencv`.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

from ..core.errors import RenderError
from ..core.expected.raster import CvRenderer

if TYPE_CHECKING:
    from .gl import GlRenderer

CHOICES = ("gl", "software", "opencv")
PROBE_TIMEOUT_S = 30.0
MOST_DEVICES = 4
SOFTWARE = {"LIBGL_ALWAYS_SOFTWARE": "1", "GALLIUM_DRIVER": "llvmpipe"}
# llvmpipe starts a thread for each core; a printer's computer has better things to do with them
FEW_THREADS = {"LP_NUM_THREADS": "2"}

_PROBE = """
import json, sys
from octoprint_moop.machine.gl import GlRenderer
with GlRenderer(int(sys.argv[1])) as renderer:
    print(json.dumps({"device": renderer.device, "software": renderer.software}))
"""


@dataclass(frozen=True)
class Probe:
    """What came of trying one device: `device` where it draws, else `problem`."""

    device_index: int
    environment: tuple[tuple[str, str], ...]
    device: str = ""
    software: bool = False
    problem: str = ""

    @property
    def works(self) -> bool:
        return not self.problem


def probe(device_index: int, environment: Mapping[str, str], timeout_s: float = PROBE_TIMEOUT_S) -> Probe:
    """Draws a known picture on one EGL device, in a process of its own."""
    asked = (device_index, tuple(sorted(environment.items())))
    try:
        done = subprocess.run(
            [sys.executable, "-c", _PROBE, str(device_index)],
            env={**FEW_THREADS, **os.environ, **environment, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)},
            stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=timeout_s,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return Probe(*asked, problem=f"the graphics driver did not answer within {timeout_s:g} s")
    except OSError as error:
        return Probe(*asked, problem=f"no process could be started ({error})")
    if done.returncode < 0:
        return Probe(*asked, problem=f"the graphics driver crashed (signal {-done.returncode})")
    if done.returncode:
        lines = done.stderr.strip().splitlines() or [f"exit status {done.returncode}"]
        return Probe(*asked, problem=lines[-1].split("RenderError: ")[-1])
    answer = json.loads(done.stdout.splitlines()[-1])
    return Probe(*asked, device=str(answer["device"]), software=bool(answer["software"]))


@lru_cache(maxsize=4)
def probes(choice: str | None = None) -> tuple[Probe, ...]:
    """Every way of using OpenGL that was tried, up to the one to be used: hardware first, then llvmpipe."""
    tried: list[Probe] = []
    if choice != "software":
        for index in range(MOST_DEVICES):
            found = probe(index, {})
            tried.append(found)
            if found.works or "found" in found.problem or "No module" in found.problem:
                break  # it draws, or there is no such device, or no moderngl
    without_module = any("No module" in found.problem for found in tried)
    if not without_module and not any(found.works for found in tried):
        tried.append(probe(0, SOFTWARE))
    return tuple(tried)


def open_renderer(choice: str | None = None) -> GlRenderer | CvRenderer:
    """The best renderer that works here, for the thread that calls; to be released, or used in a `with`.

    choice : one of CHOICES, or None for the environment's MOOP_RENDERER, or the best.
    Raises RenderError where a choice was made that does not work here.
    """
    choice = choice or os.environ.get("MOOP_RENDERER") or None
    if choice is not None and choice not in CHOICES:
        raise RenderError(f"MOOP_RENDERER is {choice!r}; it can be {', '.join(CHOICES)}, or be left out.")
    if choice == "opencv":
        return CvRenderer()
    tried = probes(choice)
    problems = [found.problem for found in tried if not found.works]
    for found in tried:
        if found.works:
            try:
                return _open_gl(found)
            except RenderError as error:
                problems.append(str(error))
    if choice is not None:
        raise RenderError(f"OpenGL was asked for but does not work here: {'; '.join(problems)}.")
    return CvRenderer()


def _open_gl(found: Probe) -> GlRenderer:
    for name, value in {**FEW_THREADS, **dict(found.environment)}.items():
        os.environ.setdefault(name, value)
    from .gl import GlRenderer

    return GlRenderer(found.device_index)
