"""The calibrations of each printer profile and webcam: named, dated, one of them in use, the others to go back to."""

from __future__ import annotations

import math
import threading
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from ..core.errors import CalibrationError
from .setups import Setups

MOST_KEPT = 20  # for each profile and webcam; the one in use is never dropped
MOST_NAME = 80  # characters


@dataclass(frozen=True)
class Seen:
    """How the webcam's pictures came when a calibration was made, or come now.

    image_size_px : [width, height] as delivered, None where no picture has been taken yet
    flip_h, flip_v, rotate_90 : OctoPrint's settings. They turn what its pages show, never the snapshots that are
                    measured; but who changes them has often turned the camera.
    """

    image_size_px: list[int] | None = None
    flip_h: bool = False
    flip_v: bool = False
    rotate_90: bool = False

    @classmethod
    def from_json(cls, data: Any) -> Seen:
        """What is missing or makes no sense is as by default: it only serves for comparison."""
        data = data if isinstance(data, Mapping) else {}
        size = data.get("image_size_px")
        good = isinstance(size, list) and len(size) == 2 and all(isinstance(side, int) for side in size)
        return cls(
            list(size) if good else None, *(data.get(name) is True for name in ("flip_h", "flip_v", "rotate_90"))
        )


@dataclass(frozen=True)
class Calibration:
    """parts : `printer`, `camera` and `cameras` of a recording's header. how : "pose", "points", "given" or another
    word of the set-up's. error_px : {"mean", "max"} as told by what found it, or None."""

    id: int
    name: str
    made_at: str
    how: str
    parts: dict[str, Any]
    seen: Seen = field(default_factory=Seen)
    error_px: dict[str, float] | None = None

    @classmethod
    def from_json(cls, data: Any) -> Calibration:
        """Raises KeyError, TypeError, ValueError."""
        return cls(
            int(data["id"]), str(data["name"]), str(data["made_at"]), str(data["how"]), dict(data["parts"]),
            Seen.from_json(data.get("seen")), _mean_max(data.get("error_px")),
        )  # fmt: skip

    def told(self, now: Seen) -> dict[str, Any]:
        """For a list: everything but the numbers of the camera."""
        size_px = (self.parts.get("camera") or {}).get("image_size_px")
        return {
            "id": self.id, "name": self.name, "made_at": self.made_at, "how": self.how, "image_size_px": size_px,
            "error_px": self.error_px, "stale": stale(self, now),
        }  # fmt: skip


def stale(calibration: Calibration, now: Seen) -> list[str]:
    """Why the calibration may not hold any more, a sentence each: what changed, and what to do."""
    why = []
    was = calibration.seen
    size = (calibration.parts.get("camera") or {}).get("image_size_px") or was.image_size_px
    if size and now.image_size_px and list(size) != list(now.image_size_px):
        (width, height), (now_width, now_height) = size, now.image_size_px
        change = (
            f"The webcam delivers {now_width} x {now_height} px now, and {width} x {height} px when it was calibrated"
        )
        if abs(now_width * height - now_height * width) > 0.01 * now_height * width:
            why.append(f"{change}. That is another shape: set it back, or calibrate again.")
        else:
            why.append(f"{change}. The pictures are scaled; if the picture's edges differ, calibrate again.")
    names = {"flip_h": "flip horizontally", "flip_v": "flip vertically", "rotate_90": "rotate"}
    changed = [text for name, text in names.items() if getattr(was, name) != getattr(now, name)]
    if changed:
        why.append(
            f"OctoPrint's webcam settings were changed since ({', '.join(changed)}). They do not turn the pictures that "
            "are compared; but if the camera itself was turned, calibrate its place again."
        )
    return why


class Calibrations:
    """All of them, in one JSON file. Every method may be called from any thread."""

    def __init__(self, path: Path) -> None:
        self._kept = Setups(path)
        self._lock = threading.Lock()

    def get(self, profile: str, webcam: str) -> dict[str, Any] | None:
        """The parts of the one in use; None where there is none."""
        current = self.current(profile, webcam)
        return None if current is None else current.parts

    def current(self, profile: str, webcam: str) -> Calibration | None:
        made, used = self._read(profile, webcam)
        return made[used[-1]] if used else None

    def all(self, profile: str, webcam: str) -> list[Calibration]:
        """The newest first."""
        made, _ = self._read(profile, webcam)
        return sorted(made.values(), key=lambda calibration: -calibration.id)

    def find(self, profile: str, webcam: str, calibration_id: int) -> Calibration:
        """Raises CalibrationError where there is none of that number."""
        return _found(self._read(profile, webcam)[0], calibration_id)

    def put(
        self, profile: str, webcam: str, parts: dict[str, Any], name: str = "", how: str = "given",
        seen: Seen = Seen(), error_px: dict[str, Any] | None = None,
    ) -> list[str]:  # fmt: skip
        """Keep a calibration and use it from now on; answers the names of the parts that changed. Raises OSError."""
        with self._lock:
            made, used = self._read(profile, webcam)
            old = made[used[-1]].parts if used else {}
            changed = sorted(part for part in old.keys() | parts.keys() if old.get(part) != parts.get(part))
            if not changed and (not name or name == made[used[-1]].name):
                return []
            now = datetime.now(timezone.utc)
            number = max(made, default=0) + 1
            if "camera" not in changed and used:  # the printer's geometry only: the camera is as old as it was
                before = made[used[-1]]
                how, seen, error_px = before.how, before.seen, before.error_px
            name = name.strip()[:MOST_NAME] or f"{_WORDS.get(how, how)}, {now:%Y-%m-%d %H:%M}"
            made_at = now.isoformat(timespec="seconds")
            made[number] = Calibration(number, name, made_at, how, parts, seen, _mean_max(error_px))
            self._write(profile, webcam, made, [*used, number])
            return changed

    def use(self, profile: str, webcam: str, calibration_id: int) -> Calibration:
        """From now on that one. Raises CalibrationError where there is none of that number, OSError."""
        with self._lock:
            made, used = self._read(profile, webcam)
            found = _found(made, calibration_id)
            if used[-1:] != [calibration_id]:
                self._write(profile, webcam, made, [*used, calibration_id])
            return found

    def revert(self, profile: str, webcam: str) -> Calibration:
        """Back to the one that was used before. Raises CalibrationError where there is none, OSError."""
        with self._lock:
            made, used = self._read(profile, webcam)
            if len(used) < 2:
                raise CalibrationError("There is no earlier calibration to go back to.")
            self._write(profile, webcam, made, used[:-1])
            return made[used[-2]]

    def rename(self, profile: str, webcam: str, calibration_id: int, name: str) -> Calibration:
        """Raises CalibrationError where there is none of that number or the name is empty, OSError."""
        with self._lock:
            made, used = self._read(profile, webcam)
            found = _found(made, calibration_id)
            if not name.strip():
                raise CalibrationError("A calibration needs a name of one character or more.")
            made[calibration_id] = replace(found, name=name.strip()[:MOST_NAME])
            self._write(profile, webcam, made, used)
            return made[calibration_id]

    def remove(self, profile: str, webcam: str, calibration_id: int) -> None:
        """Raises CalibrationError for the one in use, or where there is none of that number; OSError."""
        with self._lock:
            made, used = self._read(profile, webcam)
            found = _found(made, calibration_id)
            if used[-1:] == [calibration_id]:
                raise CalibrationError(f"{found.name!r} is in use. Use another one first, then remove it.")
            del made[calibration_id]
            self._write(profile, webcam, made, used)

    def _read(self, profile: str, webcam: str) -> tuple[dict[int, Calibration], list[int]]:
        """(by number, the numbers used so far, that in use last). What cannot be read is passed over."""
        kept = self._kept.get(profile, webcam)
        if not isinstance(kept, dict):
            return {}, []
        if "made" not in kept:  # from before there were several: the parts of the only one
            return {1: Calibration(1, "First calibration", "", "given", kept)}, [1]
        made = {}
        for data in kept["made"] if isinstance(kept["made"], list) else ():
            try:
                calibration = Calibration.from_json(data)
            except (AttributeError, KeyError, TypeError, ValueError):
                continue
            made[calibration.id] = calibration
        used = [number for number in kept.get("used") or () if number in made]
        return made, used

    def _write(self, profile: str, webcam: str, made: dict[int, Calibration], used: list[int]) -> None:
        used = [number for number in used if number in made]
        used = [number for place, number in enumerate(used) if used[place - 1 : place] != [number]]
        # What was neither made nor used lately goes first.
        last_used = {number: place for place, number in enumerate(used)}
        order = sorted(
            made, key=lambda number: (number == used[-1] if used else False, last_used.get(number, -1), number)
        )
        made = {number: made[number] for number in sorted(order[-MOST_KEPT:])}
        used = [number for number in used if number in made][-MOST_KEPT:]
        self._kept.put(profile, webcam, {"made": [asdict(each) for each in made.values()], "used": used})


_WORDS = {"pose": "Marker plate", "points": "Clicked points", "given": "Taken over"}


def _mean_max(error: Any) -> dict[str, float] | None:
    """{"mean", "max"} where both are numbers."""
    if not isinstance(error, Mapping):
        return None
    numbers = [error.get(name) for name in ("mean", "max")]
    told = [float(number) for number in numbers if isinstance(number, (int, float)) and math.isfinite(number)]
    return dict(zip(("mean", "max"), told)) if len(told) == 2 else None


def _found(made: dict[int, Calibration], calibration_id: int) -> Calibration:
    if calibration_id not in made:
        raise CalibrationError(f"There is no calibration number {calibration_id} for this printer and webcam.")
    return made[calibration_id]
