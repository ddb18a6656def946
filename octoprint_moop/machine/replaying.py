"""A recording gone through again, with any settings: `moop replay`, and the page's trying of settings on a past print.

What the frames show does not depend on the sensitivity (`core.decision.course`). So it is kept beside the frames, and
another sensitivity is concluded from it without looking at a picture. What is kept names all that it was made of: the
frames and the lines about them, the header, the job, the empty bed's picture, the settings that matter, and this
program. Where any of it is another, everything is looked at anew.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from ..core.calibration.selfcheck import Fit
from ..core.checks import Check, Pictures
from ..core.decision.course import Look
from ..core.errors import RecordingError
from ..core.header import Header, Moment
from ..core.inspection import Inspector, conclude
from ..core.settings import Settings
from .recording import Recording
from .roads import MeshChoice, Road

FILE = "looks.json"
MATTERS = ("segmentation", "head")
"""The settings on which a look depends: those that an Inspector asks for, but for the sensitivity."""
MOST_SENSITIVE = "high"  # whatever any other suspects it suspects too, so all that may be asked is named
PACKAGE = Path(__file__).resolve().parents[1]


@dataclass(frozen=True)
class KeptLook:
    """What one frame showed and when, how long looking took, and what was known of the calibration by then."""

    moment: Moment
    look: Look
    ms: float
    fit: Fit | None

    def to_json(self) -> dict[str, Any]:
        fit = None if self.fit is None else [self.fit.error_px, self.fit.told, self.fit.corrected]
        return {"moment": self.moment.to_json(), "look": self.look.to_json(), "ms": round(self.ms, 2), "fit": fit}

    @classmethod
    def from_json(cls, data: Any) -> KeptLook:
        """Raises KeyError, TypeError, ValueError or RecordingError where this is none."""
        fit = None if data["fit"] is None else Fit(*data["fit"])
        return cls(Moment.from_json(data["moment"]), Look.from_json(data["look"]), float(data["ms"]), fit)


class Replay:
    """One recording, one set of settings. `checks` goes through it, looking only where nothing is kept.

    header : instead of the recording's own; mesh : compare with this model
    """

    def __init__(
        self, recording: Recording, settings: Settings, header: Header | None = None, mesh: MeshChoice | None = None
    ) -> None:
        self._recording, self._settings, self._mesh = recording, settings, mesh
        self._header = header or recording.header
        self._road: Road | None = None

    @property
    def road(self) -> Road:
        """How what must be seen is found. Raises GcodeError, MeshError, RecordingError."""
        if self._road is None:
            self._road = self._recording.road(self._mesh)
        return self._road

    def key(self) -> str:
        """Names everything that the looks are made of. Raises RecordingError where a frame is missing."""
        settings = {name: getattr(self._settings, name) for name in MATTERS}
        digest = hashlib.sha256(_program().encode())
        digest.update(json.dumps([self._header.to_json(), settings, _mesh_json(self._mesh)], sort_keys=True).encode())
        for path in (*self._recording.sources(), *([] if self._mesh is None else [self._mesh.path])):
            digest.update(_file_digest(path))
        for moment in self._recording.moments:
            digest.update(json.dumps(moment.to_json(), sort_keys=True).encode())
            digest.update(_file_digest(self._recording.frame_path(moment)))
        return digest.hexdigest()

    def kept(self) -> list[Check] | None:
        """The checks from what is kept; None where nothing fitting is."""
        try:
            data = json.loads(self._path.read_text(encoding="utf-8"))
            if data["key"] != self.key():
                return None
            looks = [KeptLook.from_json(one) for one in data["looks"]]
            objects = [str(name) for name in data["objects"]]
        except (OSError, ValueError, KeyError, TypeError, AttributeError, RecordingError):
            return None
        if len(looks) != len(self._recording.moments):
            return None
        checks = conclude(((kept.look, kept.moment) for kept in looks), self._settings.sensitivity, objects)
        return [replace(check, ms=kept.ms, fit=kept.fit) for check, kept in zip(checks, looks)]

    def looked(self, renderer: Any) -> Iterator[tuple[Check, Pictures | None]]:
        """The checks by looking, each with what it looked at; what the frames showed is kept when all are through.

        renderer : draws expected masks. Raises what `Inspector.check` raises.
        """
        key, road = self.key(), self.road
        settings = replace(self._settings, sensitivity=MOST_SENSITIVE)
        inspector = Inspector(
            self._header, road.toolpath, road.drawn_by(renderer), settings, self._recording.reference()
        )
        looks: list[KeptLook] = []
        concluding = conclude(_following(looks), self._settings.sensitivity, road.toolpath.objects)
        for moment in self._recording.moments:
            check = inspector.check(self._recording.frame(moment), road.moment(moment))
            assert inspector.look is not None
            looks.append(KeptLook(check.moment, inspector.look, check.ms, check.fit))
            pictures = inspector.pictures if check.comparison is not None else None
            yield replace(next(concluding), ms=check.ms, fit=check.fit), pictures
        self._keep(key, looks, road.toolpath.objects)

    def _keep(self, key: str, looks: Sequence[KeptLook], objects: Sequence[str]) -> None:
        data = {"key": key, "objects": list(objects), "looks": [one.to_json() for one in looks]}
        partial = self._path.with_name(FILE + ".part")
        # a recording that cannot be written to, or a full disk, costs the next replay some time and nothing else
        with contextlib.suppress(OSError):
            partial.write_text(json.dumps(data), encoding="utf-8")
            os.replace(partial, self._path)

    @property
    def _path(self) -> Path:
        return self._recording.folder / FILE


def _following(looks: list[KeptLook]) -> Iterator[tuple[Look, Moment]]:
    """Looks and their moments as they are added."""
    number = 0
    while True:
        yield looks[number].look, looks[number].moment
        number += 1


def _mesh_json(mesh: MeshChoice | None) -> Any:
    return None if mesh is None else [repr(mesh.placement), mesh.layer_height_mm]


def _file_digest(path: Path) -> bytes:
    try:
        return hashlib.sha256(path.read_bytes()).digest()
    except OSError:  # one that is missing is another than one that is there; who needs it says so
        return b"-"


@lru_cache(maxsize=1)
def _program() -> str:
    """Names this program: every module that has a say in what is seen, and the libraries that do its arithmetic."""
    digest = hashlib.sha256(f"{np.__version__} {cv2.__version__}".encode())
    for path in sorted([*PACKAGE.glob("core/**/*.py"), *PACKAGE.glob("machine/*.py")]):
        digest.update(path.relative_to(PACKAGE).as_posix().encode() + path.read_bytes())
    return digest.hexdigest()
