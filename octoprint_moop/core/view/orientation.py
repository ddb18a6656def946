"""OctoPrint's webcam settings flipH, flipV and rotate90: how a snapshot is turned before people see it.

One convention: every picture, mask, click and calibration is in the pixels of the snapshot as the camera sends it.
OctoPrint never turns snapshots (its timelapse does so when it renders), so these settings change no mask. They matter
where a calibration comes from pictures that had been turned, such as screenshots of a page: `inverse.camera` mends it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from ..camera import Camera
from ..errors import CameraError


@dataclass(frozen=True)
class Orientation:
    """First left and right exchanged, then top and bottom, then a quarter turn counter-clockwise, as OctoPrint does."""

    flip_h: bool = False
    flip_v: bool = False
    rotate_90: bool = False

    def apply(self, picture: np.ndarray) -> np.ndarray:
        """The picture (H, W, ...) as OctoPrint shows it."""
        if self.flip_h:
            picture = picture[:, ::-1]
        if self.flip_v:
            picture = picture[::-1]
        return np.ascontiguousarray(np.rot90(picture) if self.rotate_90 else picture)

    def undo(self, picture: np.ndarray) -> np.ndarray:
        """The picture as the camera sent it, from one that OctoPrint shows."""
        if self.rotate_90:
            picture = np.rot90(picture, -1)
        if self.flip_v:
            picture = picture[::-1]
        return np.ascontiguousarray(picture[:, ::-1] if self.flip_h else picture)

    @property
    def inverse(self) -> Orientation:
        """What turns a picture back: undo(p) == inverse.apply(p)."""
        if not self.rotate_90:
            return self
        return Orientation(not self.flip_v, not self.flip_h, True)

    def camera(self, camera: Camera) -> Camera:
        """The camera that would send these pictures as OctoPrint shows them.

        Raises CameraError where no camera can: a picture flipped once is a mirror's, and a tilted sensor cannot be
        turned in OpenCV's model.
        """
        turn = np.diag([-1.0 if self.flip_h else 1.0, -1.0 if self.flip_v else 1.0])
        if self.rotate_90:
            turn = np.array([[0.0, 1.0], [-1.0, 0.0]]) @ turn
        if np.linalg.det(turn) < 0:
            raise CameraError(
                "A picture that is flipped only once is a mirror's, which no camera sends. Use both flips."
            )
        if camera.distortion.size == 14 and camera.distortion[12:].any() and camera.model == "pinhole":
            raise CameraError(
                "A lens with a tilted sensor (14 numbers) cannot be turned. Calibrate it as it is mounted."
            )
        size_px = np.array(camera.image_size_px)
        turned_px = np.abs(turn) @ size_px
        K = np.eye(3)
        K[:2, :2] = turn @ camera.K[:2, :2] @ turn.T
        K[:2, 2] = turn @ (camera.K[:2, 2] - (size_px - 1) / 2) + (turned_px - 1) / 2
        distortion = camera.distortion.copy()
        if camera.model == "pinhole":
            # Brown's tangential part is r²·t + 2·(t·n)·n with t = (p2, p1), so t turns like n; so do the thin prism's.
            for pair in ([3, 2], [8, 10], [9, 11]):
                if max(pair) < distortion.size:
                    distortion[pair] = turn @ distortion[pair]
        about_axis = np.eye(3)
        about_axis[:2, :2] = turn
        return replace(
            camera,
            image_size_px=(int(turned_px[0]), int(turned_px[1])),
            K=K,
            distortion=distortion,
            rvec=cv2.Rodrigues(about_axis @ camera.camera_from_room[:3, :3])[0].ravel(),
            tvec_mm=about_axis @ camera.tvec_mm,
        )
