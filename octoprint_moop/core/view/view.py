"""One camera's view of one print: the frame made comparable, and what must be seen in it."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from ..camera import BedMotion, Camera
from ..decision.evidence import about_print
from ..decision.memory import Memory
from ..errors import FrameError
from ..expected.hardware import HeadModel
from ..expected.views import Expected, ExpectedViews, MaskRenderer, PrintMap
from ..header import Moment, Printer
from ..segmentation.adaptive import AdaptiveSegmenter
from ..segmentation.segment import HsvThresholds, Observation, Segmenter, ThresholdSegmenter
from ..toolpath import Toolpath
from .backdrop import Backdrop
from .stabilise import STILL, CameraTurn, Stabiliser
from .usable import refuse_unusable

MOVED_PX = 8.0  # at 640 pixels across: beyond this the user is told, below it the turn is just taken out
SAME_TURN_PX = 1.5
MOST_HIDDEN_RATIO = 0.005  # of the print's surroundings, by the head in the picture of the empty bed


@dataclass(frozen=True, eq=False)
class SteadyFrame:
    """A frame as the calibrated camera would have seen it, in the reference's light.

    frame   : (H, W, 3) uint8 BGR
    outside : (H, W) uint8, 255 where the turned camera did not look
    moved   : the sentence for the user where the camera has just been moved, else ""
    """

    frame: np.ndarray
    outside: np.ndarray
    moved: str = ""


@dataclass(frozen=True, eq=False)
class Place:
    """The print before this camera at one moment; see `diagnose.Place`."""

    toolpath: Toolpath
    camera: Camera
    bed: BedMotion
    expected: ExpectedViews
    moment: Moment

    def covered(self, object_id: int, first_layer: int) -> np.ndarray:
        """Raises RenderError where drawing fails."""
        first, end = self.toolpath.layer_start[max(first_layer, 0)], self.toolpath.laid_at(self.moment.file_pos)
        beads = np.arange(first, max(end, first))
        if object_id >= 0:
            beads = beads[self.toolpath.object_id[first:end] == object_id]
        return self.expected.covered_at(self.moment.position_mm, beads)

    def on_bed_mm(self, pixels: np.ndarray, z_mm: float) -> np.ndarray:
        shift_mm = self.bed.room_from_print_mm(self.moment.position_mm)
        rays_room = self.camera.rays(pixels) @ cv2.Rodrigues(self.camera.rvec)[0]
        centre = self.camera.centre_mm
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = (z_mm + shift_mm[2] - centre[2]) / rays_room[:, 2]
        return (centre + rays_room * depth[:, None] - shift_mm)[:, :2]

    def layer_z_mm(self, layer: int) -> float:
        return float(self.toolpath.layer_z_mm[layer])


class View:
    """Keeps one camera's reference and what its view looked like last. Frames must come in time order."""

    def __init__(
        self, camera: Camera, printer: Printer, toolpath: Toolpath, renderer: MaskRenderer,
        material: HsvThresholds | None, segmentation: str, reference_bgr: np.ndarray | None,
        head: HeadModel | None = None, reference_mm: tuple[float, float, float] | None = None,
    ) -> None:  # fmt: skip
        """reference_mm : where the machine stood when the reference was taken; None for the bed's reference position"""
        self._camera, self._printer, self._toolpath = camera, printer, toolpath
        self._expected = ExpectedViews(toolpath, camera, printer.bed, renderer, head)
        self._bare_bgr = None if reference_bgr is None else fit_frame(reference_bgr, camera)
        self._bare_position_mm = printer.bed.reference_mm if reference_mm is None else reference_mm
        self._material, self._segmentation = material, segmentation
        self._previous_bgr: np.ndarray | None = None
        self._turn = STILL  # the last turn that was accepted as where the camera now stands
        self._pending = STILL
        self._backdrop: Backdrop | None = None
        self._segmenter: Segmenter
        self._memory: Memory | None = None
        self._memory_position_mm = self._bare_position_mm

    def take_reference(self, frame_bgr: np.ndarray, moment: Moment) -> bool:
        """Take this picture, of the bed before anything lies on it, for the reference; before the first frame only.

        Answers whether it is. Where the head hides too much of the print's place and of what is around, it would be taken
        for what the bed looks like there. Raises FrameError where the picture cannot be used.
        """
        frame_bgr = fit_frame(frame_bgr, self._camera)
        refuse_unusable(frame_bgr, None)
        expected = self._expected.at(moment.file_pos, moment.position_mm, parked=moment.parked)
        head = expected.head[about_print(expected.complete)]
        if cv2.countNonZero(head) > MOST_HIDDEN_RATIO * head.size or self._backdrop is not None:
            return False
        self._bare_bgr, self._bare_position_mm = frame_bgr, moment.position_mm
        return True

    def expected(self, moment: Moment, before: int = 0) -> Expected:
        """Raises RenderError where the expected mask cannot be drawn."""
        return self._expected.at(
            moment.file_pos, moment.position_mm, before, self._cancelled(moment), moment.sure_pos, moment.parked
        )

    def print_map(self, moment: Moment) -> PrintMap:
        """Raises RenderError where drawing fails."""
        return self._expected.map_at(moment.position_mm, moment.file_pos, self._cancelled(moment), parked=moment.parked)

    def _cancelled(self, moment: Moment) -> dict[int, int]:
        """By the objects' numbers; a name that the file does not know is passed over."""
        named = dict(moment.cancelled)
        return {number: named[name] for number, name in enumerate(self._toolpath.objects) if name in named}

    def memory(self, moment: Moment) -> Memory:
        """What the pixels have shown so far, carried along where the bed has moved since."""
        if self._memory is None:
            self._memory = Memory(self._bare_bgr, self._camera.image_size_px[::-1])
            self._memory_position_mm = (
                self._bare_position_mm if self._bare_bgr is not None else moment.position_mm
            )
        here, before = self._expected.pose(moment.position_mm), self._expected.pose(self._memory_position_mm)
        if here != before:
            self._memory.carried(self._print_motion(np.array(before), np.array(here)))
        self._memory_position_mm = moment.position_mm
        return self._memory

    def _print_motion(self, before_mm: np.ndarray, now_mm: np.ndarray) -> np.ndarray:
        """(3, 3): about where pixels of the print have gone as the bed moved. Exact for none but close for all of it."""
        low, high = self._toolpath.bounds_mm()
        box_mm = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (0.0, high[2])])
        before_px, now_px = (self._camera.project(box_mm + shift_mm) for shift_mm in (before_mm, now_mm))
        if not (np.isfinite(before_px).all() and np.isfinite(now_px).all()):
            return np.eye(3)
        motion = cv2.findHomography(before_px, now_px)[0]
        return np.eye(3) if motion is None else motion

    def place(self, moment: Moment) -> Place:
        """Where things lie at that moment, for a diagnosis."""
        return Place(self._toolpath, self._camera, self._printer.bed, self._expected, moment)

    def steady(self, frame_bgr: np.ndarray, moment: Moment) -> SteadyFrame:
        """Raises FrameError with the reason where the frame cannot be used."""
        frame_bgr = fit_frame(frame_bgr, self._camera)
        refuse_unusable(frame_bgr, self._previous_bgr)
        self._previous_bgr = frame_bgr
        backdrop = self._backdrop_at(frame_bgr, moment)
        turn = backdrop.stabiliser.turn(frame_bgr, moment.position_mm)
        moved = self._notice(turn, backdrop.stabiliser)
        outside = np.zeros(frame_bgr.shape[:2], np.uint8)
        if turn is not STILL:
            frame_bgr, outside = backdrop.stabiliser.undo(frame_bgr, turn)
        frame_bgr, _ = backdrop.light.level(frame_bgr)
        return SteadyFrame(frame_bgr, outside, moved)

    def observe(self, steady: SteadyFrame, expected: Expected) -> Observation:
        """Which pixels of a frame from `steady` are filament."""
        return self._segmenter.observe(steady.frame, expected)

    def learn(self, steady: SteadyFrame, expected: Expected, seen: Observation) -> None:
        """All is well in this frame: so look filament and background in this print."""
        self._segmenter.learn(steady.frame, expected, seen)

    def occluded(self, steady: SteadyFrame, filament: np.ndarray, place: np.ndarray) -> np.ndarray:
        """(H, W) uint8, 255 where something newly hides the view; filament and place as for `Occluders.find`."""
        assert self._backdrop is not None
        return self._backdrop.occluders.find(steady.frame, filament | self._backdrop.unknown, place)

    def accept(self, steady: SteadyFrame) -> None:
        """Nothing hides the view in this frame: later ones are compared with it."""
        assert self._backdrop is not None
        self._backdrop.occluders.accept(steady.frame)

    def _backdrop_at(self, frame_bgr: np.ndarray, moment: Moment) -> Backdrop:
        """Without a picture of the empty bed the first frame serves: the print is left out of it anyway."""
        exclude = self.expected(moment).complete
        if self._backdrop is None:
            if self._bare_bgr is None:
                reference_bgr, position_mm = frame_bgr, moment.position_mm
            else:
                reference_bgr, position_mm = self._bare_bgr, self._bare_position_mm
            self._backdrop = Backdrop(self._camera, self._printer, reference_bgr, position_mm, exclude)
            self._backdrop.follow(moment.position_mm, exclude)
            self._segmenter = self._choose_segmenter(moment, self._backdrop)
        self._backdrop.follow(moment.position_mm, exclude)
        return self._backdrop

    def _choose_segmenter(self, moment: Moment, backdrop: Backdrop) -> Segmenter:
        if self._segmentation == "thresholds" and self._material is not None:
            return ThresholdSegmenter(self._material)
        kind = self._printer.bed.kind
        moves = kind == "z" or (kind == "y" and not moment.parked)
        bare_bgr = None if moves or self._bare_bgr is None else backdrop.picture
        return AdaptiveSegmenter(self._material, bare_bgr, bed_moves=moves)

    def _notice(self, turn: CameraTurn, stabiliser: Stabiliser) -> str:
        """The sentence where the camera has moved far and not yet stood still at its new place; else "".

        A turn that two frames agree on is where the camera stands from now on: its view is found again.
        """
        finer = self._camera.image_size_px[0] / 640
        if stabiliser.apart_px(turn, self._turn) < MOVED_PX * finer:
            self._turn = self._pending = turn
            return ""
        if stabiliser.apart_px(turn, self._pending) < SAME_TURN_PX * finer:
            self._turn = turn
            return ""
        self._pending = turn
        return moved_sentence(turn.motion_px)


def moved_sentence(motion_px: float) -> str:
    return (
        f"The camera was moved: the picture has shifted by about {motion_px:.0f} px. "
        "The view is looked for again; calibrate the camera before the next print."
    )


def fit_frame(frame_bgr: np.ndarray, camera: Camera) -> np.ndarray:
    """The frame at the camera's size. Raises FrameError where it is of another shape."""
    width, height = camera.image_size_px
    frame_height, frame_width = frame_bgr.shape[:2]
    if (frame_width, frame_height) == (width, height):
        return frame_bgr
    if abs(frame_width * height - frame_height * width) > 0.01 * frame_height * width:
        raise FrameError(
            f"The frame is {frame_width} x {frame_height} px, but the camera was calibrated at {width} x {height} px. "
            "Set the webcam back, or calibrate it again."
        )
    return cv2.resize(frame_bgr, (width, height), interpolation=cv2.INTER_AREA)
