"""What the browser's tests put before the page: canned answers, themes, and what axe finds."""

from __future__ import annotations

import json
import os
import shutil
import sys
from typing import Any

import cv2
import numpy as np

# MOOP_OCTOPRINT names another server's interpreter.
OCTOPRINT = os.environ.get("MOOP_OCTOPRINT", sys.executable)
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
# No GPU, no sandbox as root, and none of Chromium's own conversations with the world.
FLAGS = ["--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--disable-background-networking",
         "--disable-component-update", "--no-first-run"]  # fmt: skip
WIDTH, HEIGHT = 320, 240
PRINTER = {"volume_mm": {"width": 200, "depth": 200, "height": 200}, "bed_motion": "y"}
WIDE = {"width": 1280, "height": 1400}


def chromium_path() -> str | None:
    """The first Chromium that this machine has."""
    return next((path for name in BROWSERS if (path := shutil.which(name))), None)


def log_in(page: Any, url: str, user: str, password: str) -> None:
    give_name(page, url, user, password)
    wait_for_page(page)


def give_name(page: Any, url: str, user: str, password: str) -> None:
    page.goto(url + "/?l10n=en")
    page.wait_for_function("window.OctoPrint && OctoPrint.loginui && OctoPrint.loginui.startedUp", timeout=60_000)
    page.fill("#login-user", user)
    page.fill("#login-password", password)
    page.click("#login-button")


def show_tab(page: Any) -> None:
    """Shows our tab, also where it has dropped into the menu of tabs that a wide font leaves no room for."""
    page.wait_for_function(
        "() => (document.querySelector('#tab_plugin_moop_link a').click(), $('#tab_plugin_moop').is(':visible'))"
    )


def wait_for_page(page: Any) -> None:
    page.wait_for_function("window.OctoPrint && OctoPrint.coreui && OctoPrint.coreui.startedUp", timeout=60_000)
    page.evaluate("PNotify.removeAll()")  # pop-ups cover buttons


# What dark themes and one-column layouts do to OctoPrint's page: CSS over it, nothing else.
DARK = """
    body, .tab-content, .well, .modal, .modal-body, .modal-footer { background: #202224 !important; color: #ddd; }
    .table th, .table td, legend, label, .help-block, .help-inline { color: #ddd !important; border-color: #555 !important; }
    .btn { background: #3a3d40 !important; color: #eee !important; text-shadow: none !important; }
    input, select { background: #111 !important; color: #eee !important; }
    .alert { background: #2c3033 !important; color: #eee !important; text-shadow: none !important; }
    .alert-error { background: #51201f !important; }
    .add-on { background: #3a3d40 !important; color: #eee !important; text-shadow: none !important; }
    a { color: #7ab8f5; }
"""
ONE_COLUMN = """
    .octoprint-container, .navbar .container, .container { width: auto !important; margin: 0 !important; padding: 0 !important; }
    .octoprint-container .row { margin: 0 !important; } .octoprint-container .accordion.span4 { display: none !important; }
    .octoprint-container .tabbable.span8 { width: 100% !important; margin: 0 !important; float: none !important; }
    body { min-width: 0 !important; }
"""


def check(layer: int, verdict: str = "ok", E: float = 0.004, **more: Any) -> dict[str, Any]:
    """A line as the server sends it, FORMATS section 4 with id and limit."""
    return {
        "id": layer, "type": "check", "frame": f"frames/{layer:06d}.jpg", "layer": layer, "file_pos": 1000 * layer + 900,
        "E": E, "xor_px": int(9000 * E), "missing_px": int(6000 * E), "extra_px": int(3000 * E), "expected_px": 5000,
        "observed_px": 5000, "ignored_px": 0, "total_px": 9000, "verdict": verdict, "mode": None, "reason": "", "objects": [],
        "ms": 8.0, "limit": 0.03, **more,
    }  # fmt: skip


FAILED = check(
    9, "failed", 0.12, mode="detachment", reason="The part on the right no longer stands where it was printed.",
    objects=[{"name": "left", "E": 0.003, "verdict": "ok", "mode": None},
             {"name": "right", "E": 0.4, "verdict": "failed", "mode": "detachment"}],
)  # fmt: skip


class Canned:
    """What the server is made to say to this page: change `status` and `checks` before the page asks."""

    def __init__(self, page: Any) -> None:
        self.printer = "idle"
        self.status: dict[str, Any] = {
            "watching": False, "blind": "No print is running.", "blind_code": "idle", "job": None, "layer": None, "layers": None, "checks": 0, "last_check": None,
            "action": "none", "reason": "", "renderer": "OpenCV", "version": "0",
        }  # fmt: skip
        self.checks: list[dict[str, Any]] = []
        self.recordings: list[dict[str, Any]] | None = None  # None: as the server has them
        self.posts: list[tuple[str, Any]] = []
        self.asked: list[str] = []
        page.route("**/plugin/moop/**", self._answer)

    def print_of(self, *checks: dict[str, Any], **status: Any) -> None:
        """A running print with these checks behind it; paused where the last of them has led to that."""
        self.checks = list(checks)
        last = {**checks[-1], "age_s": 12.0} if checks else None
        self.status.update(
            watching=True,
            blind=None,
            blind_code=None,
            job="plate.gcode",
            layers=120,
            layer=checks[-1]["layer"] if checks else 0,
            checks=len(checks),
            last_check=last,
        )
        if last and last["verdict"] == "failed":
            self.status.update(action="pause", reason=last["reason"])
        self.status.update(status)
        self.printer = "paused" if self.status["action"] == "pause" else "printing"

    def _answer(self, route: Any) -> None:
        request = route.request
        path = request.url.split("/plugin/moop/")[1].split("?")[0]
        if path.startswith("static/"):
            route.continue_()
            return
        self.asked.append(path)
        if path == "calibrate/guides":
            route.fulfill(json={"lines": []})
        elif request.method == "POST" and path != "segment/preview":
            self.posts.append((path, request.post_data_json))
            route.fulfill(json={})
        elif path == "status":
            route.fulfill(json=self.status)
        elif path == "setup":
            route.fulfill(json={"format": "moop-recording", "version": 1, "camera": {}, "printer": PRINTER})
        elif path == "calibrate/printer":
            route.fulfill(json={"printer": PRINTER})
        elif path == "mesh":
            route.fulfill(json={"job": None, "mesh": None})
        elif path == "recordings" and self.recordings is not None:
            route.fulfill(json={"recordings": self.recordings})
        elif (path.startswith("recordings/") and path.endswith("/checks")) or path == "checks":
            route.fulfill(json={"checks": self.checks})
        elif path.endswith(".png") or path == "segment/preview":
            route.fulfill(body=png(path.split("/")[-1]), content_type="image/png")
        elif path.endswith(("frame.jpg", "thumbnail.jpg")) or path in ("frame", "calibrate/picture.jpg"):
            route.fulfill(body=frame(), content_type="image/jpeg")
        else:
            route.continue_()


def png(name: str) -> bytes:
    """Two blocks are expected; of the right one nothing is seen, and something lies beside it."""
    mask = np.zeros((HEIGHT, WIDTH), np.uint8)
    mask[90:150, 60:120] = 255
    if name == "expected.png":
        mask[90:150, 200:260] = 255
    elif name == "seen.png":
        mask[170:190, 200:280] = 255
    elif name == "ignored.png":
        mask[:] = 0
        mask[:20] = 255
    return bytes(cv2.imencode(".png", mask)[1])


def frame() -> bytes:
    picture = np.full((HEIGHT, WIDTH, 3), 90, np.uint8)
    picture[90:150, 60:120] = (200, 90, 30)
    picture[170:190, 200:280] = (200, 90, 30)
    return bytes(cv2.imencode(".jpg", picture)[1])


def serious_violations(page: Any, axe: str, selector: str) -> list[str]:
    """What axe calls serious or critical below `selector`, one line a finding."""
    page.evaluate(axe)
    found = page.evaluate("selector => axe.run(selector)", selector)["violations"]
    return [
        f"{rule['id']}: {node['html'][:200]} {json.dumps(node.get('any', [{}])[:1])[:200]}"
        for rule in found if rule["impact"] in ("serious", "critical") for node in rule["nodes"]
    ]  # fmt: skip
