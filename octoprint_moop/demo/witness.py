"""A plugin for the demo's OctoPrint alone: notes what has been sent to the virtual printer, for the webcam to see.

It is copied into that server's plugin folder. What it notes stands in a small mapped file, so that the hook does no
more than a write to memory: a print is never delayed by it.
"""

from __future__ import annotations

import os
from pathlib import Path

import octoprint.plugin
from octoprint.events import Events

from octoprint_moop.demo.notebook import Witness

__plugin_name__ = "MOOP demo witness"
__plugin_version__ = "1"
__plugin_description__ = "Tells the demo's simulated webcam what has been sent to the virtual printer."
__plugin_pythoncompat__ = ">=3.9,<4"


class WitnessPlugin(octoprint.plugin.EventHandlerPlugin):
    def __init__(self) -> None:
        self._witness = Witness(Path(os.environ["MOOP_DEMO_WITNESS"]))

    def on_sent(self, comm, phase, cmd, cmd_type, gcode, subcode=None, tags=None, *args, **kwargs):  # type: ignore[no-untyped-def]
        self._witness.sent(cmd, gcode, tags)

    def on_event(self, event, payload):  # type: ignore[no-untyped-def]
        if event == Events.PRINT_STARTED and payload["origin"] == "local":
            self._witness.job(self._file_manager.path_on_disk("local", payload["path"]))


def __plugin_load__():  # type: ignore[no-untyped-def]
    global __plugin_implementation__, __plugin_hooks__
    plugin = __plugin_implementation__ = WitnessPlugin()
    __plugin_hooks__ = {"octoprint.comm.protocol.gcode.sent": plugin.on_sent}
