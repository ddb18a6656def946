"""A plugin for the benchmark's server: how late a thread of the server wakes that wants to wake every millisecond, and
how long this plugin's own hooks take in the threads that feed the printer.

What keeps the ticker waiting (the interpreter's lock, above all) keeps those threads waiting too. The hooks' time is taken
on the clock and in the thread's own processor time, which does not count what else the machine was doing.
"""

from __future__ import annotations

import json
import os
import threading
import time

import octoprint.plugin

from octoprint_moop.host.plugin import MoopPlugin

HOOKS = ("on_gcode_queuing", "on_gcode_sent", "on_gcode_received", "on_atcommand_queuing")
spent_us: list[tuple[float, float]] = []


def timed(hook):
    def run(*args, **kwargs):
        began, cpu = time.perf_counter_ns(), time.thread_time_ns()
        try:
            return hook(*args, **kwargs)
        finally:
            spent_us.append(((time.perf_counter_ns() - began) / 1000, (time.thread_time_ns() - cpu) / 1000))

    return run


for name in HOOKS:
    setattr(MoopPlugin, name, timed(getattr(MoopPlugin, name)))


class Ticker(octoprint.plugin.StartupPlugin):
    def on_after_startup(self) -> None:
        threading.Thread(target=self._tick, daemon=True).start()

    def _tick(self) -> None:
        global spent_us
        path = os.path.join(self.get_plugin_data_folder(), "late_ms.json")
        late_ms: list[float] = []
        while True:
            began = time.perf_counter()
            time.sleep(0.001)
            late_ms.append(round((time.perf_counter() - began) * 1000 - 1, 3))
            if len(late_ms) == 2000:
                spent, spent_us = spent_us, []
                with open(path, "a") as file:
                    file.write(json.dumps({"late_ms": late_ms, "hooks_us": spent}) + "\n")
                late_ms = []


__plugin_name__ = "Ticker"
__plugin_pythoncompat__ = ">=3.9,<4"
__plugin_implementation__ = Ticker()
