"""Every setting: its default, its range, its unit and its sentence. Nothing else in the program repeats them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, Field, dataclass, field, fields
from typing import Any, Callable

from .errors import SettingsError
from .head import HeadModel

WIDTH_MM = 250.0  # of any bed, to see whether a head makes sense
VERSION = 1
"""Format of the stored settings. Raise it together with a new entry in MIGRATIONS."""

ACTIONS = ("none", "notify", "pause", "cancel", "cancel_object")
SEGMENTATIONS = ("adaptive", "thresholds")
SENSITIVITIES = ("low", "medium", "high")
CAPTURES = ("park", "stand", "slicer")
MILD_ACTIONS = ("none", "notify", "pause")


MOST_TEXT = 8000


def number(default: float, low: float, high: float, unit: str, sentence: str) -> Any:
    """A setting that is a number from `low` to `high`; whole where the default is an int."""
    return field(default=default, metadata={"low": low, "high": high, "unit": unit, "sentence": sentence})


def choice(default: str, choices: tuple[str, ...], sentence: str) -> Any:
    return field(default=default, metadata={"choices": choices, "sentence": sentence})


def switch(default: bool, sentence: str) -> Any:
    return field(default=default, metadata={"sentence": sentence})


def text(default: str, sentence: str, lines: bool = False) -> Any:
    """lines : it may have several"""
    return field(default=default, metadata={"sentence": sentence, **({"lines": True} if lines else {})})


@dataclass(frozen=True)
class Settings:
    """What the user chose. Always in range: made by `read_settings` or from the defaults."""

    watch_prints: bool = switch(True, "Watch every print from its start.")
    on_failed: str = choice("pause", ACTIONS, "What to do when a print has failed.")
    on_suspect: str = choice(
        "none", MILD_ACTIONS, "What to do when something is suspected, of which the next layers will tell."
    )  # fmt: skip
    on_blind: str = choice(
        "none", MILD_ACTIONS, "What to do when a print that should be watched could not be for a while."
    )
    blind_min: float = number(10.0, 0.1, 1440.0, "min", "How long that while is.")
    segmentation: str = choice(
        "adaptive",
        SEGMENTATIONS,
        "How filament is told from the rest: by what this print has shown, or by the colour limits alone.",
    )
    cool_after_min: float = number(
        0.0,
        0.0,
        1440.0,
        "min",
        "Turn the hot end off when a pause of ours lasts longer than this; 0 for never. "
        "It is heated again before the print goes on.",
    )
    bed_off_after_min: float = number(
        0.0, 0.0, 1440.0, "min",
        "Turn the bed off, too, when a pause of ours lasts longer than this; 0 to keep it warm, and the print on it. "
        "It is heated again before the print goes on.",
    )  # fmt: skip
    gcode_paused: str = text(
        "", "G-code to send after OctoPrint's own pause script when the pause is ours.", lines=True
    )
    gcode_resumed: str = text(
        "",
        "G-code to send before OctoPrint's own resume script after a pause of ours, when all is hot again.",
        lines=True,
    )
    sensitivity: str = choice("medium", SENSITIVITIES, "How little must be wrong for an alarm.")

    webcam: str = text(
        "",
        "Name of the webcam to look through; empty for OctoPrint's snapshot webcam. "
        "A print that runs keeps the one that it began with.",
    )
    capture: str = choice(
        "stand", CAPTURES,
        "Where the head is when a picture is taken: left as it stands, or moved out of the picture where it stands over "
        "the print, or where the slicer's own moves have brought it before an @moop.",
    )  # fmt: skip
    park_at: str = text("", "Where to park: x,y in mm. Empty for an edge of the bed away from the print.")
    park_lift_mm: float = number(1.0, 0.0, 20.0, "mm", "How far to lift the head on the way there and back.")
    park_retract_mm: float = number(1.0, 0.0, 10.0, "mm", "How much filament to draw back while parked.")
    park_speed_mm_s: float = number(150.0, 10.0, 1000.0, "mm/s", "How fast to go there and back.")
    every_layers: int = number(1, 1, 1000, "layers", "Look after every so many layers.")
    min_interval_s: float = number(0.0, 0.0, 3600.0, "s", "Look at most once in this time.")
    longest_s: float = number(
        300.0, 0.0, 7200.0, "s", "Look within a layer, too, when the last look is longer ago than this; 0 for never."
    )
    settle_s: float = number(0.3, 0.0, 10.0, "s", "How long the printer stands still before the picture is taken.")
    settle_timeout_s: float = number(
        120.0, 1.0, 600.0, "s", "How long to wait for the printer's moves to end before the print goes on unchecked."
    )
    check_timeout_s: float = number(
        10.0, 1.0, 60.0, "s", "How long picture and check may take together before the print goes on unchecked."
    )

    hue_min_deg: float = number(0.0, 0.0, 360.0, "°", "Lowest hue of the filament; above the highest, through 0.")
    hue_max_deg: float = number(360.0, 0.0, 360.0, "°", "Highest hue of the filament.")
    saturation_min: float = number(0.35, 0.0, 1.0, "", "Less saturated than this is not filament.")
    value_min: float = number(0.2, 0.0, 1.0, "", "Darker than this is not filament.")

    head: str = text(
        "",
        "Shape of the print head, which is ignored where it stands over the print: JSON with `head`, a list of boxes "
        "{low_mm, high_mm} around the nozzle, and `gantry`, one box or null. Empty for a common one.",
    )

    record: bool = switch(True, "Keep a recording of each watched print, from its start.")
    recordings_mb: int = number(1000, 10, 1_000_000, "MB", "Room for recordings; the oldest go first, alarms last.")


DEFAULTS: dict[str, Any] = {f.name: f.default for f in fields(Settings)}
_FIELDS: dict[str, Field[Any]] = {f.name: f for f in fields(Settings)}


def described() -> dict[str, dict[str, Any]]:
    """Name -> default, sentence, whether it is a whole number and, where they apply, low, high, unit or choices."""
    return {
        name: {"default": found.default, "whole": type(found.default) is int, **found.metadata}
        for name, found in _FIELDS.items()
    }


def read_settings(raw: Mapping[str, Any]) -> Settings:
    """Settings from stored or sent values; what is not named keeps its default, what is not known is passed over.

    Raises SettingsError naming the setting, its value and the range allowed.
    """
    return Settings(**{name: read_value(name, raw[name]) for name in DEFAULTS if raw.get(name) is not None})


def read_value(name: str, value: Any) -> Any:
    """One value, as a form or a configuration file has it (numbers may be strings), in the setting's own type.

    Raises SettingsError where the setting is unknown or the value out of its range.
    """
    if name not in _FIELDS:
        raise SettingsError(f"There is no setting {name!r}.")
    default, limits = _FIELDS[name].default, _FIELDS[name].metadata
    assert default is not MISSING
    if isinstance(default, bool):
        if str(value).lower() not in ("true", "false", "1", "0"):
            raise SettingsError(f"{name} is {value!r}; true or false is needed.")
        return str(value).lower() in ("true", "1")
    if isinstance(default, str):
        if "choices" in limits and value not in limits["choices"]:
            raise SettingsError(f"{name} is {value!r}; one of {', '.join(limits['choices'])} is needed.")
        if len(str(value)) > MOST_TEXT:
            raise SettingsError(f"{name} is {len(str(value))} characters long; at most {MOST_TEXT} are allowed.")
        if name == "head":
            HeadModel.from_text(str(value), WIDTH_MM)
        return str(value)
    low, high, unit = limits["low"], limits["high"], limits["unit"]
    try:
        found = type(default)(float(value))
    except (TypeError, ValueError, OverflowError):
        raise SettingsError(f"{name} is {value!r}; a number from {low:g} to {high:g} {unit} is needed.") from None
    if not low <= found <= high:
        raise SettingsError(f"{name} is {found:g}; {low:g} to {high:g} {unit} is allowed.")
    return found


MIGRATIONS: dict[int, Callable[[dict[str, Any]], dict[str, Any]]] = {}
"""Format n -> function from stored values of format n to those of format n + 1."""


def migrate(raw: Mapping[str, Any], version: int | None) -> dict[str, Any]:
    """Stored values of an older format in today's. `version` is None where nothing was ever stored."""
    values = dict(raw)
    for step in range(VERSION if version is None else version, VERSION):
        values = MIGRATIONS[step](values)
    return values
