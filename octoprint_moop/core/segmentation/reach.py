"""A head that stands in the picture: which of the colours within its reach are the print's.

What is seen within the reach of a head, beside all that has been laid, is the head, its shadow, or what is behind: never the
print. So its colours are known at any look, whatever the head is made of, and filament is what has others. Filament of a
head's own colour is not told from it there, and nothing is guessed: the head hides it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from ..expected.views import Expected
from .appearance import ColourModel, cells_of, count_colours, every_colour, opponent

BESIDE_PX = 8  # from what is expected: further off lies none of it, however wrong the calibration
_BEYOND_PX = 200  # beside where a head may be; fewer pixels tell less of a filament's colours than all do
_OWN = 2.0  # log of how much more frequent a colour must be in the print's place than beside it to be the filament's
_SHARED = 0.1  # of how frequent a colour is at this look, that it must be at those before
_MEMORY_PX = 200_000.0  # counts are scaled down beyond this, so that the colours follow the light of the day


@dataclass(frozen=True, eq=False)
class Reach:
    """Where a head may stand before the print, and what tells filament from it there.

    where : (H, W) uint8, 255 within its reach
    model : filament's colours, against those of the head and of the bed
    """

    where: np.ndarray
    model: ColourModel


def remember(known: np.ndarray, new: np.ndarray) -> np.ndarray:
    """Counts of colours, with new ones added."""
    counts = known + new
    return counts * min(1.0, _MEMORY_PX / max(float(counts.sum()), 1.0))


def beyond_reach(where: np.ndarray, expected: Expected, few: Any = np.s_[:, :]) -> np.ndarray:
    """Of `where` what no head can stand before, if that is enough to learn from; else all of it.

    where : uint8 or bool, of the rows and columns `few` of the view
    """
    beyond = _beyond(where, expected, few)
    return beyond if np.count_nonzero(beyond) >= _BEYOND_PX else where


class HeadColours:
    """The colours that are seen within a head's reach where no filament lies."""

    def __init__(self) -> None:
        self._beside = np.zeros(every_colour().shape[1])
        self._offered = np.zeros_like(self._beside)

    def learn(self, colours: np.ndarray, expected: Expected) -> None:
        """colours : (H, W, 3) uint8, an opponent picture of the view after a check in which all was well."""
        self._beside = remember(self._beside, _beside_print(colours, expected))

    def reach(self, frame_bgr: np.ndarray, expected: Expected, model: ColourModel) -> Reach:
        """Where a head is in the way; before anything was learned the picture itself tells what a head looks like.

        frame_bgr : (H, W, 3) uint8, the view; model : what tells filament from its background where no head is
        """
        assert expected.volume is not None
        beside = self._beside if self._beside.any() else _beside_print(opponent(frame_bgr), expected)
        beside = beside * max(float(model.background.sum()), 1.0) / max(float(beside.sum()), 1.0)
        return Reach(expected.volume, ColourModel(model.filament, beside + model.background))

    def without(self, lies: np.ndarray, colours: np.ndarray, expected: Expected, few: Any = np.s_[:, :]) -> np.ndarray:
        """Of where filament seems to lie what is no head: what lies beyond its reach, and where that is not enough to learn
        from, what has other colours as well.

        lies : uint8 or bool, of the rows and columns `few` of the view; colours : of all of it
        """
        if expected.volume is None:
            return lies
        beyond = _beyond(lies, expected, few)
        if np.count_nonzero(beyond) >= _BEYOND_PX:
            return beyond
        part = colours[few]
        ratios = ColourModel(count_colours(part, lies > 0), self._seen_beside(colours, expected)).ratios
        own = np.take(ratios, cells_of(part)) > _OWN
        return np.where(own | (beyond > 0), lies, lies.dtype.type(0))

    def first_seen(self, lies: np.ndarray, colours: np.ndarray, expected: Expected) -> np.ndarray:
        """Counts of the filament's colours at a look before any were learned, where (bool) filament seems to lie.

        Of those that are seen within the head's reach only such as looks before it have shown as well: the head moves
        between them, and may fill the print's place at one. All of them at the first look.
        """
        own = self.without(lies, colours, expected)
        filament = count_colours(colours, own)
        if expected.volume is None:
            return filament
        before, self._offered = self._offered, remember(self._offered, filament)
        if not before.any() or not (own & (expected.volume > 0)).any():
            return filament
        return filament * (ColourModel(before, filament).ratios > np.log(_SHARED))

    def _seen_beside(self, colours: np.ndarray, expected: Expected) -> np.ndarray:
        return self._beside if self._beside.any() else _beside_print(colours, expected)


def _beyond(where: np.ndarray, expected: Expected, few: Any) -> np.ndarray:
    if expected.volume is None:
        return where
    return np.where(expected.volume[few] > 0, where.dtype.type(0), where)


def _beside_print(colours: np.ndarray, expected: Expected) -> np.ndarray:
    """Counts of colours about the print, within the head's reach and beside all that lies."""
    assert expected.volume is not None
    near = expected.surroundings
    laid = cv2.dilate(expected.mask[near], np.ones((2 * BESIDE_PX + 1,) * 2, np.uint8))
    return count_colours(colours[near], (expected.volume[near] & cv2.bitwise_not(laid)) > 0)
