"""A single-file plugin for the tests' server: writes down what was sent, starts prints where REST has no way to, holds the
print for pictures of its own where a test wants that, and gives the virtual printer a storage like a real one's."""

import json
import os
import threading

import octoprint.plugin
from octoprint.schema.webcam import Webcam
from octoprint.webcams import get_snapshot_webcam, get_webcams


class Storage:
    """The virtual printer goes on with the file of its own storage whatever else it is told. A real one does no line of it
    while it obeys a command, nor (Klipper) for a tenth of a second afterwards.

    after_s : how long it waits afterwards
    """

    after_s = 0.1

    def __init__(self):
        from octoprint.plugins.virtual_printer.virtual import VirtualPrinter

        self._timer = None
        for name in ("_gcode_M400", "_gcode_M27", "_gcode_M114", "_gcode_G4"):
            setattr(VirtualPrinter, name, self._still(getattr(VirtualPrinter, name)))
        VirtualPrinter._pauseSdPrint = self._ended(VirtualPrinter._pauseSdPrint)

    def _still(self, command):
        def obey(printer, data):
            if printer._sdPrinter is None or (self._timer is None and not printer._sdPrintingSemaphore.is_set()):
                return command(printer, data)
            self._cancel()
            printer._sdPrintingSemaphore.clear()
            try:
                return command(printer, data)
            finally:
                self._timer = threading.Timer(self.after_s, lambda: self._go_on(printer))
                self._timer.start()

        return obey

    def _ended(self, pause):
        def obey(printer):
            self._cancel()
            pause(printer)

        return obey

    def _cancel(self):
        if self._timer is not None:
            self._timer.cancel()
        self._timer = None

    def _go_on(self, printer):
        self._timer = None
        printer._sdPrintingSemaphore.set()


class Spy(octoprint.plugin.SimpleApiPlugin, octoprint.plugin.WebcamProviderPlugin):
    def initialize(self):
        path = os.path.join(self.get_plugin_data_folder(), "sent.jsonl")
        self._sent = open(path, "a", buffering=1)  # noqa: SIM115  open for as long as the server runs
        self._storage = Storage()

    def on_sent(self, comm, phase, cmd, cmd_type, gcode, subcode=None, tags=None, *args, **kwargs):
        self._sent.write(json.dumps([cmd, sorted(tags or ())]) + "\n")

    def on_queuing(self, comm, phase, cmd, cmd_type, gcode, subcode=None, tags=None, *args, **kwargs):
        """As Octolapse does: hold, swallow the line, go aside, take a picture, come back, send the line, let go."""
        ours = not tags or "source:file" not in tags
        if ours or not self._stabilises or " Z" not in cmd or not self._printer.set_job_on_hold(True, blocking=False):
            return None
        self._stood = threading.Event()
        threading.Thread(target=self._snap, args=(cmd,), daemon=True).start()
        return (None,)

    def on_received(self, comm, line, *args, **kwargs):
        if self._stood is not None and "X:" in line:
            self._stood.set()
        return line

    def _snap(self, cmd):
        try:
            aside = ["G91", "G1 E-1 F2400", "G1 Z0.5 F600", "G90", "G1 X10 Y190 F9000", "M400", "M114"]
            self._printer.commands(aside, tags={"spy:snapshot"})
            self._stood.wait(10)
            webcam = get_snapshot_webcam()
            self._snapped += len(b"".join(webcam.providerPlugin.take_webcam_snapshot(webcam.config.name))) > 0
            self._printer.commands(["G91", "G1 Z-0.5 F600", "G1 E1 F2400", "G90"], tags={"spy:snapshot"})
            self._printer.commands([cmd], tags={"spy:again"})
        finally:
            self._stood = None
            self._printer.set_job_on_hold(False)

    _stabilises, _snapped, _taken, _stood = False, 0, 0, None

    def get_webcam_configurations(self):
        """A second webcam, which shows what the first one does."""
        return [Webcam(name="second", displayName="Second", canSnapshot=True, snapshotDisplay="")]

    def take_webcam_snapshot(self, name):
        first = get_webcams()["classic"]
        self._taken += 1
        return first.providerPlugin.take_webcam_snapshot(first.config.name)

    def is_api_protected(self):
        return True

    def get_api_commands(self):
        return {"start_from": ["pos"], "stabilise": ["on"], "storage": ["after_s"]}

    def on_api_command(self, command, data):
        if command == "start_from":
            self._printer.start_print(pos=data["pos"])
        elif command == "storage":
            self._storage.after_s = data["after_s"]
        else:
            self._stabilises = data["on"]

    def on_api_get(self, request):
        import flask

        moop = self._plugin_manager.get_helpers("moop")
        return flask.jsonify(
            snapped=self._snapped, taken=self._taken, status=moop["status"](), check_now=moop["check_now"]()
        )


__plugin_name__ = "Spy"
__plugin_pythoncompat__ = ">=3.9,<4"


def __plugin_load__():
    global __plugin_implementation__, __plugin_hooks__
    __plugin_implementation__ = Spy()
    __plugin_hooks__ = {
        "octoprint.comm.protocol.gcode.queuing": __plugin_implementation__.on_queuing,
        "octoprint.comm.protocol.gcode.sent": __plugin_implementation__.on_sent,
        "octoprint.comm.protocol.gcode.received": __plugin_implementation__.on_received,
    }
