"""Whether what is as dark as the bed is filament in shade.

Shade takes from all channels alike: it makes a bright filament's side wall as dark as the bed, but not of the bed's tint.
What noise hides in one pixel, many of them show.
"""

from __future__ import annotations

import numpy as np

LEAST_PX = 15
TINT_LEAST, TINT_SHARE = 0.025, 0.33  # logarithms of channels; of the way from the bed's tint to the filament's


def is_shaded_matter(
    look: np.ndarray, bare: np.ndarray, where: np.ndarray, matter: np.ndarray, beside: np.ndarray
) -> bool:
    """Whether the pixels `where`, all together, have gone a good part of the way from the bare bed's tint to that of matter.

    look, bare : (3, h, w) uint8, what is seen and how the bed looks without matter
    where, matter, beside : (h, w) bool, what is asked after, matter that is seen, and bed that is seen, which tells what the
    light has done
    """
    if min(map(np.count_nonzero, (where, matter, beside))) < LEAST_PX:
        return False
    light = _tint(look, beside) - _tint(bare, beside)
    then = _tint(bare, where) + light
    gone, apart = _tint(look, where) - then, _tint(look, matter) - then
    way = float(np.linalg.norm(apart))
    return way > 0 and float(gone @ apart) / way > max(TINT_LEAST, TINT_SHARE * way)


def _tint(look: np.ndarray, where: np.ndarray) -> np.ndarray:
    """(3,) the logarithms of the mean channels, against their mean: what more or less of the same light does not change."""
    levels = np.log([float(plane[where].mean()) + 1.0 for plane in look])
    return levels - levels.mean()
