"""One camera's view of one print: the frame made comparable, and what must be seen in it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from ..calibration.printed import PrintedMarkers
from ..calibration.refine import SilhouetteView
from ..calibration.selfcheck import SelfCheck
from ..camera import Camera
from ..decision.align import Alignment
from ..decision.memory import Memory
from ..expected.views import Expected, ExpectedViews, MaskRenderer, PrintMap, Silhouette
from ..head import HeadModel
from ..header import Moment, Printer
from ..segmentation.adaptive import AdaptiveSegmenter
from ..segmentation.segment import HsvThresholds, Observation, Segmenter, ThresholdSegmenter
from ..toolpath import Toolpath
from .backdrop import Backdrop
from .clearance import Clearance
from .glance import Glance
from .light import LightChange
from .place import Place
from .stabilise import Stabiliser
from .turns import STILL, CameraTurn, Turns
from .usable import Repeats, fit_frame, refuse_unusable
from .window import Window

MOVED_PX = 8.0  # at 640 pixels across: beyond this the user is told, below it the turn is just taken out
SAME_TURN_PX = 1.5
DISPLACED_PX = 1.0  # a print that is seen nearer to where it is expected than that lies there
SETTLED_PX = 1.0  # the same: a frame whose turn differs by more from the last one's is the first to say so
LOST = (
    "Nothing in the picture is where it was: the camera was moved far, or something stands before it. "
    "The view is looked for again; if this stays, calibrate the camera anew."
)
MOST_HIDDEN_RATIO = 0.005  # of the print's surroundings, by the head in the picture of the empty bed


@dataclass(frozen=True, eq=False)
class SteadyFrame:
    """A frame as the calibrated camera would have seen it, in the reference's light, in the view's window.

    window   : which part of the picture, and in what size; all masks and pictures are of its shape
    frame    : (h, w, 3) uint8 BGR
    outside  : (h, w) uint8, 255 where the turned camera did not look; None where it looked everywhere
    expected : what must be seen in the window; whole : in the whole picture, in its own size
    small    : `Glance.quarter` of the whole, steady and in the reference's light
    moved    : the sentence for the user where the camera has just been moved, else ""
    turned   : the camera stands a little elsewhere than in the frame before, and no second frame has borne that out yet; or
    the view was lost, and nothing has told since where it stands
    sure     : the frame has told where the camera stands
    """

    window: Window
    frame: np.ndarray
    outside: np.ndarray | None
    expected: Expected
    whole: Expected
    small: np.ndarray
    moved: str
    turned: bool
    sure: bool
    _whole_bgr: np.ndarray
    _turns: Turns
    _turn: CameraTurn
    _light: LightChange

    def picture(self) -> np.ndarray:
        """(H, W, 3) uint8 BGR: the whole frame."""
        whole = self._whole_bgr
        if self._turn is not STILL:
            whole, _ = self._turns.undo(whole, self._turn)
        return self._light.undone(whole)


class View:
    """Keeps one camera's reference and what its view looked like last. Frames must come in time order."""

    def __init__(
        self, camera: Camera, printer: Printer, toolpath: Toolpath, renderer: MaskRenderer,
        material: HsvThresholds | None, segmentation: str, reference_bgr: np.ndarray | None,
        head: HeadModel | None = None, reference_mm: tuple[float, float, float] | None = None,
    ) -> None:  # fmt: skip
        """reference_mm : where the machine stood when the reference was taken; None for the bed's reference position"""
        self._camera, self._printer, self._toolpath = camera, printer, toolpath
        self._renderer, self._head = renderer, head
        self._expected = ExpectedViews(toolpath, camera, printer.bed, renderer, head)
        self._last_expected: tuple[ExpectedViews | None, Moment | None, Expected | None] = (None, None, None)
        self.selfcheck = SelfCheck(camera, toolpath)
        self._markers = PrintedMarkers(toolpath, material)
        self._bare_bgr = None if reference_bgr is None else fit_frame(reference_bgr, camera)
        self._bare_position_mm = printer.bed.reference_mm if reference_mm is None else reference_mm
        self._material, self._segmentation = material, segmentation
        self.clearance = Clearance(camera, printer.bed)
        self._repeats = Repeats()
        self._turn = STILL  # the last turn that was accepted as where the camera now stands
        self._pending = STILL
        self._lost = False
        self._backdrop: Backdrop | None = None
        self._segmenter: Segmenter
        self._memory: Memory | None = None
        self._memory_at: tuple[tuple[float, ...], Window]  # the bed's pose and the window
        self._window: Window | None = None
        self._window_for: np.ndarray | None = None  # the birth map for which the window was last found good
        self._part: Silhouette | None = None
        self._part_of: tuple[Window, Silhouette]
        self._place: np.ndarray | None = None  # of the complete print, in a glance's pixels
        self._lying: Silhouette | None = None  # the same, displaced to where the print is seen
        self._lying_of: tuple[Alignment, Silhouette]

    def take_reference(self, frame_bgr: np.ndarray, moment: Moment) -> bool:
        """Take this picture, of the bed before anything lies on it, for the reference; before the first frame only.

        Answers whether it is. Where the head hides too much of the print's place and of what is around, it would be taken
        for what the bed looks like there. Raises FrameError where the picture cannot be used.
        """
        frame_bgr = fit_frame(frame_bgr, self._camera)
        refuse_unusable(frame_bgr)
        expected = self._expected.at(moment.file_pos, moment.position_mm, parked=moment.parked)
        head = expected.head[expected.surroundings]
        if cv2.countNonZero(head) > MOST_HIDDEN_RATIO * head.size or self._backdrop is not None:
            return False
        self._bare_bgr, self._bare_position_mm = frame_bgr, moment.position_mm
        return True

    def expected(self, moment: Moment) -> Expected:
        """Raises RenderError where the expected mask cannot be drawn."""
        views, known, last = self._last_expected
        if views is not self._expected or known != moment:  # many ask for that of one moment
            last = self._expected.at(
                moment.file_pos, moment.position_mm, cancelled=self._cancelled(moment), sure_pos=moment.sure_pos,
                parked=moment.parked,
            )  # fmt: skip
            self._last_expected = self._expected, moment, last
        assert last is not None
        return last

    def draw_ahead(self) -> None:
        """Draw what the first look will need, where the bed stands as it did for the reference. Raises RenderError."""
        self._expected.at(self._toolpath.bytes, self._bare_position_mm)
        self._expected.map_at(self._bare_position_mm, self._toolpath.bytes)

    def print_map(self, moment: Moment) -> PrintMap:
        """Layers and objects in the window. Raises RenderError where drawing fails."""
        whole = self._expected.map_at(
            moment.position_mm, moment.file_pos, self._cancelled(moment), parked=moment.parked
        )
        return self._window_at(self.expected(moment)).print_map(whole)

    def _cancelled(self, moment: Moment) -> dict[int, int]:
        """By the objects' numbers; a name that the file does not know is passed over."""
        named = dict(moment.cancelled)
        return {number: named[name] for number, name in enumerate(self._toolpath.objects) if name in named}

    def memory(self, moment: Moment) -> Memory:
        """What the window's pixels have shown so far, carried along where the bed or the window has moved since."""
        window, pose = self._window_at(self.expected(moment)), self._expected.pose(moment.position_mm)
        if self._memory is None:
            self._memory = self._first_memory(window, pose)
        elif (pose, window) != self._memory_at:
            pose_before, window_before = self._memory_at
            motion = self._print_motion((self._camera, pose_before), (self._camera, pose))
            from_window = np.linalg.inv(window_before.from_picture)
            self._memory.carried(window.from_picture @ motion @ from_window, window.shape)
        self._memory_at = pose, window
        return self._memory

    def _first_memory(self, window: Window, pose: tuple[float, ...]) -> Memory:
        """With what the empty bed looks like, where there is a picture of it."""
        if self._bare_bgr is None:
            return Memory(None, window.shape)
        bare_pose = self._expected.pose(self._bare_position_mm)
        if bare_pose == pose:
            return Memory(window.of(Glance(self._bare_bgr)), window.shape)
        motion = window.from_picture @ self._print_motion((self._camera, bare_pose), (self._camera, pose))
        size_px = window.shape[::-1]
        known = cv2.warpPerspective(np.full(self._bare_bgr.shape[:2], 255, np.uint8), motion, size_px) > 0
        return Memory(cv2.warpPerspective(self._bare_bgr, motion, size_px), window.shape, known)

    def _print_motion(
        self, before: tuple[Camera, tuple[float, ...]], now: tuple[Camera, tuple[float, ...]]
    ) -> np.ndarray:
        """(3, 3): about where pixels of the print have gone from one camera and pose of the bed to another.

        Exact for none but close for all of it.
        """
        low, high = self._toolpath.bounds_mm()
        box_mm = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (0.0, high[2])])
        before_px, now_px = (camera.project(box_mm + pose) for camera, pose in (before, now))
        if not (np.isfinite(before_px).all() and np.isfinite(now_px).all()):
            return np.eye(3)
        motion = cv2.findHomography(before_px, now_px)[0]
        return np.eye(3) if motion is None else motion

    def laid_px(self, moment: Moment, since: int) -> float:
        """How many pixels of the picture the beads from number `since` on would cover, side by side in the print's middle."""
        ends, width = self._toolpath.beads_mm[since : self._toolpath.laid_at(moment.file_pos)], 6
        area_mm2 = float((np.linalg.norm(ends[:, 3:5] - ends[:, :2], axis=1) * ends[:, width]).sum())
        low, high = self._toolpath.bounds_mm()
        middle = (low + high) / 2 + self._printer.bed.room_from_print_mm(moment.position_mm)
        apart = self._camera.project(middle + np.vstack([np.zeros(3), np.eye(3)]))
        px_per_mm = float(np.linalg.norm(apart[1:] - apart[0], axis=1).max())
        return area_mm2 * px_per_mm**2 if np.isfinite(px_per_mm) else np.inf

    def place(self, moment: Moment) -> Place:
        """Where things lie at that moment, for a diagnosis."""
        window = self._window_at(self.expected(moment))
        return Place(window, self._toolpath, self._camera, self._printer.bed, self._expected, moment)

    def steady(self, frame_bgr: np.ndarray, moment: Moment) -> SteadyFrame:
        """Raises FrameError with the reason where the frame cannot be used."""
        whole_bgr = fit_frame(frame_bgr, self._camera)
        glance = Glance(whole_bgr)
        refuse_unusable(whole_bgr, glance)
        self._repeats.refuse(whole_bgr)
        expected = self.expected(moment)
        window = self._window_at(expected)
        backdrop = self._backdrop_at(whole_bgr, moment, expected)
        stabiliser = backdrop.stabiliser
        turn = stabiliser.turn(glance, moment.position_mm, self._turn)
        turned = (
            stabiliser.turns.apart_px(turn.rvec, self._turn.rvec) > SETTLED_PX * self._camera.image_size_px[0] / 640
        )
        self._lost = stabiliser.lost or (self._lost and not stabiliser.sure)
        moved = LOST if stabiliser.lost else self._notice(turn, stabiliser)
        if not moved and self._find_markers(whole_bgr, turn, stabiliser, moment):
            expected = self.expected(moment)
            window = self._window_at(expected)
        outside: np.ndarray | None = None
        if turn is STILL:
            part, small = window.of(glance), glance.quarter
        else:
            part, outside = (window.resized(one) for one in stabiliser.turns.undo(whole_bgr, turn, window.part))
            small, _ = stabiliser.turns.undo(glance.quarter, turn)
        light = backdrop.light.change(small)
        return SteadyFrame(
            window, light.undone(part, window.box), outside, self._in_window(expected), expected, light.undone(small),
            moved, turned or self._lost, stabiliser.sure, whole_bgr, stabiliser.turns, turn, light,
        )  # fmt: skip

    def observe(self, steady: SteadyFrame, moment: Moment) -> Observation:
        """Which pixels of a frame from `steady` are filament."""
        return self._segmenter.observe(steady.frame, self._where_it_lies(steady, moment))

    def learn(self, steady: SteadyFrame, moment: Moment, seen: Observation) -> None:
        """All is well in this frame: so look filament and background in this print."""
        self._segmenter.learn(steady.frame, self._where_it_lies(steady, moment), seen)

    def _where_it_lies(self, steady: SteadyFrame, moment: Moment) -> Expected:
        """What must be seen, where this print's contours have shown it to be seen."""
        alignment = self.memory(moment).misfit.alignment
        if alignment.most_px < DISPLACED_PX:
            return steady.expected
        part = steady.expected.silhouette
        if self._lying is None or self._lying_of != (alignment, part):
            self._lying_of, self._lying = (alignment, part), Silhouette(alignment.displaced(part.birth))
        return replace(steady.expected, birth=self._lying.birth, known_silhouette=self._lying)

    def check_calibration(
        self, moment: Moment, close: Window, expected: Expected, observed: np.ndarray, ignored: np.ndarray
    ) -> None:
        """All is well in this frame: so it tells how well the calibration fits, and may better it.

        close : about the print as it is seen, in the picture's own size; expected, observed, ignored : in it
        """
        pose = self._expected.pose(moment.position_mm)
        view = SilhouetteView(expected, observed, np.array(pose), ignored, (close.x0, close.y0))
        better = self.selfcheck.good(view)
        if better is not None:
            self._expect_from(better, moment)

    def _find_markers(self, whole_bgr: np.ndarray, turn: CameraTurn, stabiliser: Stabiliser, moment: Moment) -> bool:
        """Whether markers that are printed with the part have just told where the camera stands."""
        layer = self._toolpath.layer_at(moment.file_pos)
        if layer < 0 or not self._markers.wanted(float(self._toolpath.layer_z_mm[layer])):
            return False
        if turn is not STILL:
            whole_bgr, _ = stabiliser.turns.undo(whole_bgr, turn)
        pose, top_mm = np.array(self._expected.pose(moment.position_mm)), float(self._toolpath.layer_z_mm[layer])
        found = self._markers.camera(whole_bgr, self._camera, pose, top_mm)
        if found is None:
            return False
        self.selfcheck.found_anew(found, pose)
        self._expect_from(found, moment)
        return True

    def _expect_from(self, camera: Camera, moment: Moment) -> None:
        """Expect the print where this camera, of the same picture, sees it. What was seen and learned stays."""
        if self._memory is not None:
            memory = self.memory(moment)
            pose, window = self._memory_at
            motion = self._print_motion((self._camera, pose), (camera, pose))
            matrix = window.from_picture @ motion @ np.linalg.inv(window.from_picture)
            memory.recalibrated(matrix, window.shape)
        self._camera = camera
        self._expected = ExpectedViews(self._toolpath, camera, self._printer.bed, self._renderer, self._head)

    def occluded(self, steady: SteadyFrame, observed: np.ndarray) -> tuple[np.ndarray | None, np.ndarray | None]:
        """Two masks (h, w) uint8, in the window: 255 where something newly hides the view, and where something stands that
        looks like filament and is not the print's; None where nothing does.

        observed : (h, w) uint8, 255 where filament is seen in the window
        """
        assert self._backdrop is not None
        unknown, filament = self._backdrop.unknown.copy(), np.zeros_like(self._backdrop.unknown)
        if steady.expected.ignored is not None:
            steady.window.in_small(steady.expected.ignored, unknown)
        if steady.whole.volume is not None:  # the head may reach far beyond the window
            head = cv2.resize(steady.whole.volume, unknown.shape[::-1], interpolation=cv2.INTER_AREA)
            unknown |= cv2.threshold(head, 0, 255, cv2.THRESH_BINARY)[1]
        steady.window.in_small(observed | steady.expected.mask, filament)
        if self._place is None:
            self._place = np.zeros_like(unknown)
            steady.window.in_small(steady.expected.complete, self._place)
        occluders = self._backdrop.occluders
        hiding = occluders.find(steady.small, filament, self._place, unknown)
        found = [steady.window.from_small(one) if one.any() else None for one in (hiding, occluders.foreign)]
        return found[0], found[1]

    def accept(self, steady: SteadyFrame) -> None:
        """Nothing hides the view in this frame: later ones are compared with it."""
        assert self._backdrop is not None
        self._backdrop.occluders.accept(steady.small)

    def _window_at(self, expected: Expected) -> Window:
        """The window stays where it is for as long as the print fits well."""
        if self._window is None:
            self._window = Window.about(expected.complete)
        elif expected.birth is not self._window_for and not self._window.holds(expected.complete):
            self._window = Window.about(expected.complete)
            self._segmenter.look_elsewhere()
        self._window_for = expected.birth
        return self._window

    def _in_window(self, expected: Expected) -> Expected:
        """What must be seen in the window; what hangs on the birth map alone is made anew only where that is."""
        window = self._window_at(expected)
        if self._part is None or self._part_of != (window, expected.silhouette):
            self._part_of, self._place = (window, expected.silhouette), None
            self._part = Silhouette(np.ascontiguousarray(window.sampled(expected.birth)))
        return window.expected(expected, self._part)

    def _backdrop_at(self, frame_bgr: np.ndarray, moment: Moment, expected: Expected) -> Backdrop:
        """Without a picture of the empty bed the first frame serves: the print is left out of it anyway."""
        if self._backdrop is None:
            if self._bare_bgr is None:
                reference_bgr, position_mm = frame_bgr, moment.position_mm
            else:
                reference_bgr, position_mm = self._bare_bgr, self._bare_position_mm
            self._backdrop = Backdrop(self._camera, self._printer, reference_bgr, position_mm, expected)
            self._backdrop.follow(moment.position_mm, expected)
            self._segmenter = self._choose_segmenter(moment, self._backdrop, self._window_at(expected))
        self._backdrop.follow(moment.position_mm, expected)
        return self._backdrop

    def _choose_segmenter(self, moment: Moment, backdrop: Backdrop, window: Window) -> Segmenter:
        if self._segmentation == "thresholds" and self._material is not None:
            return ThresholdSegmenter(self._material)
        kind = self._printer.bed.kind
        moves = kind == "z" or (kind == "y" and not moment.parked)
        bare_bgr = None if moves or self._bare_bgr is None else window.of(Glance(backdrop.picture()))
        return AdaptiveSegmenter(self._material, bare_bgr, bed_moves=moves)

    def _notice(self, turn: CameraTurn, stabiliser: Stabiliser) -> str:
        """The sentence where the camera has moved far and not yet stood still at its new place; else "".

        A turn that two frames agree on, be it with some doubt, is where the camera stands from now on: its view is found again.
        """
        finer = self._camera.image_size_px[0] / 640
        if stabiliser.turns.apart_px(turn.rvec, self._turn.rvec) < MOVED_PX * finer:
            self._turn = self._pending = turn
            return ""
        if stabiliser.turns.apart_px(turn.rvec, self._pending.rvec) < SAME_TURN_PX * finer:
            self._turn = turn
            return ""
        self._pending = turn
        if stabiliser.twice:
            self._turn = turn
        return moved_sentence(turn.motion_px)


def moved_sentence(motion_px: float) -> str:
    return (
        f"The camera was moved: the picture has shifted by about {motion_px:.0f} px. "
        "The view is looked for again; calibrate the camera before the next print."
    )
