"""Does the camera stand where it stood? How far it turned, and the frame as the calibrated camera would have seen it.

A camera that is knocked turns much more than it travels, so its motion is modelled as a rotation about its centre:
then every pixel's new place follows from three numbers, whatever the depth of what it shows (Hartley and Zisserman,
Multiple View Geometry, section 8.4). The three are found by direct alignment of what does not belong to the print
(Lucas and Kanade 1981 in the form of Baker and Matthews 2004), coarse to fine, with weights that make outliers of a
gantry, a hand and whatever else moves by itself. In nearly all frames a glance at a few of those pixels tells that the
camera stands where it last stood.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from ..camera import BedMotion, Camera
from .glance import Glance, shrunk
from .landmarks import MOST_CONTRAST, Aim, Level, Relief, in_level, strongest_in_each_cell

SCALES = (8, 4, 2)  # of the image pyramid at 640 pixels across, coarse to fine
COARSEST, FINEST = 0, len(SCALES) - 1
SEARCH_PX, SEARCH_STEP_PX = 48, 16  # at 640 pixels across: where a first guess is looked for
GUESS_POINTS = 250
ITERATIONS = 12
GLANCE_EVERY = 3  # of the pixels, to tell that nothing has moved
NOTICEABLE_PX = 0.4
# in contrasts: a picture that fits no better at half of the pixels, or so much less well than it did, is looked at closely
MOST_MISFIT, LESS_WELL = 0.6, 1.25
WARP_GRID = 16  # the warp is smooth: it is computed on a coarse grid and interpolated


@dataclass(frozen=True, eq=False)
class CameraTurn:
    """How the camera has turned since the reference picture.

    rvec      : (3,) float64, radians: rotates directions of the calibrated camera into the turned one
    motion_px : by how much a pixel has moved, root mean square over the picture; 0 where it stands still
    """

    rvec: np.ndarray
    motion_px: float


STILL = CameraTurn(np.zeros(3), 0.0)

Part = tuple  # (slice, slice): rows and columns of the whole picture


class Stabiliser:
    """Compares frames with a reference picture of the same camera."""

    def __init__(
        self,
        camera: Camera,
        bed: BedMotion,
        bed_mm: Sequence[Sequence[float]],
        reference_bgr: np.ndarray,
        reference_position_mm: Sequence[float],
        exclude: np.ndarray,
    ) -> None:
        """reference_bgr : (H, W, 3) uint8; exclude : (H, W) uint8, 255 where the print is or will be; bed_mm : x
        and y of the bed's front left and of its back right corner"""
        self._camera, self._bed = camera, bed
        background = cv2.bitwise_not(cv2.dilate(exclude, np.ones((15, 15), np.uint8)))
        shift_mm = bed.room_from_print_mm(reference_position_mm)
        glance = Glance(reference_bgr)
        self._finer = glance.finer
        self._levels = [
            self._level(scale * glance.finer, relief.all(), background, shift_mm, bed_mm)
            for scale, relief in zip(SCALES, _Pyramid(glance).reliefs)
        ]
        self._aim = Aim(camera, self._levels, shift_mm)
        grid_px = self._grid_px()
        self._grid_rays, self._grid = camera.rays(grid_px), grid_px
        self._undone: tuple[CameraTurn, dict] = STILL, {}
        self._fits: dict[CameraTurn, float] = {}  # how well the picture fitted at the last turn, at best

    def _level(
        self,
        scale: int,
        grey: np.ndarray,
        background: np.ndarray,
        shift_mm: np.ndarray,
        bed_mm: Sequence[Sequence[float]],
    ) -> Level:
        right, down = (cv2.Sobel(grey, cv2.CV_32F, *axis, scale=1 / 8) for axis in ((1, 0), (0, 1)))
        gradient = np.stack([right, down], -1)
        strength = (gradient**2).sum(-1)
        strength[cv2.resize(background, grey.shape[::-1], interpolation=cv2.INTER_NEAREST) == 0] = 0
        strength[:2], strength[-2:], strength[:, :2], strength[:, -2:] = 0, 0, 0, 0
        rows, columns = strongest_in_each_cell(strength)
        pixels = (np.column_stack([columns, rows]) + 0.5) * scale - 0.5
        rays = self._camera.rays(pixels)
        slope = np.sqrt(strength[rows, columns]) / scale
        return Level(
            scale, rays, self._bed_points_mm(rays, shift_mm, bed_mm),
            grey[rows, columns], slope, gradient[rows, columns] / (slope * scale)[:, None],
        )  # fmt: skip

    def _bed_points_mm(self, rays: np.ndarray, shift_mm: np.ndarray, bed_mm: Sequence[Sequence[float]]) -> np.ndarray:
        """(n, 3): where each ray meets the bed's surface, in print coordinates; NaN where it does not."""
        rays_room = rays @ cv2.Rodrigues(self._camera.rvec)[0]
        centre = self._camera.centre_mm
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = (shift_mm[2] - centre[2]) / rays_room[:, 2]
            points = centre + rays_room * depth[:, None] - shift_mm
            on_bed = (depth > 0) & ((points[:, :2] >= bed_mm[0]) & (points[:, :2] <= bed_mm[1])).all(axis=1)
        points[~on_bed] = np.nan
        return points

    def turn(self, glance: Glance, position_mm: Sequence[float], last: CameraTurn = STILL) -> CameraTurn:
        """How the camera has turned since the reference was taken.

        position_mm : where the machine stands; last : the turn that the camera had last
        `last` itself where the camera has not moved since. STILL where the picture has too little structure to tell,
        or where turning explains nothing.
        """
        if len(self._levels[FINEST].grey) < 100:
            return STILL
        shift_mm = self._bed.room_from_print_mm(position_mm)
        if not np.array_equal(shift_mm, self._aim.shift_mm):
            self._aim = Aim(self._camera, self._levels, shift_mm)
        pyramid = _Pyramid(glance)
        if self._stands(pyramid[FINEST], last):
            return last
        guess = self._first_guess(pyramid[COARSEST], last.rvec)
        rvec = guess
        for number in range(len(SCALES)):
            rvec = self._align(number, pyramid[number], rvec, ITERATIONS)
        finest = pyramid[FINEST]
        if self._misfit(FINEST, finest, rvec) > 0.9 * self._misfit(FINEST, finest, np.zeros(3)):
            return STILL
        motion_px = self._motion_px(rvec)
        return CameraTurn(rvec, motion_px) if motion_px >= NOTICEABLE_PX else STILL

    def _stands(self, relief: Relief, last: CameraTurn) -> bool:
        """Whether the picture fits where it last did, and as well: the usual case, and the cheap one."""
        few = slice(None, None, GLANCE_EVERY)
        seen, inside = relief.at(self._aim.pixels(FINEST, few, (tuple(last.rvec),))[0])
        residual = seen - self._levels[FINEST].grey[few]
        misfit = float(np.median(np.abs(residual)))
        well = self._fits.get(last, np.inf)
        step = self._step(FINEST, residual, inside, few)
        stands = (
            misfit < LESS_WELL * min(well, MOST_MISFIT)
            and step is not None
            and float(np.linalg.norm(step)) * self._camera.K[0, 0] < NOTICEABLE_PX * self._finer
        )
        if stands:
            self._fits = {last: min(well, misfit)}
        return stands

    def _first_guess(self, relief: Relief, last: np.ndarray) -> np.ndarray:
        """(3,) the turn, on a coarse grid about the last one, under which the picture matches best; `last` where that is it."""
        few = slice(None, None, max(1, len(self._levels[COARSEST].grey) // GUESS_POINTS))
        far_px = 1.5 * SEARCH_STEP_PX
        near = [(0.0, 0.0), (far_px, 0.0), (-far_px, 0.0), (0.0, far_px), (0.0, -far_px)]
        here, *elsewhere = self._misfits(relief, few, last, near)
        if here < 0.8 * min(elsewhere):
            return last
        steps = range(-SEARCH_PX, SEARCH_PX + 1, SEARCH_STEP_PX)
        offsets = sorted(((right, down) for right in steps for down in steps), key=lambda offset: np.hypot(*offset))
        best = offsets[int(np.argmin(self._misfits(relief, few, last, offsets)))]
        return last if best == (0, 0) else last + self._turned_by(*best)

    def _misfits(
        self, relief: Relief, few: slice, last: np.ndarray, offsets_px: Sequence[tuple[float, float]]
    ) -> np.ndarray:
        """For each offset of the picture from the last turn, the median difference; what is out of the picture fits badly."""
        rvecs = tuple(tuple(last + self._turned_by(*offset)) for offset in offsets_px)
        seen, inside = relief.at(self._aim.pixels(COARSEST, few, rvecs))
        difference = np.abs(seen - self._levels[COARSEST].grey[few])
        difference[~inside] = 2 * MOST_CONTRAST
        middle = difference.shape[1] // 2
        return np.partition(difference, middle, axis=1)[:, middle]

    def _turned_by(self, right_px: float, down_px: float) -> np.ndarray:
        """(3,) the rotation vector that moves the picture's middle by so much, pixels at 640 across."""
        return np.array(
            [-down_px * self._finer / self._camera.K[1, 1], right_px * self._finer / self._camera.K[0, 0], 0.0]
        )

    def undo(
        self, picture_bgr: np.ndarray, turn: CameraTurn, part: Part | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """A picture of the whole view, large or small, as the calibrated camera would have seen it, or only the rows and
        columns `part` of that; and uint8 of the same height and width, 255 where it saw nothing."""
        if self._undone[0] is not turn:
            self._undone = turn, {}
        height, width = picture_bgr.shape[:2]
        rows, columns = part or (slice(0, height), slice(0, width))
        wanted = (width, height, rows.start, rows.stop, columns.start, columns.stop)
        if wanted not in self._undone[1]:
            self._undone[1][wanted] = self._maps(turn, (width, height), rows, columns)
        map_x, map_y, outside = self._undone[1][wanted]
        return cv2.remap(picture_bgr, map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), outside

    def _maps(
        self, turn: CameraTurn, size_px: tuple[int, int], rows: slice, columns: slice
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Two maps for cv2.remap, and where they lead out of the picture."""
        width, height = size_px
        scale = np.divide(size_px, self._camera.image_size_px)
        coarse = (self._displacement(turn.rvec) * scale).astype(np.float32)
        fine = cv2.resize(coarse, size_px, interpolation=cv2.INTER_LINEAR)[rows, columns]
        x = fine[..., 0] + np.arange(width, dtype=np.float32)[columns]
        y = fine[..., 1] + np.arange(height, dtype=np.float32)[rows, None]
        outside = (x < 0) | (y < 0) | (x > width - 1) | (y > height - 1)
        return (*cv2.convertMaps(x, y, cv2.CV_16SC2), np.where(outside, np.uint8(255), np.uint8(0)))

    def _residual(self, number: int, relief: Relief, rvec: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(n,) difference of grey value and (n,) whether the pixel is in the picture."""
        level = self._levels[number]
        pixels = in_level(self._camera.turned(rvec).project(self._aim.rays(number)), level.scale)
        seen, inside = relief.at(pixels)
        return seen - level.grey, inside

    def _align(self, number: int, relief: Relief, rvec: np.ndarray, iterations: int) -> np.ndarray:
        """Gauss-Newton from `rvec` on the distance that each pixel's edge has moved along its normal.

        In distances, not in grey values: a bright rod that moves by itself must not outweigh a dim bed that stands.
        """
        if len(self._levels[number].slope) < 30:
            return rvec
        for _ in range(iterations):
            residual, inside = self._residual(number, relief, rvec)
            step = self._step(number, residual, inside)
            if step is None:
                return rvec
            rvec = rvec + step
            if np.linalg.norm(step) * self._camera.K[0, 0] < 0.02:
                break
        return rvec

    def _step(
        self, number: int, residual: np.ndarray, inside: np.ndarray, few: slice = slice(None)
    ) -> np.ndarray | None:
        """(3,) the turn that takes most of the residual away; None where the pixels cannot tell."""
        jacobian, distance = self._aim.jacobian(number)[few], residual / self._levels[number].slope[few]
        weighted = jacobian * (_tukey(distance) * inside)[:, None]
        hessian = jacobian.T @ weighted
        if np.linalg.cond(hessian) > 1e8:
            return None
        return -np.linalg.solve(hessian, weighted.T @ distance)

    def _misfit(self, number: int, relief: Relief, rvec: np.ndarray) -> float:
        residual, inside = self._residual(number, relief, rvec)
        return float(np.median(np.abs(residual[inside]))) if inside.any() else np.inf

    def _grid_px(self) -> np.ndarray:
        """(WARP_GRID², 2) float64: a grid over the view, where cv2.resize expects the pixels that it interpolates between."""
        width, height = self._camera.image_size_px
        x = (np.arange(WARP_GRID) + 0.5) * width / WARP_GRID - 0.5
        y = (np.arange(WARP_GRID) + 0.5) * height / WARP_GRID - 0.5
        return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)

    def _displacement(self, rvec: np.ndarray) -> np.ndarray:
        """(WARP_GRID, WARP_GRID, 2) float64 pixels: by how much a grid over the calibrated view has moved."""
        moved = self._camera.turned(rvec).project(self._grid_rays) - self._grid
        return np.nan_to_num(moved).reshape(WARP_GRID, WARP_GRID, 2)

    def apart_px(self, one: CameraTurn, other: CameraTurn) -> float:
        """By how much a pixel moves between two turns, root mean square over the picture."""
        return 0.0 if one is other else self._apart_px(one.rvec, other.rvec)

    def _apart_px(self, one: np.ndarray, other: np.ndarray) -> float:
        difference = self._displacement(one) - self._displacement(other)
        return float(np.sqrt(np.mean(np.sum(difference**2, axis=-1))))

    def _motion_px(self, rvec: np.ndarray) -> float:
        return float(np.sqrt(np.mean(np.sum(self._displacement(rvec) ** 2, axis=-1))))


class _Pyramid:
    """The reliefs of a frame at each of SCALES, each made when it is asked for."""

    def __init__(self, glance: Glance) -> None:
        self._greys = [cv2.cvtColor(glance.half, cv2.COLOR_BGR2GRAY)]
        self._reliefs: dict[int, Relief] = {}
        for _ in SCALES[1:]:
            self._greys.insert(0, shrunk(self._greys[0], 2))

    def __getitem__(self, number: int) -> Relief:
        if number not in self._reliefs:
            self._reliefs[number] = Relief.of(self._greys[number])
        return self._reliefs[number]

    @property
    def reliefs(self) -> list[Relief]:
        return [self[number] for number in range(len(SCALES))]


def _tukey(residual: np.ndarray) -> np.ndarray:
    """Tukey's biweight, scaled by the median absolute deviation (Huber 1981)."""
    scale = 1.4826 * float(np.median(np.abs(residual))) + 1e-6
    ratio = np.clip(residual / (4.685 * scale), -1, 1)
    return (1 - ratio**2) ** 2
