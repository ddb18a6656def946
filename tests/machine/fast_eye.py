"""An eye that answers at once and sees nothing: `python -m tests.machine.fast_eye`. A job's name says how many layers."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

from octoprint_moop.machine.pipe import receive, send


def answer(do: str, arguments: dict[str, Any]) -> dict[str, Any]:
    if do == "open":
        layers = int(re.sub("[^0-9]", "", Path(arguments["job"]).name))
        ends = [100 * (layer + 1) for layer in range(layers)]
        modes = [[True, True, 1200.0]]
        return {
            "road": "gcode", "layers": layers, "ends": ends, "bare_ends": [], "bounds_mm": [[80, 80, 0.3], [120, 120, 9]],
            "objects": [], "cancel_commands": [], "modes": modes, "mode_of": [0] * layers, "notes": [], "renderer": "none",
        }  # fmt: skip
    if do == "check":
        layer = arguments["moment"]["layer"]
        return {"type": "check", "verdict": "ok", "layer": layer, "E": 0.0, "reason": "", "objects": [], "total_px": 9,
                "mode": None}  # fmt: skip
    return {"renderer": "none", "taken": True, "still": True}


def main() -> None:
    while True:
        try:
            head, _ = receive(sys.stdin.buffer)
        except EOFError:
            return
        send(sys.stdout.buffer, {"id": head["id"], "result": answer(head["do"], head["arguments"])})


if __name__ == "__main__":
    main()
