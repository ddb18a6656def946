"""Eyes that behave badly, started as `python -m tests.machine.eyes`; the environment says how."""

from __future__ import annotations

import os
import sys
import time

from octoprint_moop.machine.pipe import receive, send


def main() -> None:
    if os.environ.get("EYE") == "broken":
        raise ImportError("libGL.so.1: cannot open shared object file")
    while True:
        try:
            head, blobs = receive(sys.stdin.buffer)
        except EOFError:
            return
        do, arguments = head["do"], head["arguments"]
        if do == "die":
            os._exit(3)
        if do == "hang":
            time.sleep(60)
        if do == "count":
            for ratio in (0.25, 0.75):
                send(sys.stdout.buffer, {"id": head["id"], "progress": ratio})
                time.sleep(arguments.get("s", 0.2))
        if do == "sleep":
            time.sleep(arguments["s"])
        if do == "babble":
            sys.stdout.buffer.write(b"\xff\xff\xff\xffwarning: something\n")
            sys.stdout.buffer.flush()
            continue
        if do == "refuse":
            send(sys.stdout.buffer, {"id": head["id"], "error": {"code": "camera", "message": "No such lens."}})
            continue
        send(sys.stdout.buffer, {"id": head["id"], "result": arguments}, blobs)


if __name__ == "__main__":
    main()
