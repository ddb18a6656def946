"""A real OctoPrint server and a real Chromium; what the server would say of a print is canned where a test needs it so."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Callable

import pytest

from octoprint_moop.demo.server import DemoServer

from .stage import FLAGS, OCTOPRINT, WIDE, Canned, chromium_path, log_in, show_tab

# What a test may have left behind in the page: themes, dialogs, pop-ups, and what the tab was told.
PUT_BACK = """() => {
    document.querySelectorAll('body style, head style:not([data-kept])').forEach(style => style.remove());
    $('.modal.in').modal('hide');
    PNotify.removeAll();
    OctoPrint.socket.registeredHandlers.plugin = window.moopTold || OctoPrint.socket.registeredHandlers.plugin;
    const tab = ko.dataFor(document.getElementById('moop_watch'));
    $('#temp_link a').tab('show');
    tab.view.startOver();
    tab.view.show('difference');
    tab.view.hasMasks(false);
    tab.trouble('');
    tab.cameraKnown(null);
    tab.status(null);
    tab.view.checks([]);
    tab.view.picture.image = tab.view.picture.masks = null;
    const past = ko.dataFor(document.getElementById('moop_past'));
    past.opened.close();
    past.recordings([]);
    $('#moop_pages a[href="#moop_watch_page"]').tab('show');
}"""


@pytest.fixture(scope="session")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[DemoServer]:
    with DemoServer(tmp_path_factory.mktemp("octoprint"), octoprint_python=OCTOPRINT) as running:
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
def loaded_page(chromium: Any, server: DemoServer) -> Iterator[Any]:
    """OctoPrint's page with the administrator logged in, loaded once: a load takes longer than most tests."""
    page = chromium.new_context(viewport=WIDE).new_page()
    page.console_errors = []
    page.on(
        "console",
        lambda said: page.console_errors.append(f"{said.text} {said.location}") if said.type == "error" else None,
    )
    page.on("pageerror", lambda error: page.console_errors.append(str(error)))
    log_in(page, server.url, server.user, server.password)
    page.evaluate("document.querySelectorAll('style').forEach(style => style.dataset.kept = '1')")
    yield page
    page.context.close()


@pytest.fixture
def page(loaded_page: Any) -> Iterator[Any]:
    """The page as just loaded, at 1280 px. The test fails on whatever the console calls an error meanwhile."""
    loaded_page.expected_errors = []  # pieces of what a test provokes on purpose
    loaded_page.set_viewport_size(WIDE)
    yield loaded_page
    errors = list(loaded_page.console_errors)
    loaded_page.evaluate(PUT_BACK)
    loaded_page.unroute_all(behavior="wait")
    # what is on its way now the server itself answers: neither this test's errors, nor anything to the next test
    loaded_page.wait_for_function("$.active === 0")
    loaded_page.console_errors = []
    unexpected = [error for error in errors if not any(piece in error for piece in loaded_page.expected_errors)]
    assert not unexpected, "\n".join(unexpected)


@pytest.fixture
def canned(page: Any) -> Canned:
    return Canned(page)


@pytest.fixture
def open_tab(page: Any, canned: Canned) -> Callable[[], Any]:
    """Opens the MOOP tab of a page to which the printer seems to be in the state that `canned.printer` names."""

    def opened() -> Any:
        page.evaluate(
            """printer => {
                const state = ko.dataFor(document.getElementById('moop_watch')).printerState;
                state.fromCurrentData = () => {};
                state.isPrinting(printer === 'printing');
                state.isPaused(printer === 'paused');
                const told = OctoPrint.socket.registeredHandlers; // the real server's news are of another print
                window.moopTold = window.moopTold || told.plugin;
                told.plugin = [];
            }""",
            canned.printer,
        )
        show_tab(page)
        page.wait_for_selector("[data-test-id=moop-state-text]:visible")
        page.wait_for_function("ko.dataFor(document.getElementById('moop_watch')).status()")
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
