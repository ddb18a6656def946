"""What is known before a print begins: the printer, the cameras, the filament. The header of a recording."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from .camera import BedMotion, Camera
from .errors import CameraError, RecordingError
from .head import HeadModel
from .segmentation.segment import HsvThresholds

FORMAT = "moop-recording"
VERSION = 1


@dataclass(frozen=True)
class Moment:
    """One line of frames.jsonl: which picture, and what the machine had done when it was taken.

    frame       : the picture's name within the recording
    file_pos    : every command that ends at or before it had been executed
    layer       : 0-based
    position_mm : the machine's X, Y, Z
    time_s      : since the print's start
    parked      : False where the head stood over the print
    camera      : name of the camera, None for the first
    again       : a second look at what the frame before it shows, in the same hold: see `Inspector.confirm`
    cancelled   : objects cancelled while printing, each with the file position from which on it is not printed
    sure_pos    : what ends after it may not have been executed yet; None where there is no doubt
    """

    frame: str
    file_pos: int
    layer: int
    position_mm: tuple[float, float, float]
    time_s: float = 0.0
    parked: bool = True
    camera: str | None = None
    cancelled: tuple[tuple[str, int], ...] = ()
    again: bool = False
    sure_pos: int | None = None

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Moment:
        """Raises RecordingError naming what is missing; keys that are not known are ignored."""
        try:
            position = data["position_mm"]
            return cls(
                frame=str(data["frame"]),
                file_pos=int(data["file_pos"]),
                layer=int(data["layer"]),
                position_mm=(float(position["x"]), float(position["y"]), float(position["z"])),
                time_s=float(data.get("time_s", 0.0)),
                parked=bool(data.get("parked", True)),
                camera=None if data.get("camera") is None else str(data["camera"]),
                cancelled=tuple(sorted((str(name), int(pos)) for name, pos in (data.get("cancelled") or {}).items())),
                again=bool(data.get("again", False)),
                sure_pos=None if data.get("sure_pos") is None else int(data["sure_pos"]),
            )
        except KeyError as missing:
            raise RecordingError(f"A line has no {missing.args[0]!r}.") from None
        except (TypeError, ValueError, AttributeError) as error:
            raise RecordingError(f"A line has a value that makes no sense ({error}).") from None

    def to_json(self) -> dict[str, Any]:
        x, y, z = self.position_mm
        data: dict[str, Any] = {
            "frame": self.frame, "file_pos": self.file_pos, "layer": self.layer,
            "position_mm": {"x": x, "y": y, "z": z}, "time_s": self.time_s, "parked": self.parked,
        }  # fmt: skip
        if self.camera is not None:
            data["camera"] = self.camera
        if self.cancelled:
            data["cancelled"] = dict(self.cancelled)
        if self.again:
            data["again"] = True
        if self.sure_pos is not None:
            data["sure_pos"] = self.sure_pos
        return data


@dataclass(frozen=True)
class Printer:
    """The machine's geometry: the part of OctoPrint's printer profile that matters here, and how the bed moves.

    head : the shape of its print head; None for that of the settings
    """

    width_mm: float
    depth_mm: float
    height_mm: float
    origin: str = "lowerleft"
    form_factor: str = "rectangular"
    bed: BedMotion = BedMotion()
    nozzle_mm: float = 0.4
    filament_mm: float = 1.75
    head: HeadModel | None = None

    @property
    def bed_low_mm(self) -> tuple[float, float]:
        """The bed's front left corner in print coordinates. A circular bed has its origin in the middle."""
        if self.form_factor == "circular" or self.origin == "center":
            return -self.width_mm / 2, -self.depth_mm / 2
        return 0.0, 0.0

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Printer:
        """Raises RecordingError naming what is missing or makes no sense, SettingsError for the head."""
        try:
            volume = data["volume_mm"]
            reference = data.get("bed_reference_mm") or {"x": 0.0, "y": 0.0, "z": 0.0}
            bed = BedMotion(
                str(data.get("bed_motion", "fixed")),
                (float(reference["x"]), float(reference["y"]), float(reference["z"])),
            )
            printer = cls(
                width_mm=float(volume["width"]), depth_mm=float(volume["depth"]), height_mm=float(volume["height"]),
                origin=str(data.get("origin", "lowerleft")), form_factor=str(data.get("form_factor", "rectangular")),
                bed=bed, nozzle_mm=float(data.get("nozzle_mm", 0.4)), filament_mm=float(data.get("filament_mm", 1.75)),
                head=HeadModel.from_json(data["head"]) if data.get("head") is not None else None,
            )  # fmt: skip
        except KeyError as missing:
            raise RecordingError(f"The printer has no {missing.args[0]!r}.") from None
        except (TypeError, ValueError, AttributeError) as error:
            raise RecordingError(f"The printer has a value that makes no sense ({error}).") from None
        except CameraError as error:
            raise RecordingError(str(error)) from None
        sizes = (printer.width_mm, printer.depth_mm, printer.height_mm, printer.nozzle_mm, printer.filament_mm)
        if not all(0 < size < 1e5 for size in sizes):
            raise RecordingError("The printer's volume, nozzle and filament must be positive millimetres.")
        return printer

    def to_json(self) -> dict[str, Any]:
        x, y, z = self.bed.reference_mm
        return {
            "volume_mm": {"width": self.width_mm, "depth": self.depth_mm, "height": self.height_mm},
            "origin": self.origin, "form_factor": self.form_factor,
            "bed_motion": self.bed.kind, "bed_reference_mm": {"x": x, "y": y, "z": z},
            "nozzle_mm": self.nozzle_mm, "filament_mm": self.filament_mm,
            **({} if self.head is None else {"head": self.head.to_json()}),
        }  # fmt: skip


@dataclass(frozen=True)
class UsedMesh:
    """A print was compared with a mesh: the recording's file, placed already, and the layer height that was needed."""

    file: str = "model.stl"
    layer_height_mm: float | None = None

    @classmethod
    def from_json(cls, data: Any) -> UsedMesh:
        """Raises RecordingError."""
        try:
            height = data.get("layer_height_mm")
            return cls(str(data.get("file", "model.stl")), None if height is None else float(height))
        except (AttributeError, TypeError, ValueError):
            raise RecordingError("The header's `mesh` needs `file`, and perhaps `layer_height_mm`.") from None

    def to_json(self) -> dict[str, Any]:
        return {"file": self.file, "layer_height_mm": self.layer_height_mm}


@dataclass(frozen=True)
class Header:
    """The header of a recording. `cameras` maps a camera's name to it; the first has the name None as well.

    reference_mm : where the machine stood when reference.jpg was taken; None for the bed's reference position
    mesh : None where the G-code alone told what must be seen
    """

    printer: Printer
    cameras: tuple[tuple[str | None, Camera], ...]
    material: HsvThresholds | None
    job_file: str = "job.gcode"
    job_bytes: int = 0
    reference_mm: tuple[float, float, float] | None = None
    mesh: UsedMesh | None = None

    @classmethod
    def from_json(cls, data: Any) -> Header:
        """Raises RecordingError or CameraError naming what is missing, unknown or makes no sense."""
        if not isinstance(data, Mapping):
            raise RecordingError("The header must be a JSON object.")
        if data.get("format") != FORMAT or data.get("version") != VERSION:
            raise RecordingError(
                f"This is format {data.get('format')!r}, version {data.get('version')!r}; "
                f"{FORMAT!r}, version {VERSION}, can be read. A newer release may know it."
            )
        for key in ("printer", "camera"):
            if not data.get(key):
                raise RecordingError(f"The header has no {key!r}. Run the set-up, or take over a whole one.")
        cameras: list[tuple[str | None, Camera]] = [(None, Camera.from_json(data["camera"]))]
        for named in data.get("cameras") or ():
            try:
                cameras.append((str(named["name"]), Camera.from_json(named["camera"])))
            except (KeyError, TypeError):
                raise RecordingError("Each of the header's `cameras` needs a name and a camera.") from None
        job = data.get("job") or {}
        try:
            stood = (data.get("reference") or {}).get("position_mm")
            reference_mm = None if stood is None else (float(stood["x"]), float(stood["y"]), float(stood["z"]))
        except (KeyError, TypeError, ValueError, AttributeError):
            raise RecordingError("The header's `reference` needs a position_mm with x, y and z.") from None
        return cls(
            printer=Printer.from_json(data["printer"]),
            cameras=tuple(cameras),
            material=HsvThresholds.from_json(data["material"]) if data.get("material") else None,
            job_file=str(job.get("file", "job.gcode")),
            job_bytes=int(job.get("bytes", 0)),
            reference_mm=reference_mm,
            mesh=UsedMesh.from_json(data["mesh"]) if data.get("mesh") else None,
        )

    def to_json(self) -> dict[str, Any]:
        data: dict[str, Any] = {
            "format": FORMAT, "version": VERSION,
            "job": {"file": self.job_file, "bytes": self.job_bytes},
            "printer": self.printer.to_json(), "camera": self.camera().to_json(),
        }  # fmt: skip
        named = [{"name": name, "camera": camera.to_json()} for name, camera in self.cameras if name is not None]
        if named:
            data["cameras"] = named
        if self.material is not None:
            data["material"] = self.material.to_json()
        if self.reference_mm is not None:
            data["reference"] = {"position_mm": dict(zip("xyz", self.reference_mm))}
        if self.mesh is not None:
            data["mesh"] = self.mesh.to_json()
        return data

    def camera(self, name: str | None = None) -> Camera:
        """Raises RecordingError where no camera has that name."""
        for known, camera in self.cameras:
            if known == name:
                return camera
        raise RecordingError(f"The header has no camera named {name!r}.")
