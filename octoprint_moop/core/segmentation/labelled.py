"""What one picture on which somebody has shown the filament teaches about every other picture of the same print."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from ..errors import SegmentationError
from ..view.light import Light
from .appearance import ColourModel, count_colours, opponent
from .clicks import label_from_clicks
from .segment import Observation
from .weigh import Look, look_of_label, weigh

LOOK_ALIKE = 0.6  # separability below which the user is told that filament and bed look alike


@dataclass(frozen=True, eq=False)
class LearnedFilament:
    """What one labelled picture taught. Segments others of the same print by the same camera, each by itself.

    region : (x0, y0, x1, y1) in the frame; outside of it nothing is filament
    """

    model: ColourModel
    look: Look
    light: Light
    region: tuple[int, int, int, int]
    frame_size_px: tuple[int, int]

    @property
    def separability(self) -> float:
        """0..1, see ColourModel; below LOOK_ALIKE more light or another bed colour is needed."""
        return self.model.separability

    def segment(self, frame_bgr: np.ndarray, expected: np.ndarray | None = None) -> Observation:
        """expected : (H, W) uint8, what the render says is there, right or wrong.

        Raises SegmentationError where the frame is not of the labelled frame's size, or the mask not of the frame's.
        """
        if frame_bgr.shape[1::-1] != self.frame_size_px:
            raise SegmentationError(
                f"The picture is {frame_bgr.shape[1]}x{frame_bgr.shape[0]}, but the labelled one was "
                f"{self.frame_size_px[0]}x{self.frame_size_px[1]}. Use pictures of one camera at one size."
            )
        if expected is not None and expected.shape != frame_bgr.shape[:2]:
            raise SegmentationError(
                f"The expected mask is {expected.shape[1]}x{expected.shape[0]}, but its picture "
                f"{frame_bgr.shape[1]}x{frame_bgr.shape[0]}. Draw it for that picture."
            )
        x0, y0, x1, y1 = self.region
        crop = np.ascontiguousarray(frame_bgr[y0:y1, x0:x1])
        believed = None if expected is None else np.ascontiguousarray(expected[y0:y1, x0:x1])
        seen = weigh(crop, self.model, self.look, believed, self.light.gain(frame_bgr))
        return seen.within(frame_bgr.shape[:2], self.region)


def learn_from_label(
    frame_bgr: np.ndarray, mask: np.ndarray, region: tuple[int, int, int, int] | None = None
) -> LearnedFilament:
    """What a labelled frame teaches.

    frame_bgr : (H, W, 3) uint8
    mask      : (H, W) uint8, non-zero on filament
    region    : (x0, y0, x1, y1) to which the work is limited; about the labelled print, its size all around, where None
    Raises SegmentationError where the mask does not fit the frame, or holds no filament or nothing but filament.
    """
    height, width = frame_bgr.shape[:2]
    if mask.shape != (height, width):
        raise SegmentationError(
            f"The mask is {mask.shape[1]}x{mask.shape[0]}, but its picture {width}x{height}. Draw it on that picture."
        )
    x0, y0, x1, y1 = region or _around(mask)
    x0, y0, x1, y1 = max(x0, 0), max(y0, 0), min(x1, width), min(y1, height)
    if x1 <= x0 or y1 <= y0:
        raise SegmentationError(f"The box {region} lies outside of the {width}x{height} picture.")
    label = np.where(mask[y0:y1, x0:x1] > 0, np.uint8(255), np.uint8(0))
    share = cv2.countNonZero(label) / label.size
    if not 0 < share < 1:
        what = "no filament" if share == 0 else "nothing but filament"
        raise SegmentationError(f"The mask shows {what} in the region. Mark some filament and some background.")
    crop = np.ascontiguousarray(frame_bgr[y0:y1, x0:x1])
    colours = opponent(crop)
    core = cv2.erode(label, np.ones((3, 3), np.uint8)) > 0
    if core.sum() < 50:
        core = label > 0
    far = cv2.dilate(label, np.ones((5, 5), np.uint8)) == 0
    if not far.any():
        far = label == 0
    model = ColourModel(count_colours(colours, core), count_colours(colours, far))
    whole = np.where(mask > 0, np.uint8(255), np.uint8(0))
    return LearnedFilament(
        model, look_of_label(crop, label, model), Light(frame_bgr, whole), (x0, y0, x1, y1), (width, height)
    )


def _around(mask: np.ndarray) -> tuple[int, int, int, int]:
    """Where the labelled print may grow to and its pieces may lie: its own size all around. May exceed the frame."""
    x, y, w, h = cv2.boundingRect((mask > 0).astype(np.uint8))
    if not w:
        return (0, 0, mask.shape[1], mask.shape[0])
    margin = max(w, h)
    return (x - margin, y - margin, x + w + margin, y + h + margin)


def learn_from_clicks(
    frame_bgr: np.ndarray,
    filament_px: Sequence[tuple[int, int]],
    background_px: Sequence[tuple[int, int]],
    region: tuple[int, int, int, int] | None = None,
) -> LearnedFilament:
    """What a few points clicked on filament and on background teach: the clicked print is cut out (clicks.py), then
    learned from as if it had been labelled.

    filament_px, background_px : (x, y) in the frame, at least one each
    Raises SegmentationError where points are missing or outside of the frame or region.
    """
    label = label_from_clicks(frame_bgr, filament_px, background_px, region)
    return learn_from_label(frame_bgr, label, region)
