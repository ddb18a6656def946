"""The camera in the room, and the bed that moves before it.

Pixels are OpenCV's: x right, y down, pixel centres at whole numbers. `x_cam = R(rvec) · x_room + tvec`, z forward.
Print coordinates and room coordinates differ only by the bed's motion (`BedMotion.room_from_print_mm`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from .errors import CameraError

LENS_MODELS = ("pinhole", "fisheye")
BED_MOTIONS = ("fixed", "y", "z")
_MANY = 200  # points from which on numpy is quicker than OpenCV


def _frozen(values: Any, shape: tuple[int, ...] | None, what: str) -> np.ndarray:
    """A read-only float64 copy. Raises CameraError unless the numbers are finite and of `shape`."""
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise CameraError(f"The camera's {what} is not a list of numbers. Calibrate the camera again.") from None
    if shape is not None and array.shape != shape:
        raise CameraError(f"The camera's {what} has shape {array.shape}, but {shape} is needed. Calibrate it again.")
    if not np.isfinite(array).all():
        raise CameraError(f"The camera's {what} contains a number that is not finite. Calibrate the camera again.")
    array.flags.writeable = False
    return array


@dataclass(frozen=True, eq=False)
class Camera:
    """A calibrated camera: OpenCV's pinhole with Brown-Conrady distortion, or OpenCV's fisheye.

    image_size_px : (width, height) at which the other numbers hold
    K             : (3, 3) float64, pixels
    distortion    : (n,) float64; pinhole k1 k2 p1 p2 k3 [k4 k5 k6 …], fisheye k1 k2 k3 k4
    rvec, tvec_mm : (3,) float64, camera from room, Rodrigues vector in radians and millimetres
    """

    image_size_px: tuple[int, int]
    K: np.ndarray
    distortion: np.ndarray
    rvec: np.ndarray
    tvec_mm: np.ndarray
    model: str = "pinhole"

    def __post_init__(self) -> None:
        if self.model not in LENS_MODELS:
            raise CameraError(f"Unknown lens model {self.model!r}; known are {', '.join(LENS_MODELS)}.")
        try:
            width, height = (int(side) for side in self.image_size_px)
        except (TypeError, ValueError):
            raise CameraError("The camera's image_size_px must be [width, height].") from None
        if width < 1 or height < 1:
            raise CameraError(f"The camera's image size is {width} x {height} px. Calibrate the camera again.")
        object.__setattr__(self, "image_size_px", (width, height))
        object.__setattr__(self, "K", _frozen(self.K, (3, 3), "matrix K"))
        object.__setattr__(self, "rvec", _frozen(self.rvec, (3,), "rvec"))
        object.__setattr__(self, "tvec_mm", _frozen(self.tvec_mm, (3,), "tvec_mm"))
        distortion = _frozen(self.distortion, None, "distortion").ravel()
        legal = (4,) if self.model == "fisheye" else (0, 4, 5, 8, 12, 14)
        if distortion.size not in legal:
            raise CameraError(
                f"A {self.model} lens has {' or '.join(map(str, legal))} distortion numbers, not {distortion.size}."
            )
        object.__setattr__(self, "distortion", distortion)
        if self.K[0, 0] <= 0 or self.K[1, 1] <= 0:
            raise CameraError("The camera's focal length must be positive. Calibrate the camera again.")

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Camera:
        """Raises CameraError naming what is missing or makes no sense."""
        if not isinstance(data, Mapping):
            raise CameraError("The camera must be an object with image_size_px, K, distortion, rvec and tvec_mm.")
        missing = [key for key in ("image_size_px", "K", "distortion", "rvec", "tvec_mm") if data.get(key) is None]
        if missing:
            raise CameraError(f"The camera has no {', '.join(missing)}. Calibrate it, or take over a whole set-up.")
        return cls(
            data["image_size_px"], data["K"], data["distortion"], data["rvec"], data["tvec_mm"],
            data.get("model", "pinhole"),
        )  # fmt: skip

    def to_json(self) -> dict[str, Any]:
        """The `camera` object of a recording's header; `model` only where it is not the pinhole."""
        data: dict[str, Any] = {
            "image_size_px": list(self.image_size_px),
            "K": self.K.tolist(),
            "distortion": self.distortion.tolist(),
            "rvec": self.rvec.tolist(),
            "tvec_mm": self.tvec_mm.tolist(),
        }
        if self.model != "pinhole":
            data["model"] = self.model
        return data

    @property
    def camera_from_room(self) -> np.ndarray:
        """(4, 4) float64, millimetres."""
        matrix = np.eye(4)
        matrix[:3, :3] = cv2.Rodrigues(self.rvec)[0]
        matrix[:3, 3] = self.tvec_mm
        return matrix

    @property
    def centre_mm(self) -> np.ndarray:
        """(3,) float64: where the camera stands in the room."""
        return -cv2.Rodrigues(self.rvec)[0].T @ self.tvec_mm

    def project(self, points_room_mm: np.ndarray) -> np.ndarray:
        """Pixel positions of points in the room, lens distortion included.

        points_room_mm : (N, 3) float. Returns (N, 2) float64, (x, y). Rows at or behind the camera's plane are NaN.
        """
        points = np.ascontiguousarray(points_room_mm, dtype=np.float64).reshape(-1, 3)
        if not len(points):
            return np.empty((0, 2))
        if self.model == "fisheye":
            pixels, _ = cv2.fisheye.projectPoints(
                points.reshape(-1, 1, 3), self.rvec, self.tvec_mm, self.K, self.distortion
            )
        elif len(points) < _MANY or self.distortion.size > 8:
            pixels, _ = cv2.projectPoints(points, self.rvec, self.tvec_mm, self.K, self.distortion)
        else:
            pixels = self._project_many(points)
        pixels = pixels.reshape(-1, 2)
        depth_mm = points @ cv2.Rodrigues(self.rvec)[0][2] + self.tvec_mm[2]
        pixels[depth_mm <= 0] = math.nan
        return pixels

    def _project_many(self, points: np.ndarray) -> np.ndarray:
        """(N, 2) float64: what cv2.projectPoints gives with up to 8 coefficients, which takes ten times as long for it."""
        k1, k2, p1, p2, k3, k4, k5, k6 = self.distortion.tolist() + [0.0] * (8 - self.distortion.size)
        in_camera = cv2.Rodrigues(self.rvec)[0] @ points.T + self.tvec_mm[:, None]
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            x, y = in_camera[:2] / in_camera[2]
            xx, yy, xy2 = x * x, y * y, 2 * x * y
            rr = xx + yy
            radial = 1 + rr * (k1 + rr * (k2 + rr * k3))
            if k4 or k5 or k6:
                radial /= 1 + rr * (k4 + rr * (k5 + rr * k6))
            lens_x = x * radial + p1 * xy2 + p2 * (rr + 2 * xx)
            lens_y = y * radial + p1 * (rr + 2 * yy) + p2 * xy2
            pixels = np.empty((len(points), 2))
            pixels[:, 0] = self.K[0, 0] * lens_x + self.K[0, 2]
            pixels[:, 1] = self.K[1, 1] * lens_y + self.K[1, 2]
        return pixels

    def rays(self, pixels: np.ndarray) -> np.ndarray:
        """(N, 3) float64: unit directions, in the camera's own frame, in which pixels (N, 2) look."""
        points = np.ascontiguousarray(pixels, np.float64).reshape(-1, 1, 2)
        if not len(points):
            return np.empty((0, 3))
        if self.model == "fisheye":
            plane = cv2.fisheye.undistortPoints(points, self.K, self.distortion)
        else:
            plane = cv2.undistortPoints(points, self.K, self.distortion)
        rays = np.column_stack([plane.reshape(-1, 2), np.ones(len(points))])
        return rays / np.linalg.norm(rays, axis=1, keepdims=True)

    def turned(self, rvec: np.ndarray) -> Camera:
        """A camera at the origin that is turned by `rvec`: it projects directions of the camera's frame."""
        return replace(self, rvec=rvec, tvec_mm=np.zeros(3))

    def undistorted(self) -> Camera:
        """The same camera with a perfect lens: the view of `cv2.undistort` with the same K."""
        return replace(self, model="pinhole", distortion=np.zeros(5))

    def resized(self, image_size_px: Sequence[int]) -> Camera:
        """The same camera delivering another resolution of the same field of view.

        Raises CameraError where the sides' ratio differs by more than 1 %: that picture is cropped, not scaled.
        """
        width, height = image_size_px
        scale_x, scale_y = width / self.image_size_px[0], height / self.image_size_px[1]
        if abs(scale_x / scale_y - 1) > 0.01:
            raise CameraError(
                f"The frame is {width} x {height} px, but the camera was calibrated at {self.image_size_px[0]} x "
                f"{self.image_size_px[1]} px, which is another shape. Set the webcam back, or calibrate it again."
            )
        scale = np.diag([scale_x, scale_y, 1.0])
        # Pixel centres lie at whole numbers, so the picture's corner is at -0.5 and scaling is about that corner.
        half = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1.0]])
        return replace(self, image_size_px=(int(width), int(height)), K=np.linalg.inv(half) @ scale @ half @ self.K)


@dataclass(frozen=True)
class BedMotion:
    """How the bed moves in the room: `fixed`, `y` (bed slinger) or `z` (drops as the print grows).

    The camera's extrinsics hold when the machine stands at `reference_mm`.
    """

    kind: str = "fixed"
    reference_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        if self.kind not in BED_MOTIONS:
            raise CameraError(f"Unknown bed motion {self.kind!r}; known are {', '.join(BED_MOTIONS)}.")
        if not all(map(math.isfinite, self.reference_mm)):
            raise CameraError("The bed's reference position contains a number that is not finite. Set it again.")

    def room_from_print_mm(self, position_mm: Sequence[float]) -> np.ndarray:
        """(3,) float64 to add to a point of the print when the machine stands at `position_mm` (X, Y, Z)."""
        shift = np.zeros(3)
        if self.kind == "y":
            shift[1] = self.reference_mm[1] - position_mm[1]
        elif self.kind == "z":
            shift[2] = self.reference_mm[2] - position_mm[2]
        return shift
