"""Ring markers that are printed with the part, found in the job's own G-code, and the camera's place from them.

Nothing need be attached to a job: four rings of one size that stand alone on the bed are markers, whoever put them
there and wherever a slicer moved them to. Where they are seen as they must lie on one bed, the camera's place is found
anew for this print (Lyngby et al. 2017, section 2.4).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..camera import Camera
from ..errors import CalibrationError, CameraError
from ..segmentation.segment import HsvThresholds
from ..toolpath import Role, Toolpath
from .calibrate import Lens
from .markers import MarkerPlate
from .pose import PoseResult, calibrate_pose, calibrate_pose_any_colour

HIGHEST_MM, LEAST_MM = 6.0, 0.15  # of a marker
WIDEST_MM, NARROWEST_MM = 60.0, 6.0
ROUND_MM, SAME_MM = 0.12, 0.3  # how round a loop must be; within which circles are of one marker
LEAST_SIDES = 12
FEWEST = 4
ATTEMPTS = 4  # checks in which the markers are looked for, until they are found
WORST_RMS_PX, WORST_ERROR_PX = 1.0, 3.0  # at 640 pixels across


@dataclass(frozen=True)
class _Circle:
    x: float
    y: float
    radius_mm: float
    width_mm: float
    z_mm: float


def markers_in(toolpath: Toolpath) -> MarkerPlate | None:
    """The plate of four or more equal rings that a print lays on the bed; None where there is none."""
    stacks: list[list[_Circle]] = []
    for circle in _circles(toolpath):
        for stack in stacks:
            if np.hypot(stack[0].x - circle.x, stack[0].y - circle.y) < SAME_MM:
                stack.append(circle)
                break
        else:
            stacks.append([circle])
    rings = [ring for stack in stacks if (ring := _ring(stack, toolpath)) is not None]
    best: list[np.ndarray] = []
    for ring in rings:  # the largest set of one size and height
        alike = [other for other in rings if (np.abs(other[2:] - ring[2:]) < [SAME_MM, SAME_MM, 0.05]).all()]
        best = max(best, alike, key=len)
    if len(best) < FEWEST:
        return None
    x_y = np.array(best)[:, :2]
    outer_mm, hole_mm, height_mm = np.median(np.array(best)[:, 2:], axis=0)
    try:
        return MarkerPlate(
            round(float(outer_mm), 3), round(float(height_mm), 3), x_y.round(3), round(float(hole_mm), 3)
        )
    except CalibrationError:  # in one line, or overlapping: no plate
        return None


def _ring(stack: list[_Circle], toolpath: Toolpath) -> np.ndarray | None:
    """x, y, outer diameter, hole diameter, height; None where these circles are no ring that stands alone."""
    heights = sorted({circle.z_mm for circle in stack})
    first = float(toolpath.layer_z_mm[0])
    layers = toolpath.layer_z_mm[(toolpath.layer_z_mm >= first - 1e-3) & (toolpath.layer_z_mm <= heights[-1] + 1e-3)]
    if len(heights) != len(layers) or heights[0] > first + 1e-3 or heights[-1] < LEAST_MM:
        return None
    outer, hole = [], []
    for z_mm in heights:
        here = [circle for circle in stack if circle.z_mm == z_mm]
        outer.append(2 * max(circle.radius_mm + circle.width_mm / 2 for circle in here))
        hole.append(2 * min(circle.radius_mm - circle.width_mm / 2 for circle in here))
    x, y = float(np.median([circle.x for circle in stack])), float(np.median([circle.y for circle in stack]))
    outer_mm, hole_mm = float(np.median(outer)), float(np.median(hole))
    if not (NARROWEST_MM <= outer_mm <= WIDEST_MM and 1.0 < hole_mm < outer_mm - 2.0):
        return None
    # Nothing in the hole, nothing on top, nothing touching.
    beads = toolpath.beads_mm
    near = np.hypot((beads[:, 0] + beads[:, 3]) / 2 - x, (beads[:, 1] + beads[:, 4]) / 2 - y)
    within = near < outer_mm / 2 + 0.5
    above = within & (beads[:, 5] > heights[-1] + 1e-3)
    in_hole = (near < 0.7 * hole_mm / 2) | (within & (near > outer_mm / 2 + 0.2))
    if above.any() or (in_hole & (beads[:, 5] <= heights[-1] + 1e-3)).any():
        return None
    return np.array([x, y, outer_mm, hole_mm, heights[-1]])


def _circles(toolpath: Toolpath) -> Iterator[_Circle]:
    """Loops of the lowest millimetres that are circles."""
    low = np.flatnonzero((toolpath.beads_mm[:, 5] <= HIGHEST_MM) & (toolpath.role != Role.SUPPORT))
    if not low.size:
        return
    beads = np.asarray(toolpath.beads_mm[low], np.float64)
    linked = (np.abs(beads[1:, :2] - beads[:-1, 3:5]).max(axis=1) < 0.02) & (
        np.abs(beads[1:, 5] - beads[:-1, 5]) < 1e-3
    )
    starts = np.concatenate([[0], np.flatnonzero(~linked) + 1])
    ends = np.append(starts[1:], len(beads))
    for start, end in zip(starts, ends):
        if end - start < LEAST_SIDES:
            continue
        run = beads[start:end]
        # Several turns may follow each other without a break: each begins where the last one's start comes round.
        yield from _turns(run)


def _turns(run: np.ndarray) -> Iterator[_Circle]:
    begin = 0
    while len(run) - begin >= LEAST_SIDES:
        points = run[begin:, 3:5]
        first, width = run[begin, :2], float(run[begin, 6])
        away = np.hypot(*(points - first).T)
        left = np.flatnonzero(away > 2 * width)
        if not left.size:
            return
        back = np.flatnonzero(away[left[0] :] < 1.2 * width)
        if not back.size:
            return
        last = left[0] + int(back[0])
        while last + 1 < len(away) and away[last + 1] < away[last]:
            last += 1
        loop = run[begin : begin + last + 1]
        begin += last + 1
        if len(loop) < LEAST_SIDES:
            continue
        x, y = loop[:, 3], loop[:, 4]
        # Kåsa's circle: x² + y² = 2 a x + 2 b y + c
        design = np.column_stack([2 * x, 2 * y, np.ones(len(loop))])
        centre_x, centre_y, rest = np.linalg.lstsq(design, x * x + y * y, rcond=None)[0]
        radius_sq = rest + centre_x**2 + centre_y**2
        if radius_sq <= 0:
            continue
        radius = float(np.sqrt(radius_sq))
        if radius < WIDEST_MM and np.abs(np.hypot(x - centre_x, y - centre_y) - radius).max() < ROUND_MM:
            # A polygon's sides lie within its circle.
            radius -= radius * (np.pi / len(loop)) ** 2 / 3
            yield _Circle(
                float(centre_x), float(centre_y), radius, float(np.median(loop[:, 6])), round(float(loop[0, 5]), 3)
            )


class PrintedMarkers:
    """The markers of one print before one camera, looked for at its first checks."""

    def __init__(self, toolpath: Toolpath, material: HsvThresholds | None) -> None:
        self._plate, self._material = markers_in(toolpath), material
        self._attempts = 0

    def wanted(self, top_mm: float) -> bool:
        """Whether it is worth a look now; top_mm : the print's height by now."""
        return self._plate is not None and self._attempts < ATTEMPTS and top_mm >= LEAST_MM

    def camera(self, picture_bgr: np.ndarray, camera: Camera, pose_mm: np.ndarray, top_mm: float) -> Camera | None:
        """Where the camera stands by this picture; None where it does not tell surely.

        camera : the one that was set up, for its lens; pose_mm : (3,) to be added to the print for the bed's place
        """
        assert self._plate is not None
        self._attempts += 1
        plate = self._plate
        if top_mm < plate.height_mm:  # the rings are not complete yet: flatter, but just as round
            plate = MarkerPlate(plate.outer_diameter_mm, top_mm, plate.centres_mm, plate.hole_diameter_mm)
        try:
            found = self._pose(picture_bgr, Lens.of(camera), plate)
        except (CalibrationError, CameraError):
            return None
        finer = max(1.0, camera.image_size_px[0] / 640)
        if (
            None in found.markers_px
            or found.rms_px > WORST_RMS_PX * finer
            or found.error_px[1] > WORST_ERROR_PX * finer
        ):
            return None
        self._attempts = ATTEMPTS
        seen = found.camera
        return Lens.of(seen).at(seen.rvec, seen.tvec_mm - seen.camera_from_room[:3, :3] @ pose_mm)

    def _pose(self, picture_bgr: np.ndarray, lens: Lens, plate: MarkerPlate) -> PoseResult:
        if self._material is not None:
            try:
                found = calibrate_pose(picture_bgr, lens, plate, self._material)
                if None not in found.markers_px:
                    return found
            except CalibrationError:
                pass
        return calibrate_pose_any_colour(picture_bgr, lens, plate)
