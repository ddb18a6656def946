"""The demo's story: a server, a webcam, a job, a fault, and what becomes of the print."""

from __future__ import annotations

import gzip
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Callable

import cv2
import numpy as np

from ..core.camera import BedMotion, Camera
from ..core.errors import MoopError
from ..core.gcode.read import read_gcode
from ..core.header import Header, Printer
from ..core.segmentation.segment import HsvThresholds
from ..core.toolpath import Toolpath
from . import notebook
from .faults import KINDS, Fault
from .server import DemoServer
from .simulate import Nuisance, Scene
from .webcam import SnapshotServer

JOB = Path(__file__).with_name("job.gcode.gz")
JOB_NAME = "tug-and-bracket.gcode"
BED = BedMotion("y", (0.0, 200.0, 0.0))
MATERIAL = HsvThresholds(8.0, 35.0, 0.6, 0.42)
FAULT_LAYER = {"extrusion_stop": 30, "detachment": 36, "warping": 14, "layer_shift": 33, "spaghetti": 40}
"""Where each fault strikes unless another layer is asked for: late enough to have a print to lose."""

_POLL_S = 0.3
_LONGEST_S = 1500.0
_TELLING_S = 20.0
_OVER = ("Operational", "Paused", "Cancelling", "Error", "Offline", "Closed")


@dataclass(frozen=True)
class Outcome:
    """How the demo's print ended: the JSON line of `moop demo --once --json`.

    layer : of the plugin's last check (0-based), None where it made none; checks : how many it made
    """

    paused: bool
    layer: int | None
    fault_layer: int | None
    fault: str
    mode: str | None
    reason: str
    failed_objects: tuple[str, ...]
    checks: int
    state: str
    renderer: str
    seconds: float

    def to_json(self) -> dict[str, Any]:
        return asdict(self)


def demo_camera() -> Camera:
    """A webcam on an arm before the printer, with the lens of a webcam."""
    eye, target = np.array([100.0, -4.0, 84.0]), np.array([124.0, 106.0, 6.0])
    ahead = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    camera_from_room = np.stack([right, np.cross(ahead, right), ahead])
    return Camera(
        image_size_px=(640, 480),
        K=np.array([[720.0, 0.0, 319.5], [0.0, 720.0, 239.5], [0.0, 0.0, 1.0]]),
        distortion=np.array([-0.12, 0.04, 0.0005, -0.0004, 0.0]),
        rvec=cv2.Rodrigues(camera_from_room)[0].ravel(),
        tvec_mm=-camera_from_room @ eye,
    )


def demo_header() -> dict[str, Any]:
    """What the set-up would have found: a recording's header without a job."""
    printer = Printer(width_mm=250.0, depth_mm=210.0, height_mm=210.0, bed=BED)
    header = Header(printer, ((None, demo_camera()),), MATERIAL).to_json()
    del header["job"]
    return header


def unpack_job(folder: Path) -> Path:
    """The demo's G-code, as a file in `folder`."""
    path = folder / JOB_NAME
    path.write_bytes(gzip.decompress(JOB.read_bytes()))
    return path


class Demo:
    """Server, witness and webcam, tied together. A context manager: on exit nothing of it runs any more.

    basedir : folder of the server; fault : one of faults.KINDS or "none"; port : 0 for a free one
    """

    def __init__(
        self,
        basedir: Path,
        fault: str = "none",
        fault_layer: int | None = None,
        port: int = 0,
        seed: int = 1,
        nuisances: tuple[Nuisance, ...] = (),
        **server_options: Any,
    ) -> None:
        basedir.mkdir(parents=True, exist_ok=True)
        self.fault = fault
        self.fault_layer = None if fault == "none" else FAULT_LAYER[fault] if fault_layer is None else fault_layer
        self.job = unpack_job(basedir)
        self.toolpath = read_gcode(self.job)
        if self.fault_layer is not None and not 0 <= self.fault_layer < self.toolpath.layers:
            raise MoopError(f"There is no layer {self.fault_layer}; the job has 0 to {self.toolpath.layers - 1}.")
        self._nuisances, self._seed = nuisances, seed
        self.scene = self._scene(self.toolpath, self._faults())
        self._notebook = basedir / "notebook"
        notebook.make(self._notebook)
        self._seen_job: Path | None = None
        self._shots = 0
        self.webcam = SnapshotServer(self._take, post=self._post)
        self.server = DemoServer(
            basedir, port, snapshot_url=self.webcam.url,
            plugins={"moop_demo_witness": Path(__file__).with_name("witness.py")},
            environment={"MOOP_DEMO_WITNESS": str(self._notebook)}, **server_options,
        )  # fmt: skip

    def __enter__(self) -> Demo:
        self.webcam.__enter__()
        try:
            self.server.__enter__()
            self.server.api("POST", "/plugin/moop/setup", json=demo_header())
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.server.stop()
        self.webcam.__exit__()

    def print_job(self) -> None:
        self.server.upload(self.job)

    def wait_for_the_end(self, on_check: Callable[[dict[str, Any]], None] = lambda status: None) -> Outcome:
        """Returns when the print has paused or ended. `on_check` hears of each check, with the plugin's status.

        Raises ServerError where the server fails, or after 25 minutes.
        """
        began_s, checks, over_s = time.monotonic(), 0, None
        while True:
            state, now_s = self.server.job_state(), time.monotonic()
            status = self.server.api("GET", "/plugin/moop/status")
            if status["checks"] != checks:
                checks = status["checks"]
                on_check(status)
            if state.startswith(_OVER) and now_s - began_s > 3:
                over_s = over_s or now_s
                # The plugin pauses first, and tells afterwards.
                told = status["action"] != "none" and status["last_check"]["verdict"] == "failed"
                if told or not state.startswith("Paused") or now_s - over_s > _TELLING_S:
                    return self._outcome(state, status, over_s - began_s)
            if now_s - began_s > _LONGEST_S:
                raise MoopError(f"The print goes on after {_LONGEST_S:.0f} s (state {state}); the demo gives up.")
            time.sleep(_POLL_S)

    def _outcome(self, state: str, status: dict[str, Any], seconds: float) -> Outcome:
        check = status["last_check"] or {}
        return Outcome(
            paused=state.startswith("Paused"),
            layer=check.get("layer"),
            fault_layer=self.fault_layer,
            fault=self.fault,
            mode=check.get("mode"),
            reason=status["reason"] or check.get("reason") or ("" if check else status["blind"] or ""),
            failed_objects=tuple(o["name"] for o in check.get("objects", ()) if o["verdict"] == "failed"),
            checks=status["checks"],
            state=state,
            renderer=status["renderer"],
            seconds=round(seconds, 1),
        )

    def _faults(self) -> tuple[Fault, ...]:
        if self.fault_layer is None:
            return ()
        # One of the two parts comes off or curls; the printer as a whole loses steps, or filament.
        objects = {"detachment": 1, "spaghetti": 0, "warping": 1}
        return (Fault(self.fault, self.fault_layer, objects.get(self.fault)),)

    def _scene(self, toolpath: Toolpath, faults: tuple[Fault, ...]) -> Scene:
        return Scene(toolpath, demo_camera(), BED, faults=faults, nuisances=self._nuisances, seed=self._seed)

    def set_off(self, kind: str, object_index: int | None = None) -> str:
        """Lets something go wrong with one object, or all, from the next layer on; "none" mends all. Returns a sentence."""
        if kind == "none":
            self.scene.faults = ()
            return "All is well with the print again."
        layer = self.scene.layer_at(notebook.read(self._notebook)[0]) + 1
        self.scene.faults += (Fault(kind, layer, object_index),)
        return f"{kind} from layer {layer + 1} on."

    def _post(self, path: str) -> str | None:
        kind = path.rpartition("/")[2]
        return self.set_off(kind) if path == f"/fault/{kind}" and kind in (*KINDS, "none") else None

    def _take(self) -> bytes:
        self._follow_job()
        file_pos, position_mm = notebook.read(self._notebook)
        self._shots += 1
        return self.scene.jpeg(file_pos, position_mm, self._shots)

    def _follow_job(self) -> None:
        """The webcam sees what is being printed, which need not be the demo's own job."""
        job = notebook.read_job(self._notebook)
        if job is None or job == self._seen_job:
            return
        self._seen_job = job
        if job.read_bytes() != self.job.read_bytes():
            self.scene = self._scene(read_gcode(job), ())
        elif self.scene.toolpath is not self.toolpath:
            self.scene = self._scene(self.toolpath, self._faults())
