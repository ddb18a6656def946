"""A real OctoPrint server and a real Chromium; what the server would say of a print is canned where a test needs it so."""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from typing import Any, Callable, Iterator

import pytest

from octoprint_moop.demo.server import DemoServer

from .stage import FLAGS, Canned, chromium_path, log_in, wait_for_page


@pytest.fixture(scope="session")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[DemoServer]:
    python = os.environ.get("MOOP_OCTOPRINT_PYTHON")
    options = {"octoprint_python": python} if python else {}
    with DemoServer(tmp_path_factory.mktemp("octoprint"), **options) as running:
        yield running


@pytest.fixture(scope="session")
def chromium() -> Iterator[Any]:
    sync_api = pytest.importorskip("playwright.sync_api")
    found = chromium_path()
    if found is None:
        pytest.skip("no Chromium is installed here")
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=found, args=FLAGS)
        yield browser
        browser.close()


@pytest.fixture(scope="session")
def session(chromium: Any, server: DemoServer) -> Any:
    """Cookies of the logged-in administrator."""
    context = chromium.new_context()
    page = context.new_page()
    log_in(page, server.url, server.user, server.password)
    state = context.storage_state()
    context.close()
    return state


@pytest.fixture
def page(chromium: Any, server: DemoServer, session: Any) -> Iterator[Any]:
    """A page of 1280 px that nobody has opened yet. The test fails on whatever the console calls an error."""
    context = chromium.new_context(storage_state=session, viewport={"width": 1280, "height": 1400})
    page = context.new_page()
    errors: list[str] = []
    page.on("console", lambda message: errors.append(message.text) if message.type == "error" else None)
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.expected_errors = []  # pieces of what a test provokes on purpose
    yield page
    context.close()
    unexpected = [error for error in errors if not any(piece in error for piece in page.expected_errors)]
    assert not unexpected, "\n".join(unexpected)


@pytest.fixture
def canned(page: Any) -> Canned:
    return Canned(page)


@pytest.fixture
def open_tab(page: Any, server: DemoServer, canned: Canned) -> Callable[[], Any]:
    """Opens the MOOP tab of a page to which the printer seems to be in the state that `canned.printer` names."""

    def opened() -> Any:
        page.goto(server.url + "/?l10n=en")
        wait_for_page(page)
        page.evaluate(
            """printer => {
                const state = ko.dataFor(document.getElementById('moop_watch')).printerState;
                state.fromCurrentData = () => {};
                state.isPrinting(printer === 'printing');
                state.isPaused(printer === 'paused');
            }""",
            canned.printer,
        )
        page.click("#tab_plugin_moop_link a")
        page.wait_for_selector("[data-test-id=moop-state-text]:visible")
        return page

    return opened


@pytest.fixture(scope="session")
def axe(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The source of axe-core, fetched by npm. Skips where that is not to be had."""
    import subprocess

    npm = shutil.which("npm")
    if npm is None:
        pytest.skip("npm is not installed here, so axe-core cannot be fetched")
    folder = tmp_path_factory.mktemp("axe")
    command = [npm, "install", "--no-audit", "--no-fund", "--ignore-scripts", "--prefix", str(folder), "axe-core@4"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    except subprocess.TimeoutExpired:
        pytest.skip("npm does not get axe-core within a minute")
    source = Path(folder) / "node_modules/axe-core/axe.min.js"
    if done.returncode or not source.exists():
        pytest.skip(f"npm cannot fetch axe-core: {done.stderr[-200:]}")
    return source.read_text()
