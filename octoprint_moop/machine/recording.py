"""A recording on disk, as FORMATS.md, section 3, fixes it: read here by everything that works offline."""

from __future__ import annotations

import gzip
import json
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..core.errors import CameraError, FrameError, MoopError, RecordingError
from ..core.expected.placing import Placement
from ..core.expected.solid import read_solid
from ..core.header import Header, Moment
from .pictures import MOST_PX, decode
from .roads import MeshChoice, Road, find_road


@dataclass(frozen=True)
class Recording:
    """A recording that was found sound: its header is read, its moments are in time order."""

    folder: Path
    header: Header
    moments: tuple[Moment, ...]

    @classmethod
    def open(cls, folder: Path | str) -> Recording:
        """Raises RecordingError or CameraError that names the file and what to do."""
        folder = Path(folder)
        if not folder.is_dir():
            raise RecordingError(f"{folder}: there is no such folder. Name a recording's folder, with recording.json.")
        header = _read_header(folder / "recording.json")
        return cls(folder, header, tuple(_read_moments(folder / "frames.jsonl")))

    @property
    def mesh_path(self) -> Path | None:
        path = self.folder / "model.stl"
        return path if path.is_file() else None

    @contextmanager
    def job_path(self) -> Iterator[Path]:
        """The G-code file; a compressed one is unpacked beside the temporary files for as long as it is needed."""
        plain = self._inside(self.header.job_file)
        packed = plain.with_name(plain.name + ".gz")
        if plain.is_file():
            yield plain
            return
        if not packed.is_file():
            raise RecordingError(f"{plain}: there is no such file. A recording needs the G-code as it was printed.")
        with tempfile.TemporaryDirectory(prefix="moop-") as scratch:
            unpacked = Path(scratch) / plain.name
            try:
                with gzip.open(packed, "rb") as source, open(unpacked, "wb") as target:
                    shutil.copyfileobj(source, target)
            except (OSError, EOFError) as error:
                raise RecordingError(f"{packed}: cannot be unpacked ({error}). Copy the recording again.") from None
            yield unpacked

    def road(self, mesh: MeshChoice | None = None) -> Road:
        """How what must be seen is found: as live, or by this mesh. Raises GcodeError, MeshError, RecordingError."""
        if mesh is None and self.header.mesh is not None:
            mesh = MeshChoice(self._inside(self.header.mesh.file), Placement(), self.header.mesh.layer_height_mm)
            low, high = read_solid(mesh.path).bounds_mm()  # as placed: it stays there
            mesh = replace(mesh, placement=Placement(*((low + high) / 2)[:2].tolist()))
        if mesh is not None and not self.header.job_file:
            return find_road(None, mesh)
        with self.job_path() as path:
            return find_road(path, mesh)

    def reference(self) -> np.ndarray | None:
        """The empty bed, (H, W, 3) uint8 BGR, or None where the recording has no picture of it."""
        path = self.folder / "reference.jpg"
        return read_frame(path) if path.is_file() else None

    def moment(self, frame: str) -> Moment:
        """Raises RecordingError where no line of frames.jsonl has that frame."""
        for moment in self.moments:
            if moment.frame == frame:
                return moment
        raise RecordingError(f"{self.folder / 'frames.jsonl'}: no line names the frame {frame!r}.")

    def frame(self, moment: Moment) -> np.ndarray:
        """(H, W, 3) uint8 BGR. Raises RecordingError where the picture is missing or damaged."""
        return read_frame(self.frame_path(moment))

    def frame_path(self, moment: Moment) -> Path:
        """Raises RecordingError where its name leads out of the recording."""
        return self._inside(moment.frame)

    def sources(self) -> tuple[Path, ...]:
        """What the frames are compared with: the job, plain or packed, the empty bed, a model; where there are any."""
        names = ["reference.jpg"]
        if self.header.job_file:
            names += [self.header.job_file, f"{self.header.job_file}.gz"]
        if self.header.mesh is not None:
            names.append(self.header.mesh.file)
        return tuple(path for path in map(self._inside, names) if path.is_file())

    def _inside(self, name: str) -> Path:
        """A file of this recording; a name that leads out of the folder is refused."""
        path = self.folder / name
        try:
            inside = path.resolve().is_relative_to(self.folder.resolve())
        except (OSError, ValueError):  # no name that a file could have
            inside = False
        if not inside:
            raise RecordingError(f"{self.folder}: the name {name!r} leads out of the recording.")
        return path


def read_frame(path: Path) -> np.ndarray:
    """(H, W, 3) uint8 BGR. Raises RecordingError where the picture is missing, damaged or too large."""
    try:
        return decode(path.read_bytes())
    except OSError as error:
        raise RecordingError(f"{path}: {error.strerror or error}.") from None
    except FrameError as error:
        raise RecordingError(f"{path}: {error}") from None


def _read_header(path: Path) -> Header:
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise RecordingError(f"{path}: there is no such file, so this folder is not a recording.") from None
    except (OSError, ValueError) as error:
        raise RecordingError(f"{path}: cannot be read as JSON ({error}).") from None
    try:
        return parse_header(data)
    except MoopError as error:
        raise type(error)(f"{path}: {error}") from None


def parse_header(data: Any) -> Header:
    """A header from somebody's JSON. Raises RecordingError or CameraError, whatever it is."""
    try:
        header = Header.from_json(data)
    except (AttributeError, KeyError, TypeError, ValueError, OverflowError) as error:
        raise RecordingError(
            f"The header makes no sense ({error}). Compare it with docs/formats.md, section 3."
        ) from None
    for _, camera in header.cameras:
        width, height = camera.image_size_px
        if width * height > MOST_PX:
            raise CameraError(
                f"The camera's image size is {width} x {height} px; {MOST_PX // 10**6} megapixels at most."
            )
    return header


def _read_moments(path: Path) -> Iterator[Moment]:
    """The moments in time order. A last line that a power cut left unfinished is passed over."""
    try:
        lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError as error:
        raise RecordingError(f"{path}: {error.strerror or error}.") from None
    for number, line in enumerate(lines, 1):
        if not line.strip():
            continue
        try:
            yield Moment.from_json(json.loads(line))
        except (AttributeError, KeyError, ValueError, RecordingError, TypeError) as error:
            if number == len(lines):
                return
            raise RecordingError(f"{path}, line {number}: {error}") from None
