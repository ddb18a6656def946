"""Commands that name and cancel objects: M486, Klipper's EXCLUDE_OBJECT, and the Cancelobject plugin's @ commands."""

from __future__ import annotations

import re

from .said import TAKEN_BACK, Said

_WORD = re.compile(r"([A-Z])\s*(-?\d+)?")
_NAMED = re.compile(r"\bNAME=(\"[^\"]*\"|'[^']*'|\S+)", re.IGNORECASE)


def named(code: str) -> str | None:
    """The NAME= of a macro's line."""
    found = _NAMED.search(code)
    return found.group(1).strip("\"'") if found else None


class ObjectCommands:
    """Notes in `said` what is said of objects."""

    def __init__(self, said: Said) -> None:
        self._said = said
        self._current = -1

    def m486(self, rest: str, laid: int, end_pos: int) -> None:
        """Marlin's and RepRapFirmware's: S selects (-1 none), A names, P cancels, C cancels the current one, U takes a
        cancelling back, T tells how many there are."""
        name = re.match(r"\s*A\s*\"?(.*?)\"?\s*$", rest, re.IGNORECASE)
        if name:
            self._name(name.group(1))
            return
        quoted = re.search(r"\bA\"([^\"]*)\"", rest, re.IGNORECASE)
        bare = rest[: quoted.start()] if quoted else re.split(r"(?<=[\s\d])A(?=\D)", rest, flags=re.IGNORECASE)[0]
        words = {letter: int(value) if value else None for letter, value in _WORD.findall(bare.upper())}
        if words.get("S") is not None:
            self._current = max(int(words["S"] or 0), -1)
            self._said.label("m486", None if self._current < 0 else str(self._current), laid)
        if quoted:
            self._name(quoted.group(1))
        elif bare != rest:
            self._name(rest[len(bare) + 1 :].strip())
        if words.get("P") is not None:
            self._said.cancelled.append(("m486", str(words["P"]), end_pos))
        if "C" in words and self._current >= 0:
            self._said.cancelled.append(("m486", str(self._current), end_pos))
        if words.get("U") is not None:
            self._said.cancelled.append(("m486", str(words["U"]), TAKEN_BACK))

    def _name(self, name: str) -> None:
        if self._current >= 0 and name:
            self._said.m486_names[self._current] = name

    def at_command(self, text: str, laid: int) -> None:
        """`Object NAME` and `ObjectEnd`, without their @."""
        word, _, rest = text.partition(" ")
        if word.lower() == "object":
            self._said.label("at_object", rest.strip() or None, laid)
        elif word.lower() == "objectend":
            self._said.label("at_object", None, laid)

    def macro(self, word: str, code: str, laid: int, end_pos: int) -> bool:
        """Klipper's commands; False where `word` is none of them."""
        if word == "EXCLUDE_OBJECT_START":
            self._said.label("exclude_object", named(code), laid)
        elif word == "EXCLUDE_OBJECT_END":
            self._said.label("exclude_object", None, laid)
        elif word == "EXCLUDE_OBJECT":
            self._exclude(named(code), code.upper(), end_pos)
        return word.startswith("EXCLUDE_OBJECT")

    def _exclude(self, name: str | None, code: str, end_pos: int) -> None:
        if "RESET=1" in code:
            self._said.cancelled.append(("exclude_object", name or "", TAKEN_BACK))
            return
        if name is None and "CURRENT=1" in code:
            labels = self._said.labels.get("exclude_object")
            name = labels.current() if labels else None
        if name is not None:
            self._said.cancelled.append(("exclude_object", name, end_pos))
