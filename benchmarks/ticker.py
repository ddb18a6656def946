"""A plugin for the benchmark's server: how late a thread of the server wakes that wants to wake every millisecond.

What keeps it waiting (the interpreter's lock, above all) keeps the threads waiting that feed a printer.
"""

from __future__ import annotations

import json
import os
import threading
import time

import octoprint.plugin


class Ticker(octoprint.plugin.StartupPlugin):
    def on_after_startup(self) -> None:
        threading.Thread(target=self._tick, daemon=True).start()

    def _tick(self) -> None:
        path = os.path.join(self.get_plugin_data_folder(), "late_ms.json")
        late_ms: list[float] = []
        while True:
            began = time.perf_counter()
            time.sleep(0.001)
            late_ms.append(round((time.perf_counter() - began) * 1000 - 1, 3))
            if len(late_ms) == 2000:
                with open(path, "a") as file:
                    file.write(json.dumps(late_ms) + "\n")
                late_ms = []


__plugin_name__ = "Ticker"
__plugin_pythoncompat__ = ">=3.9,<4"
__plugin_implementation__ = Ticker()
