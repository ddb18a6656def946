"""Which ellipse is which marker. Each ellipse gives its disc's place and tilt; the plate's distances do the rest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, permutations

import cv2
import numpy as np

from ..camera import Camera
from ..errors import CameraError
from .calibrate import Lens
from .markers import Disc, MarkerPlate, circle_poses

_TILT_APART = 0.8  # cosine: a far disc's tilt is known to some 20 degrees
_DISTANCE_OFF = 0.35  # a disc that is half out of hue looks up to a third further away
_KEPT = 6


@dataclass(frozen=True, eq=False)
class Assignment:
    """A guess at the pose: `pairs` of (marker, disc) indices, and a camera that puts those markers on those discs."""

    pairs: tuple[tuple[int, int], ...]
    camera: Camera
    rms_px: float


def assignments(discs: Sequence[Disc], plate: MarkerPlate, lens: Lens) -> list[Assignment]:
    """The likeliest assignments of at least three markers, most markers and then best fit first; at most six."""
    poses = [circle_poses(disc, plate.outer_diameter_mm, lens) for disc in discs]
    usable = [index for index, pose in enumerate(poses) if pose]
    found: dict[tuple[tuple[int, int], ...], Assignment] = {}
    tried: set[tuple[tuple[int, int], ...]] = set()
    for first, second in combinations(usable, 2):
        for camera in _pair_cameras(poses[first], poses[second], plate, lens):
            pairs = _match(camera, discs, plate, tolerance=1.2)
            if len(pairs) < 3 or pairs in tried:
                continue
            tried.add(pairs)
            better = _settle(pairs, camera, discs, plate, lens)
            if better is not None and (better.pairs not in found or better.rms_px < found[better.pairs].rms_px):
                found[better.pairs] = better
    return sorted(found.values(), key=lambda guess: (-len(guess.pairs), guess.rms_px))[:_KEPT]


def _pair_cameras(
    poses: Sequence[tuple[np.ndarray, np.ndarray]],
    others: Sequence[tuple[np.ndarray, np.ndarray]],
    plate: MarkerPlate,
    lens: Lens,
) -> list[Camera]:
    """Cameras for which two discs are some two markers of the plate lying on one bed."""
    cameras = []
    tops_mm = plate.tops_mm()
    for centre, normal in poses:
        for other_centre, other_normal in others:
            if normal @ other_normal < _TILT_APART:
                continue
            between = other_centre - centre
            up = (normal + other_normal) / np.linalg.norm(normal + other_normal)
            along = between - (between @ up) * up
            seen_mm = float(np.linalg.norm(between))
            # Two discs that do not lie on the plane that their tilts say are not on one bed.
            if np.linalg.norm(along) < 0.6 * seen_mm:
                continue
            along = along / np.linalg.norm(along)
            in_camera = np.column_stack([along, np.cross(up, along), up])
            for marker, next_marker in permutations(range(len(tops_mm)), 2):
                step = tops_mm[next_marker] - tops_mm[marker]
                length_mm = float(np.linalg.norm(step))
                if abs(seen_mm / length_mm - 1) > _DISTANCE_OFF:
                    continue
                e = step / length_mm
                on_bed = np.column_stack([e, np.cross([0, 0, 1.0], e), [0, 0, 1.0]])
                rotation = in_camera @ on_bed.T
                middle = (centre + other_centre) / 2
                tvec = middle - rotation @ (tops_mm[marker] + tops_mm[next_marker]) / 2
                cameras.append(lens.at(cv2.Rodrigues(rotation)[0], tvec))
    return cameras


def _match(camera: Camera, discs: Sequence[Disc], plate: MarkerPlate, tolerance: float) -> tuple[tuple[int, int], ...]:
    """Pairs of (marker, disc): nearest first, within `tolerance` of the disc's larger axis, sizes alike."""
    tops_mm = plate.tops_mm()
    centres_px = camera.project(tops_mm)
    depth_mm = tops_mm @ camera.camera_from_room[2, :3] + camera.tvec_mm[2]
    with np.errstate(divide="ignore", invalid="ignore"):
        sizes_px = camera.K[0, 0] * plate.outer_diameter_mm / depth_mm
    disc_px = np.array([disc.centre_px for disc in discs])
    disc_sizes_px = np.array([max(disc.axes_px) for disc in discs])
    apart = np.linalg.norm(centres_px[:, None] - disc_px[None], axis=2) / disc_sizes_px[None]
    ratio = sizes_px[:, None] / disc_sizes_px[None]
    apart = np.where((ratio > 0.5) & (ratio < 2.0) & np.isfinite(apart), apart, np.inf)
    pairs = []
    while apart.size and apart.min() < tolerance:
        marker, disc = np.unravel_index(apart.argmin(), apart.shape)
        pairs.append((int(marker), int(disc)))
        apart[marker], apart[:, disc] = np.inf, np.inf
    return tuple(sorted(pairs))


def _settle(
    pairs: tuple[tuple[int, int], ...], camera: Camera, discs: Sequence[Disc], plate: MarkerPlate, lens: Lens
) -> Assignment | None:
    """Refines on the discs' centres and matches again, more strictly each time."""
    for tolerance in (0.8, 0.4, 0.4):
        points_mm = plate.tops_mm()[[marker for marker, _ in pairs]]
        seen_px = np.array([discs[disc].centre_px for _, disc in pairs])
        rays = lens.rays(seen_px)
        if not np.isfinite(rays).all():
            return None
        try:
            rvec, tvec = cv2.solvePnPRefineLM(
                points_mm, rays, np.eye(3), None, camera.rvec.reshape(3, 1).copy(), camera.tvec_mm.reshape(3, 1).copy()
            )
            camera = lens.at(rvec, tvec)
        except (cv2.error, CameraError):
            return None
        pairs = _match(camera, discs, plate, tolerance)
        if len(pairs) < 3:
            return None
    miss_px = camera.project(plate.tops_mm()[[marker for marker, _ in pairs]]) - np.array(
        [discs[disc].centre_px for _, disc in pairs]
    )
    return Assignment(pairs, camera, float(np.sqrt((miss_px**2).sum(axis=1).mean())))
