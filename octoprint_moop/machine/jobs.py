"""A print from its start to its end, as the watch keeps it."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..core.settings import Settings
from .parking import Modes
from .recorder import Recorder

HEAD_MM = 40.0
"""As far around the nozzle the head may cover what lies below."""
EDGE_MM = 2.0
REST_TIMES = 9.0
"""So many times as long as a look in vain has held the print up it is left alone, from the second such look in a row on."""


@dataclass(frozen=True)
class Job:
    """A print that began.

    header : a recording's header, or None where the set-up was never made
    key    : tells it from other jobs, as `meshes.Meshes` knows it
    mesh   : what the eye must know of the mesh that is to be used; None for none
    webcam : whose place `header` tells; "" for the one that is set
    held   : False where the printer reads it from its own storage: it can be stopped for a look, but not held
    copy   : finds the same file among OctoPrint's own, where it is not; slow
    """

    name: str
    path: str | None
    header: dict[str, Any] | None
    why_not: str = ""
    key: str = ""
    mesh: dict[str, Any] | None = None
    webcam: str = ""
    held: bool = True
    copy: Callable[[], Path | None] = lambda: None
    over: threading.Event = field(default_factory=threading.Event)


@dataclass
class Print:
    """What the watching thread knows of the print that runs. Nobody else touches it.

    mesh      : as in Job; a user may change it while printing
    ready     : the eye knows what must be seen of it
    by_height : a mesh alone tells that, and no layer's end is known
    ends, bare_ends : file positions of the layers' ends, and of those before the first bead
    modes           : what the file has set at each of these
    reference       : the empty bed, JPEG, and what a header says of it; empty where it was not seen
    strange         : how often in a row the printer stood where its file has no bead's end
    in_vain         : looks in a row that came to nothing
    rest_until_s    : no look before that (monotonic)
    """

    job: Job
    mesh: dict[str, Any] | None = None
    ready: bool = False
    by_height: bool = False
    began_s: float = field(default_factory=time.monotonic)
    recorder: Recorder | None = None
    ends: list[int] = field(default_factory=list)
    bare_ends: list[int] = field(default_factory=list)
    bounds_mm: list[list[float]] = field(default_factory=list)
    modes: dict[int, Modes] = field(default_factory=dict)
    reference: tuple[Any, ...] = ()
    born: int = 0
    revivals: int = 0
    last_pos: float = -1
    strange: int = 0
    in_vain: int = 0
    rest_until_s: float = 0.0
    looked_s: float | None = None
    last_jpeg: bytes = b""
    frames: int = 0
    last_frame: str = ""
    switched_off: bool = False
    cancelled: dict[str, int] = field(default_factory=dict)
    said: dict[str, str] = field(default_factory=dict)

    def opened(self, told: dict[str, Any], birth: int) -> None:
        """The eye of that birth has read the job: what it told of it."""
        self.born, self.ready, self.by_height = birth, True, told["road"] == "height"
        self.ends, self.bare_ends, self.bounds_mm = told["ends"], told["bare_ends"], told["bounds_mm"]
        kinds = [Modes.from_json(kind) for kind in told["modes"]]
        self.modes = dict(zip([*self.bare_ends, *self.ends], (kinds[number] for number in told["mode_of"])))

    def begin_recording(self, root: Path, settings: Settings, tell: Callable[[str | None, str], None]) -> None:
        """Where one is wanted, and none has begun before the first look. tell : as in Recorder"""
        if settings.record and self.recorder is None and not self.ready:
            budget_bytes = settings.recordings_mb * 1_000_000
            self.recorder = Recorder(root, self.job.name, self.header(settings), budget_bytes, tell)

    def to_be_opened(self, again: bool) -> dict[str, Any]:
        """What `Eye.open` must be told of it. again : by an eye that does not know any more what it knew"""
        folder = None if self.recorder is None else self.recorder.folder
        packed = None if folder is None else folder / "job.gcode.gz"
        # The packed copy is what is being printed, whatever has become of the file since.
        job = packed if again and packed is not None and packed.exists() else self.job.path
        return {
            "job": None if job is None else str(job),
            "mesh": self.mesh,
            "keep_as": None if packed is None else str(packed),
            "keep_mesh_as": None if folder is None else str(folder / "model.stl"),
            "recording": str(folder) if again and self.ready and folder is not None else None,
            "said": self.said,
        }

    def header(self, settings: Settings) -> dict[str, Any]:
        """A recording's header for this print, with the filament's colour as it is set."""
        material = {
            "hue_deg": [settings.hue_min_deg, settings.hue_max_deg],
            "saturation_min": settings.saturation_min, "value_min": settings.value_min,
        }  # fmt: skip
        try:
            size = os.stat(self.job.path or "").st_size
        except OSError:  # deleted or renamed meanwhile
            size = 0
        file = "" if self.job.path is None else "job.gcode"
        head = {"format": "moop-recording", "version": 1, "job": {"file": file, "bytes": size}}
        if self.mesh is not None:
            head["mesh"] = {"file": "model.stl", "layer_height_mm": self.mesh.get("layer_height_mm")}
        taken = {"reference": self.reference[1]} if self.reference else {}
        return {**head, **(self.job.header or {}), "material": material, **taken}

    def park_at_mm(self, wanted: str) -> tuple[float, float]:
        """Where to park: as wanted, or at the left edge of the bed, or at the right one where the print is at the left.

        Y is that at which the camera was calibrated, where the bed moves; else the far edge.
        """
        try:
            x, y = (float(part) for part in wanted.split(","))
            return x, y
        except ValueError:
            pass
        printer = (self.job.header or {})["printer"]
        width, depth = printer["volume_mm"]["width"], printer["volume_mm"]["depth"]
        left, front = (-width / 2, -depth / 2) if printer["origin"] == "center" else (0.0, 0.0)
        near_left = self.bounds_mm[0][0] - left < HEAD_MM
        near_right = left + width - self.bounds_mm[1][0] < HEAD_MM
        x = left + width - EDGE_MM if near_left and not near_right else left + EDGE_MM
        moving = printer["bed_motion"] == "y"
        return x, printer["bed_reference_mm"]["y"] if moving else front + depth - EDGE_MM

    def looked_in_vain(self, held_s: float) -> None:
        """A webcam or a printer that does not answer costs its time limit: not at every layer, that would be hours."""
        self.in_vain += 1
        if self.in_vain > 1:
            self.rest_until_s = time.monotonic() + REST_TIMES * held_s

    @property
    def by_clock(self) -> bool:
        """No line of the file tells when a layer ends."""
        return self.by_height or not self.job.held

    def stands_clear(self, position_mm: tuple[float, float, float]) -> bool:
        """The head is beside the print, not above it."""
        (x0, y0, _), (x1, y1, _) = self.bounds_mm
        x, y, _ = position_mm
        return not (x0 - HEAD_MM < x < x1 + HEAD_MM and y0 - HEAD_MM < y < y1 + HEAD_MM)
