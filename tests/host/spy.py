"""A single-file plugin for the tests' server: writes down what was sent to the printer, and can eavesdrop on threads."""

import json
import os

import octoprint.plugin


class Spy(octoprint.plugin.OctoPrintPlugin):
    def initialize(self):
        self._sent = open(os.path.join(self.get_plugin_data_folder(), "sent.jsonl"), "a", buffering=1)

    def on_sent(self, comm, phase, cmd, cmd_type, gcode, subcode=None, tags=None, *args, **kwargs):
        self._sent.write(json.dumps([cmd, sorted(tags or ())]) + "\n")


__plugin_name__ = "Spy"
__plugin_pythoncompat__ = ">=3.9,<4"


def __plugin_load__():
    global __plugin_implementation__, __plugin_hooks__
    __plugin_implementation__ = Spy()
    __plugin_hooks__ = {"octoprint.comm.protocol.gcode.sent": __plugin_implementation__.on_sent}
