"""What happens between a hold and its release: the printer comes to rest, pictures are taken, the eye says what it sees."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from ..core.errors import FrameError
from ..core.settings import Settings
from .blindness import NoReport, OtherFile, WentOn
from .holds import Hold, Holds
from .jobs import Print
from .link import EyeLink, Interrupted
from .parking import Park
from .webcam import Webcam

LOOK_AGAIN = ("suspect", "failed")
APART_S = 0.25
"""Between two pictures of the same hold. Within it a camera at work delivers another one."""
ATTEMPTS = 3
STRANGE = 3
"""So often in a row a printer may stand where its file has no bead's end: on its way, or because the file is another."""


@dataclass(frozen=True)
class Look:
    """One picture, and what the eye made of it. moment, check: lines of frames.jsonl and of checks.jsonl."""

    jpeg: bytes
    moment: dict[str, Any]
    check: dict[str, Any]


class Looks:
    """Takes looks while the job is held. All methods are the watching thread's.

    They raise Interrupted where the hold has lost its purpose, NoReport, FrameError, EyeGone, and what the eye raises.
    """

    def __init__(self, holds: Holds, webcam: Webcam, eye: EyeLink) -> None:
        self._holds, self._webcam, self._eye = holds, webcam, eye

    def check(self, current: Print, hold: Hold, settings: Settings) -> list[Look]:
        """One look and, where it finds something, a second one, on which the verdict then rests."""
        if hold.unheld and not current.by_height:
            return self._check_in_passing(current, hold, settings)
        with self._at_rest(current, hold, settings):
            until_s = time.monotonic() + settings.check_timeout_s
            first = self._judged(current, hold, self._fresh(current, hold, until_s), until_s)
            if first.check["verdict"] not in LOOK_AGAIN:
                return [first]
            until_s = time.monotonic() + settings.check_timeout_s
            try:
                jpeg = self._steady(current, hold, first, until_s)
                return [first, self._judged(current, hold, jpeg, until_s, again=True)]
            except FrameError as error:
                return [_unconfirmed(first, error)]

    def reference(self, current: Print, hold: Hold, settings: Settings) -> bool:
        """A picture of the empty bed for the eye, kept in `current`. False where the head stands before the bed."""
        with self._at_rest(current, hold, settings) as parked:
            until_s = time.monotonic() + settings.check_timeout_s
            jpeg = self._fresh(current, hold, until_s)
            moment = {**_moment(current, hold), "frame": "reference.jpg", "layer": 0, "parked": parked}
            answer = self._ask(current, hold, until_s, "reference", jpeg, moment=moment)
        if answer["taken"]:
            current.reference = jpeg, {"position_mm": moment["position_mm"]}
        return bool(answer["taken"])

    def _check_in_passing(self, current: Print, hold: Hold, settings: Settings) -> list[Look]:
        """The same for a print that goes on by itself: both pictures, then where it stood, then the judgement.

        See `passing` for what is known then.
        """
        self._settle(hold, settings)
        before, read = hold.position_mm, hold.read
        if not read or before is None:
            raise NoReport(
                "The printer does not report how far it is in its file (M27), so nobody can tell what to expect."
            )
        if hold.stopped.wait(settings.settle_s):
            raise Interrupted(hold.dropped)
        until_s = time.monotonic() + settings.check_timeout_s
        first = self._fresh(current, hold, until_s)
        if hold.stopped.wait(APART_S):
            raise Interrupted(hold.dropped)
        second = self._fresh(current, hold, until_s)
        self._holds.glance_again(hold)
        self._settle(hold, settings)
        stood = hold.position_mm == before and hold.read[-1:] == read[-1:]
        hold.position_mm = before
        if not hold.read:
            raise Interrupted("the printer prints no file any more")
        until_s = time.monotonic() + settings.check_timeout_s
        self._find_place(current, hold, read[0][0], until_s)
        if not stood and (current.job.header or {})["printer"]["bed_motion"] == "y":
            raise WentOn(
                "The printer went on while its picture was taken. With a bed that moves, such a picture cannot be judged: "
                "print from OctoPrint's own files."
            )
        parked = stood and current.stands_clear(before)
        look = self._judged(current, hold, first, until_s, parked=parked)
        if look.check["verdict"] not in LOOK_AGAIN:
            return [look]
        if not self._ask(current, hold, until_s, "still", first, second)["still"]:
            return [_unconfirmed(look, FrameError("The printer went on meanwhile."))]
        return [look, self._judged(current, hold, second, until_s, again=True, parked=parked)]

    def _find_place(self, current: Print, hold: Hold, done_bytes: int, until_s: float) -> None:
        most_bytes, total_bytes = hold.read[-1]
        found = self._ask(
            current, hold, until_s, "place", done_bytes=done_bytes, most_bytes=most_bytes, total_bytes=total_bytes,
            position_mm=hold.position_mm,
        )  # fmt: skip
        if not found["laid"]:
            raise Interrupted("nothing lies on the bed yet")
        current.strange = 0 if found["known"] else current.strange + 1
        if current.strange >= STRANGE:
            raise OtherFile(
                "The printer does not stand where the file of the same name and size here would have it: it prints another "
                "one. Upload that, or print from OctoPrint's own files."
            )
        if not found["known"]:
            raise Interrupted("it is not certain yet that the printer's file is the one of the same name here")
        hold.file_pos, hold.sure_pos, hold.layer = found["file_pos"], found["sure_pos"], found["layer"]

    # --- the printer ----------------------------------------------------------------------------------------------

    @contextmanager
    def _at_rest(self, current: Print, hold: Hold, settings: Settings) -> Iterator[bool]:
        """The printer stands still for as long as this lasts; True where the head stands aside, by our moves or not."""
        self._settle(hold, settings)
        moves = _moves(current, hold, settings)
        try:
            if moves is not None:
                self._holds.move(hold, moves[0])
                self._settle(hold, settings)
            if hold.stopped.wait(settings.settle_s) or hold.position_mm is None:
                raise Interrupted(hold.dropped)
            yield settings.capture == "park" and current.stands_clear(hold.position_mm)
        finally:
            if moves is not None:
                self._holds.move_back(hold, moves[1])

    @staticmethod
    def _settle(hold: Hold, settings: Settings) -> None:
        """Wait until the printer has reported where it stands."""
        if not hold.over.wait(settings.settle_timeout_s):
            raise NoReport(
                f"The printer did not report its position within {settings.settle_timeout_s:.0f} s. "
                "If that happens again, its firmware may not know M114."
            )
        if hold.position_mm is None or hold.stopped.wait(0):
            raise Interrupted(hold.dropped)

    # --- the camera -----------------------------------------------------------------------------------------------

    def _fresh(self, current: Print, hold: Hold, until_s: float) -> bytes:
        """A picture that is not, byte for byte, the last one: no sensor delivers the same noise twice."""
        for attempt in range(ATTEMPTS):
            if attempt and hold.stopped.wait(2 * APART_S):
                raise Interrupted(hold.dropped)
            jpeg = self._webcam.grab(max(until_s - time.monotonic(), 0.5), hold.stopped, current.job.webcam)
            if jpeg != current.last_jpeg:
                current.last_jpeg = jpeg
                return jpeg
        raise FrameError("The webcam delivers the same picture again and again. Restart it.")

    def _steady(self, current: Print, hold: Hold, first: Look, until_s: float) -> bytes:
        """A picture newer than the first, and like it: with the printer at rest, a view that still changes is late.

        A webcam that lags shows what the printer did before it stood still. No stream tells when its pictures were
        taken, so the one way to see that is to wait until nothing moves any more.
        """
        before = first.jpeg
        while time.monotonic() < until_s:
            if hold.stopped.wait(APART_S):
                raise Interrupted(hold.dropped)
            jpeg = self._fresh(current, hold, until_s)
            if self._ask(current, hold, until_s, "still", before, jpeg)["still"]:
                return jpeg
            before = jpeg
        raise FrameError("The picture goes on changing while the printer stands still: does the webcam lag behind?")

    # --- the eye --------------------------------------------------------------------------------------------------

    def _judged(
        self, current: Print, hold: Hold, jpeg: bytes, until_s: float, again: bool = False, parked: bool | None = None
    ) -> Look:
        moment = _moment(current, hold)
        if parked is not None:
            moment["parked"] = parked
        if again:
            moment["again"] = True
        current.frames += 1
        check = self._ask(current, hold, until_s, "check", jpeg, moment=moment)
        moment["layer"] = check["layer"]  # by height, only the eye can tell
        return Look(jpeg, moment, {**check, "action": "none"})

    def _ask(
        self, current: Print, hold: Hold, until_s: float, do: str, *blobs: bytes, **arguments: Any
    ) -> dict[str, Any]:
        timeout_s = max(until_s - time.monotonic(), 1.0)
        return self._eye.ask(
            do, *blobs, timeout_s=timeout_s, interrupted=hold.stopped, birth=current.born, **arguments
        )[0]


def _moment(current: Print, hold: Hold) -> dict[str, Any]:
    """A line of frames.jsonl for a picture taken now."""
    assert hold.position_mm is not None
    moment: dict[str, Any] = {
        "frame": f"frames/{current.frames:06d}.jpg", "file_pos": hold.file_pos, "layer": hold.layer,
        "position_mm": dict(zip("xyz", hold.position_mm)), "time_s": round(time.monotonic() - current.began_s, 3),
        "parked": hold.marked or current.stands_clear(hold.position_mm),
    }  # fmt: skip
    if hold.sure_pos is not None:
        moment["sure_pos"] = hold.sure_pos
    if current.cancelled:
        moment["cancelled"] = dict(current.cancelled)
    return moment


def _moves(current: Print, hold: Hold, settings: Settings) -> tuple[list[str], list[str]] | None:
    """Away and back, where the head is to be parked, is not out of the way already, and may be moved."""
    modes, position_mm = current.modes.get(hold.file_pos), hold.position_mm
    if settings.capture != "park" or position_mm is None or modes is None or current.stands_clear(position_mm):
        return None
    park = Park(
        current.park_at_mm(settings.park_at), settings.park_lift_mm, settings.park_retract_mm,
        settings.park_speed_mm_s, (current.job.header or {})["printer"]["volume_mm"]["height"],
    )  # fmt: skip
    return park.moves(position_mm, hold.e_mm, modes)


def _unconfirmed(look: Look, why: FrameError) -> Look:
    """No second picture agrees, so nothing is done yet: the next layer will tell."""
    check = look.check
    objects = [{**entry, "verdict": _suspect(entry["verdict"]), "mode": None} for entry in check["objects"]]
    reason = f"{check['reason']} No second picture confirms it. {why}"
    doubted = {"verdict": _suspect(check["verdict"]), "mode": None, "reason": reason, "objects": objects}
    return Look(look.jpeg, look.moment, {**check, **doubted})


def _suspect(verdict: str) -> str:
    return "suspect" if verdict == "failed" else verdict
