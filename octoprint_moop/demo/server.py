"""A real OctoPrint server with its virtual printer, on loopback, in a folder of its own."""

from __future__ import annotations

import contextlib
import json
import os
import secrets
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

from ..core.errors import MoopError

USER = "demo"
HOST = "127.0.0.1"
# Plugins that look for updates, news or other servers; a demo and a test must run without a network.
SILENT = ("softwareupdate", "announcements", "errortracking", "discovery", "firmware_check", "file_check",
           "achievements", "health_check")  # fmt: skip
_WIZARDS = {"corewizard": 99, "backup": None, "tracking": None, "classicwebcam": 1, "file_check": 1, "moop": 99}


class ServerError(MoopError):
    """The demo's server did not do what it should; the text ends with what its log says."""

    code = "demo_server"


def free_port() -> int:
    """A TCP port of loopback that nobody listens on just now."""
    with socket.socket() as probe:
        probe.bind((HOST, 0))
        return int(probe.getsockname()[1])


class DemoServer:
    """An OctoPrint with one administrator (`user`, `password`, `api_key`), and a virtual printer.

    basedir          : its folder; made where it does not exist, left in place by `stop`
    port             : 0 for a free one
    octoprint_python : the interpreter of the environment that has OctoPrint and this plugin
    snapshot_url     : address of the webcam's snapshot, "" for none
    plugins          : single-file plugins to load besides, name -> file
    settings         : merged into config.yaml
    environment      : variables for the server's process, besides our own

    Usable as a context manager: started on entry, stopped on exit.
    """

    def __init__(
        self,
        basedir: Path | str,
        port: int = 0,
        octoprint_python: Path | str = sys.executable,
        snapshot_url: str = "",
        plugins: Mapping[str, Path] | None = None,
        settings: Mapping[str, Any] | None = None,
        environment: Mapping[str, str] | None = None,
    ) -> None:
        self.basedir = Path(basedir)
        self.port = port or free_port()
        self.url = f"http://{HOST}:{self.port}"
        self.user, self.password, self.api_key = USER, secrets.token_urlsafe(6), secrets.token_hex(16)
        self._python = str(octoprint_python)
        self._snapshot_url = snapshot_url
        self._plugins = dict(plugins or {})
        self._settings = settings or {}
        self._environment = {**os.environ, **(environment or {})}
        self._process: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> DemoServer:
        self.start()
        try:
            self.wait_operational()
        except BaseException:
            self.stop()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    # --- life ---------------------------------------------------------------------------------------------------

    def start(self) -> None:
        """Writes the folder and starts the process; returns before the server answers. Raises ServerError.

        The folder may be that of an earlier server: its uploads and recordings stay, its users and settings are new.
        """
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((HOST, self.port))
            except OSError as error:
                raise ServerError(f"Port {self.port} cannot be used ({error.strerror}). Choose another one.") from None
        self.basedir.mkdir(parents=True, exist_ok=True)
        (self.basedir / "config.yaml").write_text(json.dumps(self._config(), indent=1))  # JSON is YAML
        for name, source in self._plugins.items():
            (self.basedir / "plugins").mkdir(exist_ok=True)
            shutil.copyfile(source, self.basedir / "plugins" / f"{name}.py")
        self._add_user()
        command = [*self._octoprint(), "serve", "--iknowwhatimdoing", "--host", HOST, "--port", str(self.port)]
        with (self.basedir / "serve.log").open("ab") as log:
            # A session of its own: Ctrl-C reaches us alone, and `stop` can end it with all its children.
            self._process = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, start_new_session=True,
                env=self._environment,
            )  # fmt: skip

    def wait_operational(self, timeout_s: float = 180.0) -> None:
        """Returns when the printer is connected. Raises ServerError when the process ends, or after `timeout_s`."""
        self.wait_state({"Operational"}, timeout_s)

    def stop(self, timeout_s: float = 15.0) -> None:
        """Ends the server and everything that it started. Harmless where nothing runs."""
        process, self._process = self._process, None
        if process is None:
            return
        if process.poll() is None:
            process.terminate()
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(timeout_s)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()

    # --- talking to it ------------------------------------------------------------------------------------------

    def request(self, method: str, path: str, timeout_s: float = 30.0, **options: Any) -> Any:
        """The `requests.Response` to `path` ("/api/job"), with the administrator's key; options as `requests.request`.

        Raises ServerError where the server cannot be reached.
        """
        import requests

        headers = {"X-Api-Key": self.api_key, **options.pop("headers", {})}
        try:
            return requests.request(method, self.url + path, headers=headers, timeout=timeout_s, **options)
        except requests.RequestException as error:
            raise ServerError(f"The demo's server does not answer at {self.url}{path}: {error}") from None

    def api(self, method: str, path: str, json: Any = None, **options: Any) -> Any:
        """The decoded JSON answer, None where it is empty. Raises ServerError unless the status is 2xx."""
        response = self.request(method, path, json=json, **options)
        if not response.ok:
            raise ServerError(f"{method} {path} was answered with {response.status_code}: {response.text[:500]}")
        return response.json() if response.content else None

    def upload(self, path: Path | str, print: bool = True) -> Any:
        """Uploads a G-code file, selects it, and starts it where `print`."""
        path = Path(path)
        with path.open("rb") as file:
            return self.api(
                "POST", "/api/files/local", files={"file": (path.name, file)}, timeout_s=120.0,
                data={"select": "true", "print": "true" if print else "false"},
            )  # fmt: skip

    def job_state(self) -> str:
        """What OctoPrint calls the printer's state: Operational, Printing, Pausing, Paused, …"""
        return str(self.api("GET", "/api/job")["state"])

    def wait_state(self, states: Collection[str], timeout_s: float) -> str:
        """The first of `states` (or of those that begin so) that the printer is in.

        Raises ServerError when the process ends, on a state of error, or after `timeout_s`.
        """
        deadline, seen = time.monotonic() + timeout_s, "no answer"
        while time.monotonic() < deadline:
            if self._process is None or self._process.poll() is not None:
                raise ServerError(f"The demo's server ended by itself. The end of its log:\n{self.log_tail()}")
            try:
                seen = self.job_state()
            except ServerError:  # still starting, or a moment too busy
                seen = "no answer"
            for state in states:
                if seen.startswith(state):
                    return state
            if "error" in seen.lower():
                raise ServerError(f"The virtual printer is in state {seen!r}. The end of the log:\n{self.log_tail()}")
            time.sleep(0.2)
        raise ServerError(
            f"After {timeout_s:.0f} s the printer is not {' or '.join(sorted(states))} ({seen}). "
            f"The end of the log:\n{self.log_tail()}"
        )

    def log_text(self) -> str:
        """octoprint.log so far; what the process printed where there is none."""
        for name in ("logs/octoprint.log", "serve.log"):
            path = self.basedir / name
            if path.exists() and path.stat().st_size:
                return path.read_text(errors="replace")
        return ""

    def log_tail(self, lines: int = 15) -> str:
        return "\n".join(self.log_text().splitlines()[-lines:])

    # --- its folder ---------------------------------------------------------------------------------------------

    def _octoprint(self) -> list[str]:
        return [self._python, "-m", "octoprint", "--basedir", str(self.basedir)]

    def _config(self) -> dict[str, Any]:
        webcam: dict[str, Any] = {"_config_version": 1}  # without it the migration empties the section
        if self._snapshot_url:
            webcam.update(snapshot=self._snapshot_url, stream=self._snapshot_url.replace("=snapshot", "=stream"))
        config: dict[str, Any] = {
            "server": {
                "firstRun": False, "seenWizards": _WIZARDS,
                "onlineCheck": {"enabled": False}, "pluginBlocklist": {"enabled": False},
            },
            "serial": {"port": "VIRTUAL", "baudrate": 115200, "autoconnect": True},
            "webcam": {"timelapse": {"type": "off"}},
            "devel": {"enableRateLimiter": False},
            "plugins": {
                "_disabled": list(SILENT),
                "tracking": {"enabled": False},
                "classicwebcam": webcam,
                # The printer's default asks for resends now and then, which is another demonstration than ours.
                "virtual_printer": {"enabled": True, "simulated_errors": [], "sendWait": True},
            },
        }  # fmt: skip
        return _merged(config, self._settings)

    def _add_user(self) -> None:
        import yaml

        users_file = self.basedir / "users.yaml"
        users_file.unlink(missing_ok=True)
        command = [*self._octoprint(), "user", "add", self.user, "--password", self.password, "--admin"]
        done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, text=True)
        if done.returncode or not users_file.exists():
            raise ServerError(f"OctoPrint cannot be run with {self._python}: {(done.stderr or done.stdout)[-500:]}")
        users = yaml.safe_load(users_file.read_text())
        # `--admin` leaves the user out of the group of users, on which OctoPrint 2's page depends.
        users[self.user].update(apikey=self.api_key, groups=["users", "admins"])
        users_file.write_text(yaml.safe_dump(users))


def _merged(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """`over` laid over `base`, mapping by mapping."""
    merged = dict(base)
    for key, value in over.items():
        both = isinstance(value, Mapping) and isinstance(merged.get(key), Mapping)
        merged[key] = _merged(merged[key], value) if both else value
    return merged
