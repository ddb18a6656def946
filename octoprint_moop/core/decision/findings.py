"""What is known of one frame before it is weighed, and what was found in it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..expected.views import Expected, PrintMap
from .counts import Evidence
from .spots import Window


@dataclass(frozen=True, eq=False)
class Sight:
    """One frame made comparable, and what must be seen in it. Pictures are (H, W) or (H, W, 3) uint8.

    frame_bgr : steadied and levelled; observed : 255 where filament is seen; ignored : 255 where nothing can be said
    layer     : the last layer of which something lies
    finer     : a length in a picture 640 pixels across is so many times longer in this one
    laid_px   : tells how many pixels would be covered by what was laid since all was last well, line beside line
    sure      : the view as a whole has told where the camera stands
    """

    frame_bgr: np.ndarray
    observed: np.ndarray
    ignored: np.ndarray
    expected: Expected
    print_map: PrintMap
    layer: int
    tolerance_px: float
    finer: float = 1.0
    laid_px: Callable[[], float] = lambda: math.inf
    sure: bool = True


@dataclass(frozen=True, eq=False)
class Findings:
    """The evidence of the whole (first) and of each object, and the pictures behind it.

    All pictures are bool, of the shape of `window`: rows and columns of the expected mask about the print.

    wanted : expected now; look : (3, h, w) uint8, the frame aligned, as the memory keeps it; seen, known : observed, and
    what can be said anything of, aligned; standing : matter seen in earlier checks; lost, stray : see the module; rim : as
    stray, within the band about expected edges; unseen : fresh matter of the last layers that is not seen; hidden_px : so
    much of what stood there looks neither like matter nor like the bare bed now; untold_px : a good part of what stood is
    not seen, so much of it, and nothing bears out that it has gone, 0 where less; loose : matter that has grown from what
    the user went on with; bared : what stood along a contour that has come inwards, and is not seen; moved_px : by how much
    the whole picture has just moved
    """

    window: Window
    wanted: np.ndarray
    look: np.ndarray
    seen: np.ndarray
    known: np.ndarray
    standing: np.ndarray
    lost: np.ndarray
    stray: np.ndarray
    rim: np.ndarray
    unseen: np.ndarray
    hidden_px: int
    untold_px: int
    scopes: tuple[Evidence, ...]
    loose: np.ndarray
    bared: np.ndarray
    moved_px: float = 0.0

    @property
    def whole(self) -> Evidence:
        return self.scopes[0]
