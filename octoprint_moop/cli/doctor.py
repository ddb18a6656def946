"""`moop doctor`: what works on this machine, and the command that mends what doesn't."""

from __future__ import annotations

import importlib.metadata
import json
import os
import platform
import subprocess
import sys
import time
import urllib.error
import urllib.request
from dataclasses import asdict, dataclass

import click

OK, WARNING, PROBLEM = "ok", "warning", "problem"
PIP = f"{sys.executable} -m pip install --upgrade"
GL_PACKAGES = "sudo apt-get install libegl1 libgl1-mesa-dri"
IMPORT_TIMEOUT_S = 60.0
CAMERA_TIMEOUT_S = 10.0
# distribution, module, and whether nothing works without it
LIBRARIES = (
    ("numpy", "numpy", True),
    ("opencv-python-headless", "cv2", True),
    ("trimesh", "trimesh", True),
    ("moderngl", "moderngl", False),
)
OLDEST_OCTOPRINT = (1, 11, 2)


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at. mend: the command that helps, "" where none is needed or known."""

    name: str
    state: str
    detail: str
    mend: str = ""


@click.command()
@click.option("--camera", metavar="URL", help="Address of a webcam's snapshot to try, as in OctoPrint's settings.")
@click.option("--json", "as_json", is_flag=True, help="One JSON object on standard output.")
def doctor(camera: str | None, as_json: bool) -> None:
    """Say what works on this machine and, for what doesn't, the command that mends it."""
    libraries = [library(*which) for which in LIBRARIES]
    findings = [python(), octoprint(), *libraries]
    if all(finding.state != PROBLEM for finding in libraries):
        findings.append(renderer())
        if camera:
            findings.append(webcam(camera))
    if as_json:
        healthy = all(finding.state != PROBLEM for finding in findings)
        in_use = next((finding.detail for finding in findings if finding.name == "renderer"), None)
        click.echo(json.dumps({"ok": healthy, "renderer": in_use, "findings": [asdict(f) for f in findings]}))
        return
    for finding in findings:
        click.echo(f"{finding.state:8} {finding.name:24} {finding.detail}")
        if finding.mend:
            click.echo(f"{'':33} {finding.mend}")


def python() -> Finding:
    detail = f"{platform.python_version()} in {sys.prefix} on {platform.machine()}, {os.cpu_count()} cores"
    return Finding("Python", OK, detail)


def octoprint() -> Finding:
    """Whether OctoPrint is in this environment, and would find the plugin."""
    version = installed("OctoPrint")
    if version is None:
        return Finding(
            "OctoPrint", WARNING, "not in this environment: only the command line works here",
            "Run `moop doctor` with the Python of OctoPrint's own environment.",
        )  # fmt: skip
    numbers = tuple(int("".join(filter(str.isdigit, part)) or 0) for part in version.split(".")[:3])
    if numbers < OLDEST_OCTOPRINT:
        return Finding("OctoPrint", PROBLEM, version, f'{PIP} "OctoPrint>={".".join(map(str, OLDEST_OCTOPRINT))}"')
    points = importlib.metadata.entry_points()
    if hasattr(points, "select"):
        found = bool(list(points.select(group="octoprint.plugin", name="moop")))
    else:  # Python 3.9
        found = any(point.name == "moop" for point in points.get("octoprint.plugin", ()))
    if not found:
        return Finding("OctoPrint", PROBLEM, f"{version}, but without this plugin", f"{PIP} octoprint-moop")
    return Finding("OctoPrint", OK, f"{version}, with the plugin {installed('octoprint-moop')}")


def library(distribution: str, module: str, vital: bool) -> Finding:
    """Imports it in a process of its own: a wheel for another processor crashes, and must not take us along."""
    worst = PROBLEM if vital else WARNING
    version = installed(distribution)
    if version is None:
        without = "" if vital else "; the masks are drawn by OpenCV, which is slower"
        return Finding(distribution, worst, f"not installed{without}", f"{PIP} {distribution}")
    mend = f"{PIP} --force-reinstall {distribution}"
    try:
        done = subprocess.run(
            [sys.executable, "-c", f"import {module}"], stdin=subprocess.DEVNULL, capture_output=True, text=True,
            timeout=IMPORT_TIMEOUT_S,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return Finding(distribution, worst, f"{version} does not load within {IMPORT_TIMEOUT_S:.0f} s", mend)
    if done.returncode == 0:
        return Finding(distribution, OK, version)
    why = f"it crashes (signal {-done.returncode})" if done.returncode < 0 else "it fails"
    last_words = (done.stderr.strip().splitlines() or [why])[-1]
    return Finding(distribution, worst, f"{version} does not load: {last_words}", mend)


def renderer() -> Finding:
    """Which way of drawing is used, and why no better one."""
    from ..core.errors import RenderError
    from ..machine.renderers import open_renderer, probes

    try:
        drawing = open_renderer()
    except RenderError as error:
        return Finding("renderer", PROBLEM, str(error), "unset MOOP_RENDERER")
    name = drawing.name
    drawing.release()
    if "OpenCV" not in name:
        return Finding("renderer", OK, name)
    if os.environ.get("MOOP_RENDERER") == "opencv":
        return Finding("renderer", OK, f"{name}, as MOOP_RENDERER asks")
    problems = "; ".join(dict.fromkeys(tried.problem for tried in probes() if not tried.works))
    return Finding("renderer", WARNING, f"{name}, since OpenGL does not work: {problems}", GL_PACKAGES)


def webcam(url: str) -> Finding:
    """Whether the address delivers pictures, how large and how fast, and whether they are fresh."""
    import cv2
    import numpy as np

    pictures, began_s = [], time.perf_counter()
    try:
        for _ in range(2):
            with urllib.request.urlopen(url, timeout=CAMERA_TIMEOUT_S) as answer:
                pictures.append(answer.read(50_000_000))
    except (urllib.error.URLError, OSError, ValueError) as error:
        why = f"{url} does not answer: {getattr(error, 'reason', error)}"
        return Finding("camera", PROBLEM, why, "Start the streamer, or correct the address.")
    took_ms = (time.perf_counter() - began_s) * 1000 / 2
    frame = cv2.imdecode(np.frombuffer(pictures[1], np.uint8), cv2.IMREAD_COLOR)
    if frame is None:
        return Finding(
            "camera", PROBLEM, f"{url} delivers no picture but {pictures[1][:30]!r}",
            "Use the address of the snapshot, not of the stream or of a page.",
        )  # fmt: skip
    detail = f"{frame.shape[1]} x {frame.shape[0]} px in {took_ms:.0f} ms from {url}"
    if pictures[0] == pictures[1]:
        return Finding("camera", WARNING, f"{detail}; twice the very same picture", "Restart the streamer.")
    return Finding("camera", OK, detail)


def installed(distribution: str) -> str | None:
    try:
        return importlib.metadata.version(distribution)
    except importlib.metadata.PackageNotFoundError:
        return None
