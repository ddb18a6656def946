"""What the set-up asks of an eye: thresholds tried on a picture, lens and pose found, things to calibrate with.

Each function answers one question; `blobs` are pictures as the webcam sent them. Modules that only one question needs
are imported by it.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2

from ..core.header import Printer
from ..core.segmentation.segment import HsvThresholds, segment_hsv
from .pictures import decode, encode_mask

if TYPE_CHECKING:
    from ..core.checks import Check
    from .replaying import Replay

Answer = tuple[dict[str, Any], list[bytes]]

NEEDS_HEIGHT = "The job cannot be read as G-code: enter the print's layer height, and the model alone is compared with."


def segment(blobs: list[bytes], material: dict[str, Any]) -> Answer:
    """The mask, as a PNG, that these thresholds give on a frame."""
    mask = segment_hsv(decode(blobs[0]), HsvThresholds.from_json(material))
    return {"filament_px": int(cv2.countNonZero(mask))}, [encode_mask(mask)]


def shrink(blobs: list[bytes], width_px: int) -> Answer:
    """The picture, JPEG, as a small one of that width."""
    frame = decode(blobs[0])
    height_px = max(1, round(width_px * frame.shape[0] / frame.shape[1]))
    small = cv2.resize(frame, (width_px, height_px), interpolation=cv2.INTER_AREA)
    return {}, [bytes(cv2.imencode(".jpg", small)[1])]


def validate(blobs: list[bytes], header: dict[str, Any], turned: dict[str, Any] | None = None) -> Answer:
    """The header of a recording, read and written again: what is missing or wrong in it is an error here.

    turned : how the pictures had been turned that its cameras were found on; the answer's are the unturned camera's.
    """
    from .recording import parse_header

    read = parse_header(header)
    if isinstance(turned, dict):
        from dataclasses import replace

        from ..core.view.orientation import Orientation

        back = Orientation(*(turned.get(name) is True for name in ("flip_h", "flip_v", "rotate_90"))).inverse
        read = replace(read, cameras=tuple((name, back.camera(camera)) for name, camera in read.cameras))
    return read.to_json(), []


def printer(blobs: list[bytes], profile: dict[str, Any]) -> Answer:
    """A header's `printer`, from OctoPrint's printer profile."""
    from ..core.calibration.plate import printer_from_profile

    return printer_from_profile(profile).to_json(), []


def markers(blobs: list[bytes], printer: dict[str, Any], plate: dict[str, Any]) -> Answer:
    """G-code of a marker plate for this printer, and where its markers will lie. plate: fields of PlateSettings."""
    from ..core.calibration.plate import PlateSettings, plate_gcode
    from ..core.errors import CalibrationError

    try:
        settings = PlateSettings(**plate)
    except TypeError as error:
        raise CalibrationError(f"The plate cannot be made so ({error}).") from None
    gcode, made = plate_gcode(Printer.from_json(printer), settings)
    return {"markers": made.to_json()}, [gcode.encode()]


def markers_around(blobs: list[bytes], printer: dict[str, Any], model: str) -> Answer:
    """A model with ring markers around it, STL, and where the markers will lie once it is sliced. model: its path."""
    from ..core.calibration.plate import PlateSettings
    from ..core.calibration.plate_mesh import model_with_markers

    mesh, made = model_with_markers(model, Printer.from_json(printer), PlateSettings())
    stl = mesh.export(file_type="stl")
    assert isinstance(stl, bytes)  # as it is for a binary format
    return {"markers": made.to_json()}, [stl]


def board_picture(blobs: list[bytes], board: str, square_mm: float) -> Answer:
    """A checkerboard to print on paper, SVG."""
    from ..core.calibration.board import board_svg
    from ..core.calibration.chessboard import Board

    return {}, [board_svg(Board.parse(board, square_mm)).encode()]


def find_board(blobs: list[bytes], board: str, square_mm: float) -> Answer:
    """Whether and where a checkerboard is seen: corners_px, null where it is not."""
    from ..core.calibration.chessboard import Board, find_corners

    frame = decode(blobs[0])
    corners_px = find_corners(frame, Board.parse(board, square_mm))
    found = None if corners_px is None else corners_px.reshape(-1, 2).round(2).tolist()
    return {"corners_px": found, "image_size_px": [frame.shape[1], frame.shape[0]]}, []


def lens(blobs: list[bytes], names: list[str], board: str, square_mm: float) -> Answer:
    """The lens, from pictures of a checkerboard: `moop calibrate lens --json`."""
    from ..core.calibration.calibrate import calibrate_lens
    from ..core.calibration.chessboard import Board

    pictures = [(name, decode(blob)) for name, blob in zip(names, blobs)]
    return calibrate_lens(pictures, Board.parse(board, square_mm), "auto").to_json(), []


def pose(
    blobs: list[bytes], lens: dict[str, Any], markers: dict[str, Any], material: dict[str, Any] | None = None
) -> Answer:
    """The camera's place, from a picture of the marker plate: `moop calibrate pose --json`."""
    from ..core.calibration.calibrate import Lens
    from ..core.calibration.markers import MarkerPlate
    from ..core.calibration.pose import calibrate_pose, calibrate_pose_any_colour

    frame, lens_found, plate = decode(blobs[0]), Lens.from_json(lens), MarkerPlate.from_json(markers)
    if material is None:
        return calibrate_pose_any_colour(frame, lens_found, plate).to_json(), []
    return calibrate_pose(frame, lens_found, plate, HsvThresholds.from_json(material)).to_json(), []


def points(blobs: list[bytes], points: Any, lens: dict[str, Any] | None = None, click_px: float = 2.0) -> Answer:
    """The camera's place, from points clicked on a picture: `moop calibrate points --json`."""
    from ..core.calibration.calibrate import Lens
    from ..core.calibration.clicks import Points, pose_from_points

    height, width = decode(blobs[0]).shape[:2]
    found = None if lens is None else Lens.from_json(lens)
    return pose_from_points(Points.from_json(points), (width, height), found, click_px).to_json(), []


def bed_motion(
    blobs: list[bytes], camera: dict[str, Any], printer: dict[str, Any], first_mm: list[float], second_mm: list[float]
) -> Answer:
    """Which way the bed moves, from two pictures at two positions of the machine; `camera` holds at the first."""
    from ..core.calibration.bedmotion import measure_bed_motion
    from ..core.camera import Camera

    first, second = (decode(blob) for blob in blobs)
    found = measure_bed_motion(
        first, second, Camera.from_json(camera), Printer.from_json(printer), first_mm, second_mm
    )  # fmt: skip
    return found.to_json(), []


def guides(blobs: list[bytes], printer: dict[str, Any], camera: dict[str, Any]) -> Answer:
    """The bed's grid and a box on it as this camera sees them, for a person to compare with the picture."""
    from ..core.calibration.guides import guides as find_guides
    from ..core.camera import Camera

    lines = find_guides(Camera.from_json(camera), Printer.from_json(printer))
    return {"lines": [line.to_json() for line in lines]}, []


def mesh(blobs: list[bytes], mesh: dict[str, Any], job: str | None) -> Answer:
    """What a model file holds, and what is wrong with it or with how it is placed: bytes, triangles, size_mm, notes.

    mesh : as MeshChoice reads it; the layer height is checked only where the job cannot be read
    """
    from ..core.errors import GcodeError
    from ..core.expected.placing import place
    from ..core.expected.solid import read_solid
    from ..core.gcode.read import read_gcode
    from .roads import MeshChoice, find_road

    choice = MeshChoice.from_json(mesh)
    solid = read_solid(choice.path)
    low, high = solid.bounds_mm()
    try:
        toolpath = None if job is None else read_gcode(Path(job))
    except GcodeError:
        toolpath = None
    if toolpath is not None:
        notes = place(solid, choice.placement, toolpath).notes
    elif choice.layer_height_mm is not None:
        notes = find_road(None, choice).notes
    else:
        notes = (*solid.notes, NEEDS_HEIGHT)
    return {
        "bytes": choice.path.stat().st_size, "triangles": len(solid.triangles_mm),
        "size_mm": [round(float(side), 3) for side in high - low], "notes": list(notes),
    }, []  # fmt: skip


def replay(
    blobs: list[bytes], recording: str, material: dict[str, Any], settings: dict[str, Any], masks: str
) -> Answer:
    """What would have been concluded from a recording with these settings and this filament: JSON, checks and a summary.

    masks : a folder for the masks of each check: 12.seen.png, 12.expected.png, 12.ignored.png. They do not depend on the
    sensitivity: those that are there stay where nothing else has changed. Folders beside it, of other recordings, go.
    """
    from dataclasses import replace

    from ..core.checks import Summary
    from ..core.errors import RecordingError
    from ..core.settings import read_settings
    from .recording import Recording
    from .replaying import Replay

    opened = Recording.open(recording)
    header = replace(opened.header, material=HsvThresholds.from_json(material))
    replaying, drawn_for = Replay(opened, read_settings(settings), header), Path(masks, "key")
    key = replaying.key()
    checks = replaying.kept() if drawn_for.is_file() and drawn_for.read_text() == key else None
    if checks is None:
        try:
            checks = _replayed(replaying, Path(masks))
            drawn_for.write_text(key)
        except OSError as error:
            raise RecordingError(f"There is no room for the pictures of a replay: {error.strerror or error}.") from None
    lines = [{**check.to_json(), "id": number} for number, check in enumerate(checks)]
    return {}, [json.dumps({"checks": lines, "summary": Summary.of(checks).to_json()}).encode()]


def _replayed(replaying: Replay, masks: Path) -> list[Check]:
    """The checks, by looking, with their masks in an empty folder. Raises OSError."""
    import shutil

    from .renderers import open_renderer

    for other in masks.parent.glob("*/"):  # those of one recording are enough
        shutil.rmtree(other, ignore_errors=True)
    masks.mkdir(parents=True)
    checks = []
    with open_renderer() as renderer:
        for number, (check, pictures) in enumerate(replaying.looked(renderer)):
            checks.append(check)
            if pictures is not None:
                kinds = {"seen": pictures.observed, "expected": pictures.expected, "ignored": pictures.ignored}
                for kind, mask in kinds.items():
                    (masks / f"{number}.{kind}.png").write_bytes(encode_mask(mask))
    return checks


QUESTIONS = {
    question.__name__: question
    for question in (
        *(segment, validate, printer, markers, board_picture, find_board, lens, pose, points, bed_motion, guides),
        *(markers_around, mesh, shrink, replay),
    )
}
