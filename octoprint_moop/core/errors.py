"""What can go wrong in a way that the person at the printer can mend.

MoopError
├── GcodeError          the G-code file cannot be read as one
├── MeshError           the model cannot be read, or is not a solid
├── RecordingError      a recording is missing something, or is of another format
├── CameraError         a camera's numbers make no sense, or do not fit the frame
├── CalibrationError    lens or pose cannot be found from these pictures
├── FrameError          the webcam gave no usable picture
├── SegmentationError   nothing can be learned from this sample
├── RenderError         no way to draw the expected mask works here
└── SettingsError       a setting is out of its range

Each message says what happened, with the value, and then what to do next. Anything that is not a MoopError is a bug
of ours and keeps its traceback in the log.
"""

from __future__ import annotations


class MoopError(Exception):
    """Something the user can mend. `code` is stable, for programs; the text is for people."""

    code = "moop"


class GcodeError(MoopError):
    code = "gcode"


class MeshError(MoopError):
    code = "mesh"


class RecordingError(MoopError):
    code = "recording"


class CameraError(MoopError):
    code = "camera"


class CalibrationError(MoopError):
    code = "calibration"


class FrameError(MoopError):
    code = "frame"


class SegmentationError(MoopError):
    code = "segmentation"


class RenderError(MoopError):
    code = "render"


class SettingsError(MoopError):
    code = "settings"
