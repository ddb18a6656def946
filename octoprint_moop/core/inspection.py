"""The flow on one page: frame and moment in, check out. The live plugin and the replay both come through here."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Any, Protocol

import cv2
import numpy as np

from .camera import Camera
from .compare import Comparison, compare
from .decide import FAILED, OK, UNUSABLE, History, decide
from .errors import FrameError, SegmentationError
from .expected import Expected, ExpectedViews, MaskRenderer
from .header import Header, Moment
from .segment import segment_hsv
from .toolpath import Toolpath


@dataclass(frozen=True)
class Check:
    """What was concluded from one frame: a line of checks.jsonl and of `moop replay --json`."""

    moment: Moment
    verdict: str
    comparison: Comparison | None = None
    limit: float | None = None
    mode: str | None = None
    reason: str = ""
    objects: tuple[dict[str, Any], ...] = ()
    ms: float = 0.0

    def to_json(self) -> dict[str, Any]:
        """The check line of FORMATS.md, section 4. Counts are null where nothing could be compared."""
        seen = self.comparison
        counts = ("xor_px", "missing_px", "extra_px", "expected_px", "observed_px", "ignored_px", "total_px")
        return {
            "type": "check",
            "frame": self.moment.frame,
            "layer": self.moment.layer,
            "file_pos": self.moment.file_pos,
            "E": None if seen is None else round(seen.error_ratio, 6),
            **{name: None if seen is None else getattr(seen, name) for name in counts},
            "verdict": self.verdict,
            "mode": self.mode,
            "reason": self.reason,
            "objects": list(self.objects),
            "limit": None if self.limit is None else round(self.limit, 6),
            "ms": round(self.ms, 2),
        }


@dataclass(frozen=True, eq=False)
class Pictures:
    """What a check looked at, for people: frame (H, W, 3) uint8 BGR; masks (H, W) uint8, 0 or 255, in its pixels."""

    frame: np.ndarray
    observed: np.ndarray
    expected: np.ndarray
    ignored: np.ndarray


class Inspector:
    """Looks at one print, frame by frame, in time order. Keeps what it learned of this print so far."""

    def __init__(
        self,
        header: Header,
        toolpath: Toolpath,
        renderer: MaskRenderer,
        jump_ratio: float = 0.03,
        reference_bgr: np.ndarray | None = None,
    ) -> None:
        if header.material is None:
            raise SegmentationError("The filament's colour is not set. Click on it in the set-up.")
        self._header, self._toolpath, self._renderer = header, toolpath, renderer
        self._jump_ratio = jump_ratio
        self._views: dict[str | None, ExpectedViews] = {}
        self._history = History()
        self.pictures: Pictures | None = None

    def expected(self, moment: Moment) -> Expected:
        """What must be seen at that moment, by that moment's camera, in the frame's own pixels."""
        return self._view(moment, self._header.camera(moment.camera)).at(moment.file_pos, moment.position_mm)

    def check(self, frame_bgr: np.ndarray, moment: Moment) -> Check:
        """Compare one frame with what must be seen. A frame that cannot be used is a verdict, not an error.

        Raises RenderError where the expected mask cannot be drawn.
        """
        began_s = time.perf_counter()
        check = self._check(frame_bgr, moment)
        return replace(check, ms=(time.perf_counter() - began_s) * 1000)

    def _check(self, frame_bgr: np.ndarray, moment: Moment) -> Check:
        try:
            camera = self._header.camera(moment.camera)
            frame_bgr = fit_frame(frame_bgr, camera)
        except FrameError as error:
            return Check(moment, UNUSABLE, reason=str(error))
        expected = self.expected(moment)
        observed = self.observe(frame_bgr, expected)
        ignored = np.zeros_like(observed)
        comparison = compare(expected.mask, observed, expected.complete, ignored)
        self.pictures = Pictures(frame_bgr, observed, expected.mask, ignored)
        decision, self._history = decide(self._history, comparison.error_ratio, self._jump_ratio)
        mode = "unknown" if decision.verdict == FAILED else None
        return Check(moment, decision.verdict, comparison, decision.limit, mode, decision.reason)

    def observe(self, frame_bgr: np.ndarray, expected: Expected | None = None) -> np.ndarray:
        """(H, W) uint8, 255 where filament is seen."""
        assert self._header.material is not None
        return cv2.medianBlur(segment_hsv(frame_bgr, self._header.material), 3)

    def _view(self, moment: Moment, camera: Camera) -> ExpectedViews:
        if moment.camera not in self._views:
            self._views[moment.camera] = ExpectedViews(
                self._toolpath, camera, self._header.printer.bed, self._renderer
            )
        return self._views[moment.camera]


def fit_frame(frame_bgr: np.ndarray, camera: Camera) -> np.ndarray:
    """The frame at the camera's size. Raises FrameError where it is of another shape."""
    width, height = camera.image_size_px
    if frame_bgr.shape[1::-1] == (width, height):
        return frame_bgr
    if abs(frame_bgr.shape[1] / width - frame_bgr.shape[0] / height) * width > 2:
        raise FrameError(
            f"The frame is {frame_bgr.shape[1]} x {frame_bgr.shape[0]} px, but the camera was calibrated at {width} x "
            f"{height} px. Set the webcam back, or calibrate it again."
        )
    return cv2.resize(frame_bgr, (width, height), interpolation=cv2.INTER_AREA)


@dataclass(frozen=True)
class Summary:
    """What a whole print came to: the last line of a replay."""

    checks: int
    first_suspect_layer: int | None
    first_failed_layer: int | None
    mode: str | None
    failed_objects: tuple[str, ...]
    action: str
    ms_p50: float
    ms_p95: float

    @classmethod
    def of(cls, checks: list[Check], action_when_failed: str = "pause") -> Summary:
        failed = next((check for check in checks if check.verdict == FAILED), None)
        suspect = next((check for check in checks if check.verdict in ("suspect", FAILED)), None)
        times_ms = np.array([check.ms for check in checks] or [0.0])
        return cls(
            checks=len(checks),
            first_suspect_layer=suspect.moment.layer if suspect else None,
            first_failed_layer=failed.moment.layer if failed else None,
            mode=failed.mode if failed else None,
            failed_objects=tuple(o["name"] for o in failed.objects if o["verdict"] == FAILED) if failed else (),
            action=action_when_failed if failed else "none",
            ms_p50=round(float(np.percentile(times_ms, 50)), 2),
            ms_p95=round(float(np.percentile(times_ms, 95)), 2),
        )

    def to_json(self) -> dict[str, Any]:
        return {"type": "summary", **self.__dict__, "failed_objects": list(self.failed_objects)}


__all__ = ["OK", "Check", "Inspector", "Pictures", "Summary", "fit_frame"]
