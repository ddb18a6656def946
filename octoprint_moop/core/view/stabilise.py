"""Does the camera stand where it stood? How far it turned, and the frame as the calibrated camera would have seen it.

A camera that is knocked turns much more than it travels, so its motion is modelled as a rotation about its centre:
then every pixel's new place follows from three numbers, whatever the depth of what it shows (Hartley and Zisserman,
Multiple View Geometry, section 8.4). The three are found by direct alignment of what does not belong to the print
(Lucas and Kanade 1981 in the form of Baker and Matthews 2004), coarse to fine, with weights that make outliers of a
gantry, a hand and whatever else moves by itself. In nearly all frames a glance at a few of those pixels tells that the
camera stands where it last stood.

Only pixels that tell the camera's place have a say: those that would differ a few pixels off by much more than they do
while it stands, which is learned as frames come. So neither noise nor a gantry votes. Differences are counted in
variances, each up to a limit, so that sums of them compare likelihoods; a turn is believed where several regions of the
picture, each by itself, find it likelier than that the camera stands where it stood, and hardly any the contrary.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from ..camera import BedMotion, Camera
from .glance import Glance, shrunk
from .landmarks import MOST_CONTRAST, Aim, Level, Relief, in_level, noise, region_of, strongest_in_each_cell
from .turns import STILL, CameraTurn, Turns

SCALES = (4, 2, 1)  # of the image pyramid, coarse to fine, against the finest: about 320 pixels across
COARSEST, FINEST = 0, len(SCALES) - 1
SMALL_PX = 480  # pictures no wider are not looked at in smaller
SEARCH_PX, SEARCH_STEP_PX = 48, 16  # at 640 pixels across: where a first guess is looked for
GUESS_POINTS, ALIGN_POINTS = 300, 700
ITERATIONS, ENOUGH_PX = 12, 0.03  # px of the level
GLANCE_EVERY = 3  # of the pixels, to tell that nothing has moved
NOTICEABLE_PX = 0.4  # at 640 pixels across
LEAST_POINTS = 60  # that tell; with fewer nothing is said of the camera
BESIDE_PX = 2.0  # px of the level: how far off a pixel must look otherwise
LEAST_NOISE, LEAST_APART_RATIO = (
    0.5,
    0.04,
)  # grey levels, and of what a pixel looks like beside: until frames have shown it
MOST_LOSS = 9.0  # of a pixel, in variances
WELL, LESS_WELL, BADLY = 1.3, 1.5, 3.3  # mean loss: as expected; times the usual; never that of a camera that stands
FITS, LOST_RATIO = 2.5, 0.25  # mean loss of a region; of the regions, so few fit if the camera is nowhere near
SPEAKING, SPEAKING_RATIO, FITTING_RATIO = 5, 6, 0.4  # regions for a turn, and against those not; pixels that must fit
REGION_POINTS = 6
FINEST_EDGE_PX = 0.25  # px of the level: no pixel tells its place better
LEAST_CONTRAST = 0.2
LEARN_AT_FIRST, LEARN_EVERY = 6, 8  # frames
REACH_PX = 40.0  # at 640 pixels across: a turn by more calls for much evidence
CORRELATED, UNCERTAIN_PX = (
    6.0,
    0.4,
)  # neighbours err alike: so many count as one; the turn's standard deviation, at most


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
        self._px = glance.finer if reference_bgr.shape[1] >= 640 else reference_bgr.shape[1] / 640
        pyramid = _Pyramid(glance)
        self._contrast = 1.0
        self._levels = [self._level(pyramid, number, background, shift_mm, bed_mm) for number in range(len(SCALES))]
        self._aim = Aim(camera, self._levels, shift_mm)
        self.turns = Turns(camera)
        self._usual: dict[CameraTurn, float] = {}  # the mean loss at the last turn, at best
        self._learned = 0
        self.sure = False
        """Whether the last frame told where the camera stands."""
        self.lost = False
        """Whether nearly nothing is where it was, in a view that was known before, and where it went cannot be told."""
        self._known = False

    def _level(
        self, pyramid: _Pyramid, number: int, background: np.ndarray, shift_mm: np.ndarray,
        bed_mm: Sequence[Sequence[float]],
    ) -> Level:  # fmt: skip
        relief, scale = pyramid[number], pyramid.scale(number)
        height, most = relief.height, MOST_CONTRAST * float(cv2.meanStdDev(relief.height)[1][0, 0])
        height = np.clip(height, -most, most)
        right, down = (cv2.Sobel(height, cv2.CV_32F, *axis, scale=1 / 8) for axis in ((1, 0), (0, 1)))
        gradient = np.stack([right, down], -1)
        strength = (gradient**2).sum(-1)
        strength[cv2.resize(background, height.shape[::-1], interpolation=cv2.INTER_NEAREST) == 0] = 0
        strength[:2], strength[-2:], strength[:, :2], strength[:, -2:] = 0, 0, 0, 0
        rows, columns = strongest_in_each_cell(strength)
        pixels = (np.column_stack([columns, rows]) + 0.5) * scale - 0.5
        rays, heights = self._camera.rays(pixels), height[rows, columns]
        slope = np.sqrt(strength[rows, columns]) / scale
        beside = self._beside(relief, np.column_stack([columns, rows]).astype(np.float32), heights)
        # not known yet: the noise of two frames, and some of what structure makes of a picture that is not quite in place
        apart = 2 * noise(pyramid.grey(number)) ** 2 + LEAST_APART_RATIO * beside + LEAST_NOISE**2
        return Level(
            scale, rays, self._bed_points_mm(rays, shift_mm, bed_mm), heights, slope,
            gradient[rows, columns] / (slope * scale)[:, None], region_of(rows, columns, height.shape),
            apart.astype(np.float32), beside,
        )  # fmt: skip

    def _beside(self, relief: Relief, pixels: np.ndarray, height: np.ndarray) -> np.ndarray:
        """(n,) float32: the mean squared difference from `height` around each pixel, some way off."""
        steps = np.array([[BESIDE_PX, 0], [-BESIDE_PX, 0], [0, BESIDE_PX], [0, -BESIDE_PX]], np.float32)
        seen, _ = relief.at(pixels[None] + steps[:, None])
        return (self._residual(seen, height) ** 2).mean(axis=0)

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
        `last` itself where the camera has not moved since, or where the picture does not tell; see `sure` and `lost`.
        """
        self.lost = False
        shift_mm = self._bed.room_from_print_mm(position_mm)
        if not np.array_equal(shift_mm, self._aim.shift_mm):
            self._aim = Aim(self._camera, self._levels, shift_mm)
        pyramid = _Pyramid(glance)
        if self._stands(pyramid, last):
            self._learn(pyramid, last)
            return last
        old = self._losses(pyramid, last.rvec)
        badly = self._known and bool(old.mean() > BADLY)
        starts = [last.rvec]
        for start in (self._first_guess(pyramid[COARSEST], last.rvec), STILL.rvec):
            if all(self.turns.apart_px(start, other) > SEARCH_STEP_PX / 2 * self._px for other in starts):
                starts.append(start)
        found = [self._aligned(pyramid, start) for start in starts]
        rvec = min(found, key=lambda rvec: float(self._losses(pyramid, rvec).sum()))
        if not self._believed(pyramid, rvec, self._losses(pyramid, rvec), old):
            self.lost = badly and float(np.mean(self._by_region(old) < FITS)) < LOST_RATIO
            if not badly:
                self._learn(pyramid, last)
            return last
        self.sure = self._known = True
        if self.turns.apart_px(rvec, last.rvec) < NOTICEABLE_PX * self._px:
            return last
        motion_px = self.turns.motion_px(rvec)
        return CameraTurn(rvec, motion_px) if motion_px >= NOTICEABLE_PX * self._px else STILL

    def _stands(self, pyramid: _Pyramid, last: CameraTurn) -> bool:
        """Whether the picture fits where it last did, and as well, or cannot tell: the usual case, and the cheap one."""
        few, losses, step = slice(None, None, GLANCE_EVERY), [], None
        self.sure, self._contrast = False, 1.0
        for number in (FINEST, *range(FINEST)):
            level = self._levels[number]
            seen, inside = pyramid[number].at(self._aim.pixels(number, few, (tuple(last.rvec),))[0])
            which = np.flatnonzero(level.telling[few] & inside)
            if len(which) < LEAST_POINTS / GLANCE_EVERY:
                continue
            seen, height = seen[which], level.height[few][which]
            if number == FINEST:
                self._take_contrast(seen, height)
            residual = self._residual(seen, height)
            losses.append(np.minimum(residual**2 / level.apart[few][which], MOST_LOSS))
            if number == FINEST:
                step, _ = self._step(number, residual, which * GLANCE_EVERY)
        if step is None:
            return True
        loss, usual = float(np.concatenate(losses).mean()), self._usual.get(last, MOST_LOSS)
        stands = (
            loss < min(max(WELL, LESS_WELL * usual), BADLY)
            and float(np.linalg.norm(step)) * self._camera.K[0, 0] < NOTICEABLE_PX * self._px
        )
        if stands:
            self._usual = {last: min(usual, loss)}
            self.sure = self._known = True
        return stands

    def _learn(self, pyramid: _Pyramid, turn: CameraTurn) -> None:
        """What pixels look like while the camera stands, and how else they would look."""
        self._learned += 1
        if self._learned > LEARN_AT_FIRST and self._learned % LEARN_EVERY:
            return
        for number, level in enumerate(self._levels):
            pixels = self._aim.pixels(number, slice(None), (tuple(turn.rvec),))[0]
            seen, inside = pyramid[number].at(pixels)
            residual = self._residual(seen, level.height)
            level.learn(residual**2, self._beside(pyramid[number], pixels, level.height), inside)

    def _take_contrast(self, seen: np.ndarray, height: np.ndarray) -> None:
        """By how much the frame's contrast differs from the reference's: a dimmed lamp is not motion.

        Its finest structure tells, wherever that lies.
        """
        contrast = float(np.median(np.abs(seen))) / max(float(np.median(np.abs(height))), 1e-6)
        self._contrast = min(max(contrast, LEAST_CONTRAST), 1 / LEAST_CONTRAST)

    def _residual(self, seen: np.ndarray, height: np.ndarray) -> np.ndarray:
        """(..., n): by how much more than the reference pixels show."""
        return seen / self._contrast - height

    def _first_guess(self, relief: Relief, last: np.ndarray) -> np.ndarray:
        """(3,) the turn, on a coarse grid about the last one, under which the picture matches best."""
        level = self._levels[COARSEST]
        steps = range(-SEARCH_PX, SEARCH_PX + 1, SEARCH_STEP_PX)
        offsets = sorted(((right, down) for right in steps for down in steps), key=lambda offset: np.hypot(*offset))
        rvecs = tuple(tuple(last + self._turned_by(*offset)) for offset in offsets)
        few = slice(None, None, max(1, len(level.height) // GUESS_POINTS))
        seen, inside = relief.at(self._aim.pixels(COARSEST, few, rvecs))
        loss = np.minimum(self._residual(seen, level.height[few]) ** 2 / level.apart[few], MOST_LOSS)
        loss[~inside] = MOST_LOSS
        return np.array(rvecs[int(np.argmin(loss[:, level.telling[few]].sum(axis=1)))])

    def _turned_by(self, right_px: float, down_px: float) -> np.ndarray:
        """(3,) the rotation vector that moves the picture's middle by so much, pixels at 640 across."""
        return np.array([-down_px * self._px / self._camera.K[1, 1], right_px * self._px / self._camera.K[0, 0], 0.0])

    def _seen(self, number: int, relief: Relief, rvec: np.ndarray, which: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Of the pixels `which`, by how much more they show than the reference, and whether each is in the picture."""
        level = self._levels[number]
        pixels = in_level(self._camera.turned(rvec).project(self._aim.rays(number)[which]), level.scale)
        seen, inside = relief.at(pixels)
        return self._residual(seen, level.height[which]), inside

    def _aligned(self, pyramid: _Pyramid, rvec: np.ndarray) -> np.ndarray:
        """Gauss-Newton from `rvec`, coarse to fine, on the distance that each pixel's edge has moved along its normal."""
        for number, level in enumerate(self._levels):
            which = np.flatnonzero(level.telling)
            which = which[:: max(1, len(which) // ALIGN_POINTS)]
            if len(which) < 30:
                continue
            for _ in range(ITERATIONS):
                residual, inside = self._seen(number, pyramid[number], rvec, which)
                step, _ = self._step(number, residual[inside], which[inside])
                rvec = rvec + step
                if np.linalg.norm(step) * self._camera.K[0, 0] < ENOUGH_PX * level.scale:
                    break
        return rvec

    def _step(self, number: int, residual: np.ndarray, which: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(3,) the turn that takes most of the residual of these pixels away, and (3, 3) its covariance.

        A pixel counts by how well it tells where it is, but none for much more than others: a bright rod that moves by
        itself must not outweigh a dim bed that stands.
        """
        level = self._levels[number]
        slope = level.slope[which]
        sigma_px = np.maximum(np.sqrt(level.apart[which]) / slope, FINEST_EDGE_PX * level.scale)
        off = residual / slope / sigma_px
        rows = self._aim.jacobian(number)[which] / sigma_px[:, None]
        weighted = rows * _tukey(off)[:, None]
        prior = np.eye(3) * (self._camera.K[0, 0] / (REACH_PX * self._px)) ** 2
        inverse = np.linalg.inv(rows.T @ weighted + prior)
        return -inverse @ (weighted.T @ off), inverse

    def _losses(self, pyramid: _Pyramid, rvec: np.ndarray) -> np.ndarray:
        """How badly each telling pixel of all levels fits, up to MOST_LOSS; half of that where it is out of the picture."""
        losses = []
        for number, level in enumerate(self._levels):
            which = np.flatnonzero(level.telling)
            if len(which):
                residual, inside = self._seen(number, pyramid[number], rvec, which)
                losses.append(np.where(inside, np.minimum(residual**2 / level.apart[which], MOST_LOSS), MOST_LOSS / 2))
        return np.concatenate(losses)

    def _by_region(self, losses: np.ndarray) -> np.ndarray:
        """(m,) the mean loss of each region of the picture that has enough telling pixels."""
        region = np.concatenate([level.region[level.telling] for level in self._levels])
        counts = np.bincount(region)
        return np.bincount(region, losses)[counts >= REGION_POINTS] / counts[counts >= REGION_POINTS]

    def _believed(self, pyramid: _Pyramid, rvec: np.ndarray, new: np.ndarray, old: np.ndarray) -> bool:
        """Whether several parts of the picture, each by itself, say that the camera stands so and not where it last stood,
        hardly any says the contrary, and together they tell well enough by how much it has turned.

        new, old : `_losses` at the turn and where the camera last stood
        """
        gained, level = self._by_region(old - new), self._levels[FINEST]
        speaking, against = np.count_nonzero(gained > 1), np.count_nonzero(gained < -1)
        which = np.flatnonzero(level.telling)
        if (
            speaking < max(SPEAKING, SPEAKING_RATIO * against)
            or np.mean(new < MOST_LOSS) < FITTING_RATIO
            or len(which) < LEAST_POINTS
        ):
            return False
        residual, inside = self._seen(FINEST, pyramid[FINEST], rvec, which)
        _, covariance = self._step(FINEST, residual[inside], which[inside])
        sigma_px = self._camera.K[0, 0] * float(np.sqrt(CORRELATED * np.linalg.eigvalsh(covariance)[-1]))
        return sigma_px < UNCERTAIN_PX * self._px


class _Pyramid:
    """The reliefs of a frame at each of SCALES, each made when it is asked for."""

    def __init__(self, glance: Glance) -> None:
        width_px = glance.at(1).shape[1]
        self._finest = 1 if width_px <= SMALL_PX else 2 * glance.finer
        self._greys = [cv2.cvtColor(glance.at(self._finest), cv2.COLOR_BGR2GRAY)]
        self._reliefs: dict[int, Relief] = {}
        for _ in SCALES[1:]:
            self._greys.insert(0, shrunk(self._greys[0], 2))

    def __getitem__(self, number: int) -> Relief:
        if number not in self._reliefs:
            self._reliefs[number] = Relief.of(self._greys[number])
        return self._reliefs[number]

    def grey(self, number: int) -> np.ndarray:
        return self._greys[number]

    def scale(self, number: int) -> int:
        """How many pixels of the frame one of this level is wide."""
        return SCALES[number] * self._finest


def _tukey(off: np.ndarray) -> np.ndarray:
    """Tukey's biweight, scaled by the median absolute deviation (Huber 1981) where that is more than expected."""
    scale = max(1.4826 * float(np.median(np.abs(off))), 1.0) if len(off) else 1.0
    ratio = np.clip(off / (4.685 * scale), -1, 1)
    return (1 - ratio**2) ** 2
