"""A plugin for the benchmark's server: how late a thread of the server wakes that wants to wake every millisecond, and
how long this plugin's own hooks take in the threads that feed the printer.

What keeps the ticker waiting (the interpreter's lock, above all) keeps those threads waiting too. Where it was late, which
threads were at work in that moment is noted: code of this plugin's among them is what the wait can be blamed on. The hooks'
time is taken on the clock and in the thread's own processor time, which does not count what else the machine was doing.
"""

from __future__ import annotations

import json
import linecache
import os
import re
import sys
import threading
import time
from types import FrameType

import octoprint.plugin

from octoprint_moop.host.plugin import MoopPlugin

HOOKS = ("on_gcode_queuing", "on_gcode_sent", "on_gcode_received", "on_atcommand_queuing")
LATE_MS = 2.0
WAITS = re.compile(r"\.(get|wait|read|readline|recv\w*|select|poll|acquire|accept|join)\(|sleep\(|run_forever|_exactly")
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


def at_work() -> tuple[list[str], list[str]]:
    """Where threads are that do not wait for anything: those with this plugin's code on their stack, and the others."""
    ours, others = [], []
    for ident, frame in sys._current_frames().items():
        if ident == threading.get_ident() or WAITS.search(linecache.getline(frame.f_code.co_filename, frame.f_lineno)):
            continue
        place = _place(frame)
        above: FrameType | None = frame
        while above is not None and "octoprint_moop" not in above.f_code.co_filename:
            above = above.f_back
        if above is None:
            others.append(place)
        else:
            ours.append(place if above is frame else f"{_place(above)} → {place}")
    return ours, others


def _place(frame: FrameType) -> str:
    return f"{os.path.basename(frame.f_code.co_filename)}:{frame.f_code.co_name}"


class Ticker(octoprint.plugin.StartupPlugin):
    def on_after_startup(self) -> None:
        threading.Thread(target=self._tick, daemon=True).start()

    def _tick(self) -> None:
        global spent_us
        path = os.path.join(self.get_plugin_data_folder(), "late_ms.json")
        late_ms: list[float] = []
        blamed = []
        while True:
            began = time.perf_counter()
            time.sleep(0.001)
            late_ms.append(round((time.perf_counter() - began) * 1000 - 1, 3))
            if late_ms[-1] > LATE_MS:
                blamed.append((late_ms[-1], *at_work()))
            if len(late_ms) == 2000:
                spent, spent_us = spent_us, []
                with open(path, "a") as file:
                    file.write(json.dumps({"late_ms": late_ms, "hooks_us": spent, "blamed": blamed}) + "\n")
                late_ms, blamed = [], []


__plugin_name__ = "Ticker"
__plugin_pythoncompat__ = ">=3.9,<4"
__plugin_implementation__ = Ticker()
