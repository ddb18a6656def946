"""Does the camera stand where it stood? How far it turned, and the frame as the calibrated camera would have seen it.

A camera that is knocked turns much more than it travels, so its motion is modelled as a rotation about its centre:
then every pixel's new place follows from three numbers, whatever the depth of what it shows (Hartley and Zisserman,
Multiple View Geometry, section 8.4). The three are found by direct alignment of what does not belong to the print
(Lucas and Kanade 1981 in the form of Baker and Matthews 2004), coarse to fine, with weights that make outliers of a
gantry, a hand and whatever else moves by itself. In nearly all frames a glance at a few of those pixels tells that the
camera stands where it last stood.

Only pixels that tell the camera's place have a say: those that would differ a few pixels off by much more than they do
while it stands, which is learned as frames come. So neither noise nor a gantry votes. Differences are counted in
variances, each up to a limit, so that sums of them compare likelihoods (`fit`); where the frame fits badly near where the
camera stood, it is looked for far and wide (`search`); and a turn is believed where several regions of the picture, each by
itself, find it likelier than that the camera stands where it stood, and hardly any the contrary (`belief`).
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from ..camera import BedMotion, Camera
from .belief import AT_ONCE, REGION_POINTS, TWICE, Gain
from .fit import FINEST, MOST_LOSS, SCALES, Fit, Pyramid, contrast_of
from .glance import Glance
from .landmarks import MOST_CONTRAST, Aim, Level, Relief, noise, region_of, strongest_in_each_cell
from .search import GOOD, NOTICEABLE_PX, best_turn
from .turns import STILL, CameraTurn, Turns

GLANCE_EVERY = 3  # of the pixels, to tell that nothing has moved
LEAST_POINTS = 60  # that tell; with fewer nothing is said of the camera
BESIDE_PX = 2.0  # px of the level: how far off a pixel must look otherwise
# grey levels, and of what a pixel looks like beside: until frames have shown it
LEAST_NOISE, LEAST_APART_RATIO = 0.5, 0.04
WELL, LESS_WELL, BADLY = 1.3, 2.0, 3.3  # mean loss: as expected; times the usual; never that of a camera that stands
FITS, LOST_RATIO = 2.5, 0.25  # mean loss of a region; of the regions, so few fit if the camera is nowhere near
NEW_VIEW_SIGMA = 8.0  # of the whole picture's gain: so much tells even there
SAME_PX, SAME_RATIO = 1.0, 0.05  # at 640 pixels across, and against the turn
LEARN_AT_FIRST, LEARN_EVERY = 6, 8  # frames


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
        pyramid = Pyramid(glance)
        self._levels = [self._level(pyramid, number, background, shift_mm, bed_mm) for number in range(len(SCALES))]
        self._aim = Aim(camera, self._levels, shift_mm)
        self.turns = Turns(camera)
        self._usual: dict[CameraTurn, float] = {}  # the mean loss at the last turn, at best
        self._suspected: np.ndarray | None = None  # the turn that the last frame told, but not beyond doubt
        self._learned = 0
        self.sure = False
        """Whether the last frame told where the camera stands."""
        self.lost = False
        """Whether nearly nothing is where it was, in a view that was known before, and where it went cannot be told."""
        self.twice = False
        """Whether the turn that the last frame told is that of the one before too, of which that left some doubt."""
        self._known = False

    def _level(
        self, pyramid: Pyramid, number: int, background: np.ndarray, shift_mm: np.ndarray,
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

    def _beside(self, relief: Relief, pixels: np.ndarray, height: np.ndarray, contrast: float = 1.0) -> np.ndarray:
        """(n,) float32: the mean squared difference from `height` around each pixel, some way off."""
        steps = np.array([[BESIDE_PX, 0], [-BESIDE_PX, 0], [0, BESIDE_PX], [0, -BESIDE_PX]], np.float32)
        seen, _ = relief.at(pixels[None] + steps[:, None])
        return ((seen / contrast - height) ** 2).mean(axis=0)

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
        self.lost = self.twice = False
        shift_mm = self._bed.room_from_print_mm(position_mm)
        if not np.array_equal(shift_mm, self._aim.shift_mm):
            self._aim = Aim(self._camera, self._levels, shift_mm)
        pyramid = Pyramid(glance)
        fit = Fit(self._camera, self._levels, self._aim, pyramid, self._px)
        if self._stands(pyramid, fit, last):
            self._learn(pyramid, last)
            return last
        rvec, rivals = best_turn(fit, last.rvec)
        gain, old = fit.gain(last.rvec, rvec), fit.losses(last.rvec)[0]
        badly = self._known and bool(old.mean() > BADLY)
        if not self._believed(fit, gain, rvec, last.rvec, rivals):
            self.lost = badly and float(np.mean(self._by_region(old) < FITS)) < LOST_RATIO
            if not (badly or gain.likely):
                self._learn(pyramid, last)
            return last
        self.sure = self._known = True
        if self.turns.apart_px(rvec, last.rvec) < NOTICEABLE_PX * self._px:
            return last
        motion_px = self.turns.motion_px(rvec)
        return CameraTurn(rvec, motion_px) if motion_px >= NOTICEABLE_PX * self._px else STILL

    def _believed(self, fit: Fit, gain: Gain, rvec: np.ndarray, last: np.ndarray, rivals: Sequence[np.ndarray]) -> bool:
        """Whether this frame leaves no doubt that the camera has turned so, or tells the same as the one before.

        gain : of the turn, against the last one; rivals : see `best_turn`
        """
        before, self._suspected = self._suspected, None
        if not (self._known or fit.loss(rvec) < GOOD or gain.total_sigma > NEW_VIEW_SIGMA):
            return False  # much may be new in a view that has not been seen yet, and be no turn of the camera
        rival_sigma = min((fit.gain(rival, rvec).total_sigma for rival in rivals), default=np.inf)
        told = self.turns.apart_px(rvec, last) / self._px, fit.sigma_px(rvec), rival_sigma
        if gain.meets(AT_ONCE, *told):
            return True
        if not gain.meets(TWICE, *told):
            return False
        self._suspected = rvec
        same_px = max(SAME_PX, SAME_RATIO * told[0])
        self.twice = before is not None and self.turns.apart_px(rvec, before) < same_px * self._px
        return self.twice

    def _stands(self, pyramid: Pyramid, fit: Fit, last: CameraTurn) -> bool:
        """Whether the picture fits where it last did, and as well, or cannot tell: the usual case, and the cheap one."""
        few, losses, step = slice(None, None, GLANCE_EVERY), [], None
        self.sure, contrast = False, 1.0
        for number in (FINEST, *range(FINEST)):
            level = self._levels[number]
            seen, inside = pyramid[number].at(self._aim.pixels(number, few, (tuple(last.rvec),))[0])
            which = np.flatnonzero(level.telling[few] & inside)
            if len(which) < LEAST_POINTS / GLANCE_EVERY:
                continue
            seen, height, apart = seen[which], level.height[few][which], level.apart[few][which]
            if number == FINEST:
                contrast = float(contrast_of(seen, height, apart))
            residual = seen / contrast - height
            losses.append(np.minimum(residual**2 / apart, MOST_LOSS))
            if number == FINEST:
                step, _ = fit.step(number, residual, which * GLANCE_EVERY)
        if step is None:
            return True
        loss, usual = float(np.concatenate(losses).mean()), self._usual.get(last, MOST_LOSS)
        stands = (
            loss < min(max(WELL, LESS_WELL * usual), BADLY)
            and float(np.linalg.norm(step)) * self._camera.K[0, 0] < NOTICEABLE_PX * self._px
        )
        if stands:
            self._usual, self._suspected = {last: min(usual, loss)}, None
            self.sure = self._known = True
        return stands

    def _learn(self, pyramid: Pyramid, turn: CameraTurn) -> None:
        """What pixels look like while the camera stands, and how else they would look."""
        self._learned += 1
        if self._learned > LEARN_AT_FIRST and self._learned % LEARN_EVERY:
            return
        for number, level in enumerate(self._levels):
            pixels = self._aim.pixels(number, slice(None), (tuple(turn.rvec),))[0]
            seen, inside = pyramid[number].at(pixels)
            known = level.telling & inside
            contrast = float(contrast_of(seen[known], level.height[known], level.apart[known]))
            residual = seen / contrast - level.height
            level.learn(residual**2, self._beside(pyramid[number], pixels, level.height, contrast), inside)

    def _by_region(self, losses: np.ndarray) -> np.ndarray:
        """(m,) the mean loss of each region of the picture that has enough telling pixels."""
        region = np.concatenate([level.region[level.telling] for level in self._levels])
        counts = np.bincount(region)
        return np.bincount(region, losses)[counts >= REGION_POINTS] / counts[counts >= REGION_POINTS]
