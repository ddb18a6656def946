"""Pixel counts of what a frame shows, for the whole print and for each of its labelled objects."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np

from .spots import about

WINDOWS = (1, 2, 4, 8)  # layers back over which fresh matter is counted
WHOLE = -1
Windows = tuple  # of (pixels, how many of them count) for each of WINDOWS


@dataclass(frozen=True)
class Evidence:
    """Pixel counts of one scope: one labelled object, or the WHOLE print.

    expected_px, total_px : of the expected mask now and of the complete one
    dim_px      : well inside the expected mask and not seen: how far this filament can be told from this bed at all
    standing_px : established matter that was seen in earlier checks; lost_px : of it, what is seen no more
    stray_px    : matter where none is expected, new since all was well
    rim_px      : the same within the tolerance band, but not right at the expected edge, which is edge_px long
    unseen_px   : matter of the last layers that is not seen and looks bare
    deep_px     : well inside what the last layers cover; barren_px : of it, what was never seen
    fresh       : for each of WINDOWS, pixels that its layers newly cover, and how many of them are seen
    come        : the same of those that can tell how far they are covered, and how many covered ones that is worth
    sunk_px     : contour of what stands that has come inwards, in one way
    """

    object_id: int
    expected_px: int
    total_px: int
    dim_px: int
    standing_px: int
    lost_px: int
    stray_px: int
    edge_px: int
    rim_px: int
    unseen_px: int
    deep_px: int
    barren_px: int
    xor_px: int
    fresh: Windows
    come: Windows = ((0, 0),) * len(WINDOWS)
    sunk_px: int = 0

    @property
    def error_ratio(self) -> float:
        return self.xor_px / max(self.total_px, 1)


class Counter:
    """Counts pixels of masks for the whole print and, by whose pixels they are, for each object: (scopes,) int64."""

    def __init__(self, owner: np.ndarray, scopes: int, within: np.ndarray) -> None:
        """within : bool; no mask reaches beyond"""
        self._few, self._scopes = about(within), scopes
        self._within = within[self._few].view(np.uint8)
        self._kind = np.uint8 if scopes <= 256 else np.uint16
        self._owner = (owner[self._few] + 1).astype(self._kind) if scopes > 1 else None  # 0 for nobody's

    def __call__(self, **masks: np.ndarray) -> dict[str, np.ndarray]:
        """masks : bool"""
        found = {name: np.zeros(self._scopes, np.int64) for name in masks}
        for name, mask in masks.items():
            found[name][0] = np.count_nonzero(mask)
        some = [name for name in masks if found[name][0]]
        if self._scopes > 1:
            for at in range(0, len(some), 8):
                for name, counts in self._by_owner({name: masks[name] for name in some[at : at + 8]}).items():
                    found[name][1:] = counts[1:]
        return found

    def _by_owner(self, masks: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Of up to eight masks, in one go: each is a bit."""
        assert self._owner is not None
        bits = np.zeros([part.stop - part.start for part in self._few], np.uint8)
        for mask in masks.values():
            bits += bits
            bits |= mask[self._few].view(np.uint8)
        pictures, size = [self._owner, bits.astype(self._kind, copy=False)], [self._scopes, 256]
        both = cv2.calcHist(pictures, [0, 1], self._within, size, [0, size[0], 0, size[1]])
        set_in = np.unpackbits(np.arange(256, dtype=np.uint8)[None], axis=0)[-len(masks) :]
        return dict(zip(masks, (set_in.astype(float) @ both.T.astype(float)).astype(np.int64)))

    def younger(self, mask: np.ndarray, share: np.ndarray, layer_of: np.ndarray, layer: int) -> list[Windows]:
        """For each scope and each of WINDOWS: the mask's pixels of the last so many layers, and the sum of their shares.

        mask : bool, no pixel of which is of a later layer than `layer`, or of an earlier one than WINDOWS reach
        share : of each of the mask's pixels, bool or 0 to 1
        """
        mask, oldest = mask[self._few], WINDOWS[-1]
        kinds = layer - layer_of[self._few][mask]
        if self._owner is not None:
            kinds = kinds + self._owner[mask].astype(kinds.dtype) * oldest
        size = self._scopes * oldest
        both = np.stack([np.bincount(kinds, minlength=size), np.bincount(kinds, share, minlength=size)])
        both = both.reshape(2, self._scopes, oldest)
        both[:, 0] = both.sum(axis=1)
        upto = both.cumsum(axis=2)[:, :, [layers - 1 for layers in WINDOWS]].round().astype(int).tolist()
        return [tuple(zip(pixels, shares)) for pixels, shares in zip(*upto)]
