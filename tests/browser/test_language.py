"""The page in another language than English, on a real server."""

from __future__ import annotations

from typing import Any

import pytest

from octoprint_moop.demo.server import DemoServer

from .stage import FAILED, WIDE, Canned, check, show_tab, wait_for_page


@pytest.fixture
def german(chromium: Any, server: DemoServer) -> Any:
    """The page as a browser gets it whose user reads German first; nothing else asks for a language."""
    page = chromium.new_context(viewport=WIDE, locale="de-DE").new_page()
    page.goto(server.url)
    page.wait_for_function("window.OctoPrint && OctoPrint.loginui && OctoPrint.loginui.startedUp", timeout=60_000)
    page.fill("#login-user", server.user)
    page.fill("#login-password", server.password)
    page.click("#login-button")
    wait_for_page(page)
    yield page
    page.context.close()


def test_who_reads_german_is_told_of_a_failure_in_german(german: Any) -> None:
    canned = Canned(german)
    lost = {
        **FAILED,
        "reason": "right: The print has come off: it lies about 6 mm to the left and the back from its place.",
    }
    canned.print_of(check(8), lost, action="pause", reason=lost["reason"])
    german.evaluate(
        """() => {
            const state = ko.dataFor(document.getElementById('moop_watch')).printerState;
            state.fromCurrentData = () => {};
            state.isPaused(true);
        }"""
    )
    show_tab(german)
    german.wait_for_selector("[data-test-id=moop-failure-sentence]:visible")
    tab = german.inner_text("#tab_plugin_moop")
    for words in (
        "Überwachen", "Frühere Drucke", "Einrichten",  # the template
        "Druck angehalten", "Vom Bett gelöst bei Schicht 10",  # the page's own sentences
        "right: Der Druck hat sich gelöst: Er liegt etwa 6 mm nach links und hinten neben seinem Platz.",  # the server's
        "Kein Fehldruck", "Druck fortsetzen",
    ):  # fmt: skip
        assert words in tab, f"{words!r} is not in: {tab}"
    german.click("#navbar_show_settings")
    german.click("#settings_plugin_moop_link a")
    german.wait_for_selector("#settings_plugin_moop legend:visible")
    settings = german.inner_text("#settings_plugin_moop")
    assert "Wenn ein Druck fehlgeschlagen ist" in settings  # a label
    assert "Was weniger gesättigt ist, ist kein Filament." in settings  # a sentence of core/settings.py
    assert "0 bis 360 °; Vorgabe ist 360." in settings  # with values
