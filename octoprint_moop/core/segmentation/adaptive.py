"""The segmenter that learns this print's own look while all is well. The default."""

from __future__ import annotations

import cv2
import numpy as np

from ..expected.views import Expected, box_about
from .appearance import ColourModel, Plate, count_colours, count_kinds, every_colour, opponent
from .reach import BESIDE_PX, HeadColours, Reach, beyond_reach, remember
from .segment import HsvThresholds, Observation, segment_hsv
from .weigh import Look, weigh

_BAND_PX = 2000.0  # how many pixels the user's thresholds count for: soon outweighed by what is really seen
_TELLING = 0.2  # thresholds that more of the bed's pixels than this keep to do not tell filament from it
_CHANGED = 24.0  # distance in opponent colours beyond which a pixel is not the empty bed any more
_FRINGE = 10.0
_SQUARES = np.minimum(np.arange(256) ** 2, 20_000).astype(np.uint16)  # three of them fit into 16 bits
_ALIKE = 0.4  # of where material lies, that the bed seems to show through though all is well: they look alike
_INSIDE_PX = 3  # learned from only this far within what lies, and BESIDE_PX beyond what ever will


class AdaptiveSegmenter:
    """Filament by this print's own colours and each pixel's own past; frames must come from one camera.

    Begins with the user's thresholds; where there are none, or the empty bed keeps to them as well (a black filament has no
    hue of its own), with what differs from the empty bed where the first layers must lie. It never learns that air is
    filament: a pixel teaches "filament" only where material must lie *and* the frame shows it there.
    """

    def __init__(
        self,
        material: HsvThresholds | None,
        reference_bgr: np.ndarray | None = None,
        bed_moves: bool = False,
    ) -> None:
        """material : the user's thresholds, None where none are set; reference_bgr : (H, W, 3) uint8, the empty bed.

        bed_moves : a pixel shows another part of the bed at each check, so that only colours can be learned
        """
        self._bed_moves = bed_moves
        colours = None if reference_bgr is None else opponent(reference_bgr)
        self._filament: np.ndarray | None = None
        self._thresholds: np.ndarray | None = None
        self._background = np.zeros(every_colour().shape[1])
        if colours is not None:
            self._background = count_colours(colours, np.ones(colours.shape[:2], bool))
        if material is not None:
            band = segment_hsv(every_colour(), material)[0] > 0
            self._thresholds = band * (_BAND_PX / max(int(band.sum()), 1))
            if self._background[band].sum() <= _TELLING * self._background.sum():
                self._filament = self._thresholds
        self._plate = None if colours is None else Plate(colours, np.full(colours.shape[:2], -1, np.int8))
        self._model: ColourModel | None = None
        self._head = HeadColours()
        self._separability = 1.0
        self._bedlike_ratio = 0.0

    @property
    def separability(self) -> float:
        """0..1: how well colour told filament from background when last asked, see ColourModel; 1 before."""
        return self._separability

    def observe(self, frame_bgr: np.ndarray, expected: Expected | None = None) -> Observation:
        """frame_bgr : (H, W, 3) uint8; expected : what must be seen, None where nothing is known."""
        region = _region(expected, frame_bgr.shape[:2])
        x0, y0, x1, y1 = region
        crop = np.ascontiguousarray(frame_bgr[y0:y1, x0:x1])
        mask = None if expected is None else np.ascontiguousarray(expected.mask[y0:y1, x0:x1])
        plate = self._plate_like(frame_bgr)
        plate = None if plate is None else plate.part(region)
        model = self._colours(frame_bgr, expected)
        self._separability = model.separability
        look = Look.without_label(plate, crop.shape[:2], model)
        seen = weigh(crop, model, look, mask, reach=self._reach(frame_bgr, expected, region, model))
        if self._bedlike_ratio > _ALIKE and plate is not None and mask is not None:
            seen = self._unsure_of_the_bed(seen, plate, opponent(crop), mask)
        return seen.within(frame_bgr.shape[:2], region)

    def _reach(
        self, frame_bgr: np.ndarray, expected: Expected | None, region: tuple[int, int, int, int], model: ColourModel
    ) -> Reach | None:
        """Where a head may stand in the region; None where none may."""
        if expected is None or expected.volume is None:
            return None
        x0, y0, x1, y1 = region
        reach = self._head.reach(frame_bgr, expected, model)
        return Reach(np.ascontiguousarray(reach.where[y0:y1, x0:x1]), reach.model)

    def _unsure_of_the_bed(
        self, seen: Observation, plate: Plate, colours: np.ndarray, expected: np.ndarray
    ) -> Observation:
        """Where this print has been taken for the bed so far, an unchanged bed does not say that nothing lies there."""
        unchanged = (seen.mask == 0) & ~self._not_the_bed(plate, colours)
        inside = _well_inside(expected, 1) > 0
        if inside.any():
            self._bedlike_ratio = min(self._bedlike_ratio, float(unchanged[inside].mean()))
        unsure = unchanged & (expected > 0) if self._bedlike_ratio > _ALIKE else np.zeros_like(inside)
        return Observation(seen.mask, seen.unsure | np.where(unsure, np.uint8(255), np.uint8(0)))

    def learn(self, frame_bgr: np.ndarray, expected: Expected, observed: Observation) -> None:
        """Take this frame's look as that of filament and background. Only after a check in which all was well."""
        colours = opponent(frame_bgr)
        outside = cv2.bitwise_not(_grown(expected.complete, BESIDE_PX))
        background = outside & cv2.bitwise_not(observed.mask | observed.unsure)
        if expected.volume is not None:
            self._head.learn(colours, expected)
        few = box_about(expected.mask, 2 * _INSIDE_PX + 2)  # no filament is learned beyond
        mask, seen, sure = expected.mask[few], observed.mask[few], cv2.bitwise_not(observed.unsure[few])
        inside = _well_inside(mask, _INSIDE_PX)
        filament = self._head.without(inside & seen & sure, colours, expected, few)
        plate = self._plate_like(background)
        if plate is not None:
            changed = self._not_the_bed(Plate(plate.colours[few], plate.known[few]), colours[few])
            lying = _well_inside(mask, 1) > 0
            if lying.any():
                bedlike = (seen == 0) & ~changed
                self._bedlike_ratio = (self._bedlike_ratio + float(bedlike[lying].mean())) / 2
            filament[~changed] = 0
        # its edge too, a mixture of both, and so is what lies just outside: there they must be told apart
        edge = _grown(filament, _INSIDE_PX) & _grown(seen, 1) & mask & cv2.bitwise_not(inside)
        beside = _grown(filament, 2 * _INSIDE_PX + 1) & cv2.bitwise_not(outside[few] | mask)
        lies, fringe = count_kinds(colours[few], (filament | edge) > 0, beside > 0)
        x0, y0, x1, y1 = _region(expected, background.shape)
        rest = count_colours(colours[y0:y1, x0:x1], beyond_reach(background, expected)[y0:y1, x0:x1] > 0)
        if filament.any():
            known = np.zeros_like(self._background) if self._filament is None else self._filament
            self._filament = remember(known, lies)
        # the few pixels beside the print count up to tenfold: that is where the two must be told apart. More would give
        # every mixed pixel to the background and the print would be seen too thin
        fringe *= min(max(float(rest.sum() / max(fringe.sum(), 1.0)), 1.0), _FRINGE)
        self._background = remember(self._background, fringe + rest)
        self._model = None
        if not self._bed_moves:
            if plate is None:
                plate = self._plate = Plate(colours.copy(), np.zeros(background.shape, np.int8))
            for part, here, kind in ((np.s_[:, :], background, -1), (few, filament, 1)):
                cv2.copyTo(colours[part], here, plate.colours[part])
                np.copyto(plate.known[part], kind, where=here > 0)

    def look_elsewhere(self) -> None:
        """The pixels' past is forgotten, the colours are kept."""
        self._plate = None

    def _not_the_bed(self, plate: Plate, colours: np.ndarray) -> np.ndarray:
        """(H, W) bool: False where the plate's background is seen unchanged."""
        return (plate.known >= 0) | _apart(colours, plate.colours, _CHANGED)

    def _plate_like(self, picture: np.ndarray) -> Plate | None:
        """None where nothing is known of the pixels of a picture of this height and width."""
        fits = self._plate is not None and self._plate.known.shape == picture.shape[:2]
        return self._plate if fits else None

    def _colours(self, frame_bgr: np.ndarray | None = None, expected: Expected | None = None) -> ColourModel:
        """The colours learned; before any, those of this frame: matter where it must lie and the bed does not show."""
        if frame_bgr is None or expected is None or (self._filament is not None and self._background.any()):
            if self._model is None:
                known = self._thresholds if self._filament is None else self._filament
                self._model = ColourModel(np.zeros_like(self._background) if known is None else known, self._background)
            return self._model
        colours, background = opponent(frame_bgr), self._background
        filament = self._filament
        if not background.any():
            background = count_colours(colours, beyond_reach(expected.complete == 0, expected))
        if filament is None:
            lies = expected.mask > 0
            plate = self._plate_like(lies)
            if plate is not None:
                lies &= self._not_the_bed(plate, colours)
            filament = self._head.first_seen(lies, colours, expected)
        return ColourModel(filament, background)


def _well_inside(mask: np.ndarray, by_px: int) -> np.ndarray:
    """Of a mask (uint8) what is not near its edge."""
    return cv2.erode(mask, np.ones((2 * by_px + 1,) * 2, np.uint8))


def _grown(mask: np.ndarray, by_px: int) -> np.ndarray:
    return cv2.dilate(mask, np.ones((2 * by_px + 1,) * 2, np.uint8))


def _apart(colours: np.ndarray, others: np.ndarray, least: float) -> np.ndarray:
    """(H, W) bool: where two opponent pictures, smoothed, are further apart than that."""
    apart = cv2.blur(cv2.absdiff(colours, others), (3, 3))
    first, second, third = (cv2.LUT(cv2.extractChannel(apart, number), _SQUARES) for number in range(3))
    return cv2.add(cv2.add(first, second), third) > least * least


def _region(expected: Expected | None, shape: tuple[int, int]) -> tuple[int, int, int, int]:
    """The part of the view that is looked at: the complete print and its surroundings; all without one."""
    height, width = shape
    if expected is None:
        return (0, 0, width, height)
    rows, columns = expected.surroundings
    return (columns.start, rows.start, columns.stop, rows.stop)
