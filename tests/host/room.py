"""A room with a printer in it: a real OctoPrint, its virtual printer, and a webcam that sees what was really sent.

The webcam's truth is made by construction: the expected mask at the file position that has really been sent, painted
in the filament's colour over a picture of a bed. That is enough to test the host; how well failures are *seen* is
tested elsewhere.
"""

from __future__ import annotations

import http.server
import json
import socket
import threading
import time
from functools import lru_cache
from pathlib import Path
from typing import Any, Callable

import cv2
import numpy as np

from octoprint_moop.core.camera import BedMotion, Camera
from octoprint_moop.core.expected.raster import CvRenderer
from octoprint_moop.core.expected.views import ExpectedViews
from octoprint_moop.core.gcode.read import read_gcode
from octoprint_moop.core.header import Header, Printer
from octoprint_moop.core.segmentation.segment import HsvThresholds
from octoprint_moop.demo.server import DemoServer
from octoprint_moop.machine.copies import is_same_name

WIDTH, HEIGHT = 640, 480
FILAMENT_BGR = (20, 120, 240)


SLOWLY = 9000
"""mm/min at which a layer of the box takes the virtual printer some tenths of a second."""


def box_gcode(
    layers: int = 12,
    side_mm: float = 30.0,
    lines_per_side: int = 3,
    height_mm: float = 0.3,
    feed_mm_min: int = 60_000,
) -> str:
    """A box of solid layers, drawn in few long moves; relative extrusion, no comments that name layers.

    feed_mm_min : SLOWLY where something is to be done while it is printed
    """
    out = ["G21", "G90", "M83", "G28", "M104 S200"]
    x0 = y0 = 100 - side_mm / 2
    for layer in range(layers):
        z, feed = height_mm * (layer + 1), feed_mm_min if layer else SLOWLY  # so that nobody misses the first
        out.append(f"G1 X{x0:.3f} Y{y0:.3f} Z{z:.3f} F12000")
        rows = int(side_mm / 0.8)
        for row in range(rows):
            y = y0 + row * 0.8
            x_from, x_to = (x0, x0 + side_mm) if row % 2 == 0 else (x0 + side_mm, x0)
            out.append(f"G1 X{x_from:.3f} Y{y:.3f} F12000")
            for part in range(1, lines_per_side + 1):
                x = x_from + (x_to - x_from) * part / lines_per_side
                out.append(f"G1 X{x:.3f} Y{y:.3f} E{side_mm / lines_per_side * 0.8 * 0.3 / 2.405:.5f} F{feed}")
    out += ["G1 Z60 F3000", "M104 S0", "G1 X0 Y190 F9000"]
    return "\n".join(out) + "\n"


def two_boxes_gcode(layers: int = 12) -> str:
    """Two boxes beside each other, labelled as Klipper has it: `left` and `right`."""
    out = [
        *(f"EXCLUDE_OBJECT_DEFINE NAME={name}" for name in ("left", "right")),
        "G21",
        "G90",
        "M83",
        "G28",
        "G4 P1500",
    ]
    for layer in range(layers):
        for name, x0 in (("left", 60.0), ("right", 125.0)):
            out.append(f"EXCLUDE_OBJECT_START NAME={name}")
            out.append(f"G1 X{x0:.3f} Y92.000 Z{0.3 * (layer + 1):.3f} F12000")
            for row in range(20):
                x_from, x_to = (x0, x0 + 16) if row % 2 == 0 else (x0 + 16, x0)
                out.append(f"G1 X{x_from:.3f} Y{92 + row * 0.8:.3f} F12000")
                out.append(f"G1 X{x_to:.3f} Y{92 + row * 0.8:.3f} E1.597 F9000")
            out.append(f"EXCLUDE_OBJECT_END NAME={name}")
    return "\n".join([*out, "G1 Z60 F3000"]) + "\n"


def camera() -> Camera:
    """Before the bed's front edge, 170 mm up, looking at the middle of the bed."""
    eye, target = np.array([100.0, -130.0, 170.0]), np.array([100.0, 100.0, 5.0])
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    K = [[1100, 0, (WIDTH - 1) / 2], [0, 1100, (HEIGHT - 1) / 2], [0, 0, 1]]
    return Camera((WIDTH, HEIGHT), K, np.zeros(5), cv2.Rodrigues(rotation)[0].ravel(), -rotation @ eye)


def header() -> dict[str, Any]:
    printer = Printer(200, 200, 200, bed=BedMotion("fixed"))
    return Header(printer, ((None, camera()),), HsvThresholds(10, 45, 0.4, 0.3)).to_json()


def slid(mask: np.ndarray) -> np.ndarray:
    """The same matter, come off the bed and lying elsewhere."""
    return np.roll(mask, (10, 40), (0, 1))


@lru_cache(maxsize=1)
def huge_jpeg() -> bytes:
    """40 megapixels."""
    return cv2.imencode(".jpg", np.full((5500, 7300, 3), 120, np.uint8))[1].tobytes()


class PaintedWebcam:
    """Serves snapshots over HTTP.

    slides_at : file position from which on the print has come off the bed, and lies elsewhere
    answer    : what is answered instead of a picture: refused, 404, html, truncated, empty, same, huge, slow
    before    : called before each answer
    shown     : a JPEG to show instead of the room
    """

    def __init__(self) -> None:
        rng = np.random.default_rng(11)
        coarse = rng.integers(70, 150, (HEIGHT // 12, WIDTH // 12, 1), dtype=np.uint8).repeat(3, axis=2)
        self._bed = cv2.resize(coarse, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC)
        self._rng = rng
        self.views: ExpectedViews | None = None
        self.file_pos: Callable[[], int] = lambda: 0
        self.slides_at = 10**9
        self.answer = "picture"
        self.served = 0
        self.before: Callable[[], None] = lambda: None
        self.shown = b""
        self._same = b""
        self._server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), self._handler())
        threading.Thread(target=self._server.serve_forever, daemon=True).start()
        self.url = f"http://127.0.0.1:{self._server.server_port}/?action=snapshot"

    def look_at(self, gcode: Path) -> None:
        self.views = ExpectedViews(read_gcode(gcode), camera(), BedMotion("fixed"), CvRenderer())

    def reset(self) -> None:
        self.slides_at, self.answer, self.before, self.shown = 10**9, "picture", lambda: None, b""
        for name in ("mask", "jpeg"):  # what a test has put in their place
            vars(self).pop(name, None)

    def close(self) -> None:
        self._server.shutdown()
        self._server.server_close()

    def jpeg(self) -> bytes:
        if self.shown:
            return self.shown
        frame = self._bed.copy()
        if self.views is not None:
            frame[self.mask(self.file_pos()) > 0] = FILAMENT_BGR
        noisy = np.clip(frame + self._rng.normal(0, 3, frame.shape), 0, 255).astype(np.uint8)
        return cv2.imencode(".jpg", noisy, [cv2.IMWRITE_JPEG_QUALITY, 90])[1].tobytes()

    def mask(self, file_pos: int) -> np.ndarray:
        """(H, W) uint8, 255 where there is matter. A test may put another in its place."""
        assert self.views is not None
        mask = self.views.at(file_pos, (0.0, 0.0, 0.0)).mask
        return slid(mask) if file_pos > self.slides_at else mask

    def _handler(self) -> type[http.server.BaseHTTPRequestHandler]:
        webcam = self

        class Handler(http.server.BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                webcam.served += 1
                webcam.before()
                answer = webcam.answer
                if answer == "refused":
                    self.connection.shutdown(socket.SHUT_RDWR)
                    return
                if answer == "404":
                    self.send_error(404)
                    return
                deadline = time.monotonic() + 20
                while webcam.answer == "slow" and time.monotonic() < deadline:
                    time.sleep(0.05)
                body = {
                    "html": lambda: b"<html><body>Log in first</body></html>",
                    "truncated": lambda: webcam.jpeg()[:9000],
                    "empty": lambda: b"",
                    "same": lambda: webcam._same,
                    "huge": huge_jpeg,
                }.get(answer, webcam.jpeg)()
                webcam._same = body
                try:
                    self.send_response(200)
                    self.send_header("Content-Type", "image/jpeg")
                    self.send_header("Content-Length", str(len(body)))
                    self.end_headers()
                    self.wfile.write(body)
                except OSError:
                    pass

            def log_message(self, *_: Any) -> None:
                pass

        return Handler


class Room:
    """The server, its webcam, and what tests ask of them."""

    def __init__(self, folder: Path, python: str, settings: dict[str, Any] | None = None) -> None:
        self.folder = folder
        self.webcam = PaintedWebcam()
        moop = {"_config_version": 1, "settle_s": 0.0, "settle_timeout_s": 5.0, "check_timeout_s": 4.0}
        moop.update(settings or {})
        self.server = DemoServer(
            folder / "server", octoprint_python=python, snapshot_url=self.webcam.url,
            plugins={"spy": Path(__file__).with_name("spy.py")},
            settings={"plugins": {"moop": moop, "classicwebcam": {"snapshotTimeout": 3}}},
        )  # fmt: skip
        self.webcam.file_pos = self.sent_pos
        self._sent_from = self._prints = self._sent_read = 0
        self._sent: list[str] = []
        self._sent_lock = threading.Lock()
        self._stored = False

    def __enter__(self) -> Room:
        self.server.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        self.server.stop()
        self.webcam.close()

    # --- doing ----------------------------------------------------------------------------------------------------

    def set_up(self) -> Any:
        return self.moop("POST", "setup", json=header())

    def warm_up(self) -> None:
        """The eye takes its time to start; a box of few lines would be printed before it has."""
        path = self.folder / "warm.gcode"
        path.write_text(box_gcode(layers=1))
        self.server.upload(path, print=False)
        self.wait("the eye is up", lambda: self.status["renderer"])

    def print(self, text: str | bytes, name: str = "", from_pos: int = 0, seen_as: Path | None = None) -> Path:
        """Begin to print, and wait until that is noticed; what was sent before is forgotten.

        seen_as : a file that lays the same at the same positions, where the webcam could not read this one
        """
        self._prints += 1
        path = self.folder / (name or f"box_{self._prints}.gcode")
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        self.webcam.look_at(seen_as or path)
        self._sent_from = len(self._sent_lines())
        name = self.server.upload(path, print=not from_pos)["files"]["local"]["name"]
        if from_pos:
            self.wait("selected", lambda: self.server.api("GET", "/api/job")["job"]["file"]["name"] == name)
            self.server.api("POST", "/api/plugin/spy", json={"command": "start_from", "pos": from_pos})
        self.wait("the print is noticed", lambda: self.status["job"] == name and self.status["blind_code"] != "idle")
        return path

    def store(self, text: str, name: str) -> tuple[str, str]:
        """Put a file into the printer's own storage; its origin and path there."""
        storage = self.server.basedir / "virtualSd"
        storage.mkdir(exist_ok=True)
        (storage / name).write_text(text)
        self.server.api("POST", "/api/printer/sd", json={"command": "init"})
        self.server.api("POST", "/api/printer/sd", json={"command": "refresh"})

        def listed() -> tuple[str, str] | None:
            for origin in ("sdcard", "printer"):  # OctoPrint 1.11's name for it, and 2.0's
                answer = self.server.request("GET", f"/api/files/{origin}")
                for file in answer.json()["files"] if answer.ok else ():
                    if is_same_name(name, file["path"]):
                        return origin, file["path"]
            return None

        return self.wait("it is listed", listed)

    def print_stored(self, origin: str, path: str) -> None:
        """Begin to print a file from the printer's own storage, and wait until that is noticed."""
        self._sent_from = len(self._sent_lines())
        self._stored = True
        # the virtual printer does the moves in such a file, and nothing else
        self.server.api("POST", "/api/printer/command", json={"commands": ["G28", "G90", "M83"]})
        self.server.api("POST", f"/api/files/{origin}/{path}", json={"command": "select", "print": True})
        self.wait("the print is noticed", lambda: self.status["job"] == path and self.status["blind_code"] != "idle")

    def reconnect(self, **virtual_printer: Any) -> None:
        """Connect anew, to a virtual printer with these settings."""
        self.server.api("POST", "/api/settings", json={"plugins": {"virtual_printer": virtual_printer}})
        self.server.api("POST", "/api/connection", json={"command": "disconnect"})
        self.wait("offline", lambda: self.server.job_state().startswith("Offline"), 20)
        self.server.api("POST", "/api/connection", json={"command": "connect"})
        self.server.wait_state({"Operational"}, 30)

    def command(self, **command: Any) -> None:
        self.server.api("POST", "/api/job", json=command)

    def moop(self, method: str, path: str, **options: Any) -> Any:
        return self.server.api(method, f"/plugin/moop/{path}", **options)

    def save(self, **settings: Any) -> Any:
        return self.server.api("POST", "/api/settings", json={"plugins": {"moop": settings}})["plugins"]["moop"]

    def settle_down(self) -> None:
        """Ready for the next test: no job, no faults, no file."""
        self.webcam.reset()
        deadline = time.monotonic() + 40
        while self.server.job_state() != "Operational" and time.monotonic() < deadline:
            self.server.request("POST", "/api/job", json={"command": "cancel"})
            time.sleep(0.5)
        self.server.wait_state({"Operational"}, 1)
        if self._stored:  # once a print from its storage was cancelled, the virtual printer ends the next one at once
            self._stored = False
            self.reconnect()

    # --- seeing ---------------------------------------------------------------------------------------------------

    @property
    def status(self) -> dict[str, Any]:
        return self.moop("GET", "status")

    @property
    def checks(self) -> list[dict[str, Any]]:
        return self.moop("GET", "checks")["checks"]

    def wait(self, what: str, condition: Callable[[], Any], timeout_s: float = 30.0) -> Any:
        """The condition's first true value. Fails with what was waited for, the status and the log's end."""
        deadline = time.monotonic() + timeout_s
        while time.monotonic() < deadline:
            found = condition()
            if found:
                return found
            time.sleep(0.05)
        raise AssertionError(f"{what}: not within {timeout_s:g} s; {self.status}\n{self.server.log_tail(30)}")

    def wait_checks(self, count: int, timeout_s: float = 30.0) -> list[dict[str, Any]]:
        return self.wait(f"{count} checks", lambda: len(self.checks) >= count and self.checks, timeout_s)

    def wait_done(self, timeout_s: float = 60.0) -> None:
        """The job has ended by itself, and all that was seen of it has been told."""
        self.server.wait_state({"Operational"}, timeout_s)
        assert self.server.api("GET", "/api/job")["progress"]["completion"] == 100
        self.wait("the end is told", lambda: self.status["blind_code"] == "idle")

    def sent(self) -> list[tuple[str, set[str]]]:
        """(command, tags) of everything sent since the last `print`."""
        return [(command, set(tags)) for command, tags in map(json.loads, self._sent_lines()[self._sent_from :])]

    def sent_of_file(self) -> list[str]:
        return [command for command, tags in self.sent() if "source:file" in tags and not _ours(tags)]

    def sent_pos(self) -> int:
        """File position of the last line of the file that was sent."""
        for line in reversed(self._sent_lines()[self._sent_from :]):
            for tag in json.loads(line)[1]:
                if tag.startswith("filepos:"):
                    return int(tag[8:])
        return 0

    def _sent_lines(self) -> list[str]:
        """All that the server has sent since it was made; asked for by the webcam's threads, too."""
        path = self.server.basedir / "data" / "spy" / "sent.jsonl"
        with self._sent_lock:
            if path.exists():
                with path.open() as file:
                    file.seek(self._sent_read)
                    whole, newline, _ = file.read().rpartition("\n")
                self._sent += whole.splitlines()
                self._sent_read += len(whole + newline)  # JSON in ASCII
            return list(self._sent)


def _ours(tags: set[str]) -> bool:
    return any(tag.startswith("moop:") for tag in tags)
