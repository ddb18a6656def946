"""A webcam on loopback, with the addresses of mjpg-streamer: `?action=snapshot` and `?action=stream`."""

from __future__ import annotations

import contextlib
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, Callable
from urllib.parse import parse_qs, urlsplit

HOST = "127.0.0.1"
_STREAM_PAUSE_S = 0.5


class SnapshotServer:
    """Serves `take()`, a JPEG, over HTTP from a thread of its own. A context manager.

    post : called with the path of a POST request; its answer is a sentence, or None where there is no such path
    """

    def __init__(
        self, take: Callable[[], bytes], port: int = 0, post: Callable[[str], str | None] = lambda path: None
    ) -> None:
        lock = threading.Lock()

        def one_at_a_time() -> bytes:
            with lock:
                return take()

        self._server = _Server((HOST, port), _Handler)
        self._server.take, self._server.post = one_at_a_time, post
        self.address = f"http://{HOST}:{self._server.server_address[1]}"
        self.url = f"{self.address}/?action=snapshot"
        self._thread = threading.Thread(target=self._server.serve_forever, name="webcam", daemon=True)

    def __enter__(self) -> SnapshotServer:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._server.closing.set()
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    block_on_close = False

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self.closing = threading.Event()
        self.take: Callable[[], bytes] = bytes
        self.post: Callable[[str], str | None] = str


class _Handler(BaseHTTPRequestHandler):
    server: _Server

    def do_GET(self) -> None:
        action = parse_qs(urlsplit(self.path).query).get("action", ["snapshot"])[0]
        with contextlib.suppress(BrokenPipeError, ConnectionResetError):
            self._stream() if action == "stream" else self._snapshot()

    def do_POST(self) -> None:
        answer = self.server.post(urlsplit(self.path).path)
        self._answer(404 if answer is None else 200, "text/plain", f"{answer or 'Not found.'}\n".encode())

    def _snapshot(self) -> None:
        self._answer(200, "image/jpeg", self.server.take())

    def _answer(self, status: int, content_type: str, body: bytes) -> None:
        self.send_response(status)
        self.send_header("Content-Type", content_type)
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        self.wfile.write(body)

    def _stream(self) -> None:
        self.send_response(200)
        self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
        self.end_headers()
        while not self.server.closing.is_set():
            began_s = time.monotonic()
            jpeg = self.server.take()
            self.wfile.write(b"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: %d\r\n\r\n" % len(jpeg))
            self.wfile.write(jpeg + b"\r\n")
            # What the stream costs must not be missing to the print: at most half of one core.
            self.server.closing.wait(max(_STREAM_PAUSE_S, time.monotonic() - began_s))

    def log_message(self, *args: Any) -> None:
        """No line for each picture."""
