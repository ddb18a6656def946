"""Why nobody is watching, as codes that programs and the page can tell apart; the sentence beside each is for people.

Besides these, the `code` of any MoopError may be the reason: what went wrong is then what ended the watching.
"""

from __future__ import annotations

from ..core.errors import MoopError

IDLE = "idle"
READING = "reading"
NOT_LOCAL = "not_local"
NOT_SET_UP = "not_set_up"
OFF = "off"
OFF_FOR_PRINT = "off_for_print"
NO_LAYERS = "no_layers"
NOT_HELD = "not_held"
FILE_CHANGED = "file_changed"
RESTARTING = "restarting"
UNUSABLE = "unusable"
CAMERA_MOVED = "camera_moved"
OUT_OF_VIEW = "out_of_view"
BUG = "bug"

UNCONFIRMED = (
    "This print runs from the printer's own storage. A file of the same name and size is here: it is looked at by the clock, "
    "from the first look on that finds the printer where that file has it."
)

WANTED = (IDLE, READING, OFF, OFF_FOR_PRINT)
"""Nobody watches, and nobody expects it."""

MEANINGS = {
    IDLE: "no print is running",
    READING: "the G-code is being read, and watching begins afterwards",
    NOT_LOCAL: "the print runs from the printer's own storage",
    NOT_SET_UP: "where the camera stands was never set up for this printer profile and webcam",
    OFF: "watching is switched off in the settings",
    OFF_FOR_PRINT: "the user has switched watching off for this print",
    NO_LAYERS: "the file extrudes nothing",
    NOT_HELD: "the printer's connection cannot be held for a look",
    FILE_CHANGED: "the lines that are sent are not those of the file",
    RESTARTING: "the process that looks has ended and is being started again",
    UNUSABLE: "nothing can be seen in the last picture",
    CAMERA_MOVED: "the camera has moved since the set-up",
    OUT_OF_VIEW: "nothing of the print is in the picture",
    BUG: "an error of ours, which the log describes",
}
"""Code -> what it means, for all that are not an error's own."""


class NoReport(MoopError):
    """The printer was asked where it stands and did not say."""

    code = "no_report"


class OtherFile(MoopError):
    """What the printer reads from its own storage is not the file that was taken for its copy."""

    code = NOT_LOCAL


class WentOn(MoopError):
    """The printer did not stand still for a picture that needs it to."""

    code = NOT_HELD
