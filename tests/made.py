"""Small prints and cameras made for tests."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np

from octoprint_moop.core.camera import Camera
from octoprint_moop.core.toolpath import NO_OBJECT, Toolpath

LENSES: dict[str, tuple[str, list[float]]] = {
    "straight": ("pinhole", [0, 0, 0, 0, 0]),
    "5 coefficients": ("pinhole", [-0.28, 0.09, 0.0012, -0.0009, -0.01]),
    "8 coefficients": ("pinhole", [0.31, -0.12, 0.0011, -0.0007, 0.02, 0.55, -0.08, 0.01]),
    "12 coefficients": ("pinhole", [0.3, -0.1, 0.001, -0.001, 0.02, 0.5, -0.1, 0.01, 0.004, -0.002, -0.003, 0.001]),
    "14 coefficients": (
        "pinhole",
        [0.3, -0.1, 0.001, -0.001, 0.02, 0.5, -0.1, 0.01, 0.004, -0.002, -0.003, 0.001, 0.02, -0.03],
    ),
    "fisheye": ("fisheye", [-0.02, 0.01, -0.005, 0.001]),
}


def camera_at(
    eye_mm: Sequence[float],
    target_mm: Sequence[float],
    lens: str = "straight",
    size_px: tuple[int, int] = (640, 480),
    focal_px: float = 640.0,
    **changes: Any,
) -> Camera:
    """A camera at `eye_mm` that looks at `target_mm`, upright; its optical centre is not the picture's."""
    forward = np.subtract(target_mm, eye_mm) / np.linalg.norm(np.subtract(target_mm, eye_mm))
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right = right / np.linalg.norm(right) if np.linalg.norm(right) > 1e-9 else np.array([1.0, 0.0, 0.0])
    rotation = np.stack([right, np.cross(forward, right), forward])
    model, distortion = LENSES[lens]
    K = [[focal_px, 0, size_px[0] / 2 + 12.3], [0, focal_px * 1.02, size_px[1] / 2 - 8.7], [0, 0, 1]]
    rvec = cv2.Rodrigues(rotation)[0].ravel()
    return Camera(size_px, K, distortion, rvec, -rotation @ np.asarray(eye_mm, dtype=float), model, **changes)


def toolpath_of(
    beads_mm: Sequence[Sequence[float]],
    layers: Sequence[int] | None = None,
    objects: Sequence[int] | None = None,
    **changes: Any,
) -> Toolpath:
    """A print of these beads, ten file positions each; all in one layer and of no object unless said otherwise."""
    beads = np.asarray(beads_mm, dtype=np.float32).reshape(-1, 8)
    count = len(beads)
    layer = np.zeros(count, dtype=int) if layers is None else np.asarray(layers)
    start = np.searchsorted(layer, np.arange(layer.max() + 2))
    end_pos = 10 * np.arange(1, count + 1)
    named = np.full(count, NO_OBJECT) if objects is None else np.asarray(objects)
    values: dict[str, Any] = {
        "beads_mm": beads, "end_pos": end_pos, "layer_start": start, "layer_end_pos": end_pos[start[1:] - 1],
        "layer_z_mm": beads[start[1:] - 1, 5], "role": np.zeros(count, dtype=np.uint8),
        "object_id": named.astype(np.int16), "objects": tuple(f"part {i}" for i in range(int(named.max()) + 1)),
        "bytes": 10 * count,
    }  # fmt: skip
    values.update(changes)
    return Toolpath(**values)


def vase(turns: int = 12, around: int = 60, centre_mm: Sequence[float] = (100, 100), radius_mm: float = 15) -> Toolpath:
    """A wavy vase of closed rings, a layer each, 0.45 mm by 0.3 mm."""
    beads, layers = [], []
    for turn in range(turns):
        angle = np.linspace(0, 2 * np.pi, around + 1)
        radius = radius_mm + 2 * np.sin(5 * angle) + 0.2 * turn
        x, y = centre_mm[0] + radius * np.cos(angle), centre_mm[1] + radius * np.sin(angle)
        z = np.full(around + 1, 0.3 * (turn + 1))
        ring = np.stack([x, y, z], axis=1)
        size = np.tile([0.45, 0.3], (around, 1))
        beads.append(np.hstack([ring[:-1], ring[1:], size]))
        layers += [turn] * around
    return toolpath_of(np.concatenate(beads), layers)
