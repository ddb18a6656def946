"""What others may read of the watch: its status, the checks of this print, and their pictures.

Written by the watching thread alone. Each change publishes a new value and never alters an old one, so readers need
no lock.
"""

from __future__ import annotations

import json
import time
from collections import OrderedDict
from typing import Any, Callable

from . import blindness

IDLE = "No print is running."
KEPT_PICTURES = 60

Tell = Callable[[str, dict[str, Any]], None]


class Ledger:
    """tell : called with (kind, payload) for `status` at each change, `check` for each check, `blind` for each new
    reason why nothing is checked, and with the verdict for those that are not ok"""

    def __init__(self, tell: Tell, version: str) -> None:
        self._tell = tell
        self._checks: tuple[dict[str, Any], ...] = ()
        self._checks_json: tuple[bytes, ...] = ()
        self._pictures: OrderedDict[int, dict[str, bytes]] = OrderedDict()
        self._checked_s = 0.0
        self._status: dict[str, Any] = {
            "watching": False, "blind": IDLE, "blind_code": blindness.IDLE, "job": None, "layer": None, "layers": None,
            "checks": 0, "last_check": None, "action": "none", "reason": "", "renderer": "", "road": "gcode",
            "version": version, "held_s": 0.0, "reading": None, "recording": None, "not_recorded": "",
        }  # fmt: skip

    # --- read by anybody ------------------------------------------------------------------------------------------

    @property
    def status(self) -> dict[str, Any]:
        """docs/formats.md, section 5."""
        status = self._status
        if status["last_check"] is None:
            return status
        return {**status, "last_check": {**status["last_check"], "age_s": round(self.age_s, 1)}}

    @property
    def checks(self) -> tuple[dict[str, Any], ...]:
        """All checks of this print, or of the last one until the next begins."""
        return self._checks

    @property
    def checks_json(self) -> bytes:
        """{"checks": [...]}. Each check was written once: writing ten thousand at a time would keep the interpreter's
        lock, and with it the printer, for as long as that takes."""
        return b'{"checks": [%s]}' % b", ".join(self._checks_json)

    @property
    def age_s(self) -> float:
        """Since the last check."""
        return time.monotonic() - self._checked_s

    def picture(self, check_id: int, kind: str) -> bytes | None:
        """frame.jpg, seen.png, expected.png or ignored.png of a recent check; None where it is not kept any more."""
        return self._pictures.get(check_id, {}).get(kind)

    # --- written by the watch -------------------------------------------------------------------------------------

    def begin(self, job: str) -> None:
        self._checks, self._pictures, self._checked_s = (), OrderedDict(), time.monotonic()
        self._checks_json = ()
        self.note(
            blind="The G-code is being read.", blind_code=blindness.READING, job=job, layer=None, layers=None, checks=0,
            last_check=None, action="none", reason="", held_s=0.0, recording=None, not_recorded="",
        )  # fmt: skip

    def idle(self) -> None:
        self.blind(blindness.IDLE, IDLE)

    def blind(self, code: str, why: str, **changes: Any) -> None:
        """Nobody is watching. code : one of `blindness`, or an error's own; why : a sentence"""
        self.note(blind=why, blind_code=code, **changes)

    def recorded(self, name: str | None, why_not: str) -> None:
        """As a Recorder tells it."""
        self.note(recording=name, not_recorded=why_not)

    def note(self, **changes: Any) -> None:
        """Change some of the status, and tell. `blind` None, and nobody is blind any more."""
        if changes.get("blind", "") is None:
            changes["blind_code"] = None
        before = self._status
        after = {**before, **changes}
        after["watching"] = after["blind"] is None
        if after == before:
            return
        self._status = after
        self._tell("status", self.status)
        if after["blind"] not in (None, IDLE, before["blind"]):
            self._tell("blind", {
                "job": after["job"], "layer": after["layer"], "code": after["blind_code"], "reason": after["blind"],
            })  # fmt: skip

    def tell_unwatched(self) -> None:
        """A print goes on (or was paused) that nobody has watched for long."""
        status = self._status
        self._tell("unwatched", {
            "job": status["job"], "layer": status["layer"], "code": status["blind_code"], "reason": status["reason"],
            "action": status["action"],
        })  # fmt: skip

    def add(self, check: dict[str, Any], pictures: dict[str, bytes], held_s: float) -> None:
        """A check that was made; what it says about being blind goes into the status."""
        self._checked_s = time.monotonic()
        check = {**check, "id": len(self._checks), "held_s": round(held_s, 3)}
        self._checks = (*self._checks, check)
        self._checks_json = (*self._checks_json, json.dumps(check).encode())
        self._pictures[check["id"]] = pictures
        while len(self._pictures) > KEPT_PICTURES:
            self._pictures.popitem(last=False)
        code, blind = None, None
        if check["verdict"] in (blindness.UNUSABLE, blindness.CAMERA_MOVED):
            code = blindness.OUT_OF_VIEW if check["total_px"] == 0 else check["verdict"]
            blind = check["reason"]
        self.note(
            blind=blind, blind_code=code, checks=len(self._checks), last_check=check,
            held_s=round(self._status["held_s"] + held_s, 3),
        )  # fmt: skip
        self._tell("check", check)
        if check["verdict"] != "ok":
            self._tell(check["verdict"], {"check": check, "action": check["action"]})
