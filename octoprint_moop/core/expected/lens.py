"""What a lens can show, and what its distortion numbers mean beyond their range."""

from __future__ import annotations

import math

import cv2
import numpy as np

from ..camera import Camera

NEAREST_MM = 1.0
WIDEST = 10.0  # tangent of the widest ray that is looked at, 84 degrees off the axis


def radial_px(camera: Camera, tangent: np.ndarray) -> np.ndarray:
    """(N,) float64: distance from the principal point, in focal lengths, of rays at `tangent` (N,) off the axis."""
    k = np.zeros(14)
    k[: camera.distortion.size] = camera.distortion
    if camera.model == "fisheye":
        angle = np.arctan(tangent)
        square = angle**2
        return angle * (1 + square * (k[0] + square * (k[1] + square * (k[2] + square * k[3]))))
    square = tangent**2
    with np.errstate(divide="ignore", invalid="ignore"):
        return (
            tangent
            * (1 + square * (k[0] + square * (k[1] + square * k[4])))
            / (1 + square * (k[5] + square * (k[6] + square * k[7])))
        )


def outermost_ray(camera: Camera) -> float:
    """Tangent of the angle off the axis up to which the lens's polynomial still runs outwards.

    Beyond it the polynomial folds back, and things far beside the picture would appear within it.
    """
    tangent = np.linspace(0.0, WIDEST, 4001)
    steps = np.diff(radial_px(camera, tangent))
    folded = np.flatnonzero(~(steps > 0))
    return float(tangent[folded[0]]) if folded.size else WIDEST


def shown(points_room_mm: np.ndarray, camera: Camera) -> np.ndarray:
    """(N,) bool: the point (N, 3) is before the camera and within what its lens can show."""
    in_camera = points_room_mm @ camera.camera_from_room[:3, :3].T + camera.tvec_mm
    depth = in_camera[:, 2]
    return (depth > NEAREST_MM) & (np.hypot(in_camera[:, 0], in_camera[:, 1]) < outermost_ray(camera) * depth)


def blind_area(camera: Camera) -> np.ndarray:
    """(H, W) uint8, 255 where the picture lies beyond the lens's valid area, so that nothing can be expected there."""
    width, height = camera.image_size_px
    outermost = outermost_ray(camera)
    if outermost >= WIDEST:
        return np.zeros((height, width), np.uint8)
    x, y = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))
    on_lens = np.linalg.inv(camera.K @ tilt(camera))
    lens_x, lens_y, scale = (row[0] * x + row[1] * y + row[2] for row in on_lens)
    reach = float(radial_px(camera, np.array([outermost]))[0])
    blind = np.where(np.hypot(lens_x, lens_y) >= reach * np.abs(scale), np.uint8(255), np.uint8(0))
    return cv2.dilate(blind, np.ones((3, 3), np.uint8))


def tilt(camera: Camera) -> np.ndarray:
    """(3, 3) float64: the tilted sensor of OpenCV's 14-coefficient model (Scheimpflug); identity for others."""
    if camera.model == "fisheye" or camera.distortion.size < 14:
        return np.eye(3)
    about_x, about_y = camera.distortion[12:14]
    cos_x, sin_x, cos_y, sin_y = math.cos(about_x), math.sin(about_x), math.cos(about_y), math.sin(about_y)
    rotation = np.array([[cos_y, 0, -sin_y], [0, 1, 0], [sin_y, 0, cos_y]]) @ np.array(
        [[1, 0, 0], [0, cos_x, sin_x], [0, -sin_x, cos_x]]
    )
    projection = np.array([[rotation[2, 2], 0, -rotation[0, 2]], [0, rotation[2, 2], -rotation[1, 2]], [0, 0, 1]])
    return projection @ rotation
