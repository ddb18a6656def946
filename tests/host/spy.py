"""A single-file plugin for the tests' server: writes down what was sent, and starts prints where REST has no way to."""

import json
import os

import octoprint.plugin


class Spy(octoprint.plugin.SimpleApiPlugin):
    def initialize(self):
        path = os.path.join(self.get_plugin_data_folder(), "sent.jsonl")
        self._sent = open(path, "a", buffering=1)  # noqa: SIM115  open for as long as the server runs

    def on_sent(self, comm, phase, cmd, cmd_type, gcode, subcode=None, tags=None, *args, **kwargs):
        self._sent.write(json.dumps([cmd, sorted(tags or ())]) + "\n")

    def is_api_protected(self):
        return True

    def get_api_commands(self):
        return {"start_from": ["pos"]}

    def on_api_command(self, command, data):
        self._printer.start_print(pos=data["pos"])


__plugin_name__ = "Spy"
__plugin_pythoncompat__ = ">=3.9,<4"


def __plugin_load__():
    global __plugin_implementation__, __plugin_hooks__
    __plugin_implementation__ = Spy()
    __plugin_hooks__ = {"octoprint.comm.protocol.gcode.sent": __plugin_implementation__.on_sent}
