"""Is the camera turned so, or does it stand where it last stood? What the landmarks of a picture say, one by one and by region.

Landmarks beside one another err alike, and in a region in which nothing tells the two apart chance decides. So a region
speaks only where its own landmarks agree, and a turn is believed only where the picture as a whole leaves no doubt: a
view that is found in the wrong place does more harm than one that is not found.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

CORRELATED = 6.0  # neighbours err alike: so many landmarks count as one
REGION_POINTS = 6
SPEAKS, SPEAKS_SIGMA, AGAINST_SIGMA = 1.0, 1.0, 1.5  # mean gain of a region, and against its standard deviation
FITS, MISFITS, FEW = 3.0, 6.0, 3  # losses of a landmark; so few are none
UNCERTAIN_RATIO = 0.025  # the turn's standard deviation against the turn, at most


@dataclass(frozen=True)
class Demands:
    """What a turn must show to be believed.

    total_sigma : by so many standard deviations the whole picture fits better
    found_ratio : so many landmarks that fit now and did not before for each that did and does not
    speaking, speaking_ratio : regions that speak for it, and so many for each that speaks against it
    uncertain_px : the turn's standard deviation, at most, pixels at 640 across
    rival_sigma : by so many standard deviations it fits better than any other turn that was found
    """

    total_sigma: float
    found_ratio: float
    speaking: int
    speaking_ratio: float
    uncertain_px: float
    rival_sigma: float


AT_ONCE = Demands(4.0, 6, 5, 6, 0.55, 2.0)
TWICE = Demands(3.0, 4, 4, 4, 0.7, 0.5)  # of two frames that tell the same turn


@dataclass(frozen=True, eq=False)
class Gain:
    """What is gained by one turn against another.

    mean, sigma : (m,) of the regions in which enough landmarks tell: the mean by which they fit better, in variances, and its
    standard deviation as their scatter has it
    total_sigma : the gain of the whole picture in its standard deviations
    found, lost : how many landmarks fit now and did not before, and how many the other way round
    """

    mean: np.ndarray
    sigma: np.ndarray
    total_sigma: float
    found: int
    lost: int

    @classmethod
    def of(cls, region: np.ndarray, old: np.ndarray, new: np.ndarray) -> Gain:
        """region : (n,) int; old, new : (n,) losses of the same landmarks before and now"""
        gained = old - new
        counts = np.maximum(np.bincount(region), 1)
        mean = np.bincount(region, gained) / counts
        variance = np.maximum(np.bincount(region, gained**2) / counts - mean**2, 0) * CORRELATED / counts
        total, total_variance = (mean * counts).sum(), (variance * counts**2).sum()
        enough = counts >= REGION_POINTS
        return cls(
            mean[enough], np.sqrt(variance[enough]), float(total / np.sqrt(max(total_variance, 1e-9))),
            int(np.count_nonzero((old > MISFITS) & (new < FITS))), int(np.count_nonzero((old < FITS) & (new > MISFITS))),
        )  # fmt: skip

    @property
    def likely(self) -> bool:
        """Whether the turn may well be the truth: such a frame must not teach what the view looks like without it."""
        return self.total_sigma > TWICE.total_sigma

    def meets(self, demands: Demands, motion_px: float, sigma_px: float, rival_sigma: float) -> bool:
        """Whether to believe a turn by so much, told with such a standard deviation were landmarks independent; pixels at 640
        across. rival_sigma : the `total_sigma` of its gain against the best of its rivals"""
        speaking = np.count_nonzero((self.mean > SPEAKS) & (self.mean > SPEAKS_SIGMA * self.sigma))
        against = np.count_nonzero((self.mean < -SPEAKS) & (self.mean < -AGAINST_SIGMA * self.sigma))
        return bool(
            self.total_sigma > demands.total_sigma
            and rival_sigma > demands.rival_sigma
            and self.found >= demands.found_ratio * max(self.lost, FEW)
            and speaking >= max(demands.speaking, demands.speaking_ratio * against)
            and np.sqrt(CORRELATED) * sigma_px < max(demands.uncertain_px, UNCERTAIN_RATIO * motion_px)
        )
