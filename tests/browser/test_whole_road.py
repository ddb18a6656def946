"""The whole road in a real browser: a real print is seen to fail, pauses, is resumed from the tab, and ends."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from octoprint_moop.demo.run import Demo

from .stage import OCTOPRINT, log_in, serious_violations

FAULT_LAYER = 12


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Demo]:
    folder = tmp_path_factory.mktemp("demo")
    with Demo(folder, fault="detachment", fault_layer=FAULT_LAYER, octoprint_python=OCTOPRINT) as running:
        yield running


@pytest.fixture
def tab(chromium: Any, demo: Demo) -> Iterator[Any]:
    context = chromium.new_context(viewport={"width": 1280, "height": 1400})
    page = context.new_page()
    errors: list[str] = []
    page.on("console", lambda message: errors.append(message.text) if message.type == "error" else None)
    page.on("pageerror", lambda error: errors.append(str(error)))
    log_in(page, demo.server.url, demo.server.user, demo.server.password)
    page.click("#tab_plugin_moop_link a")
    yield page
    context.close()
    assert errors == []


def wait_for_text(page: Any, name: str, piece: str, timeout_s: float) -> None:
    page.wait_for_selector(f"[data-test-id=moop-{name}]:has-text('{piece}')", timeout=1000 * timeout_s)


def test_a_print_that_comes_loose_is_seen_told_resumed_and_ends(tab: Any, demo: Demo, tmp_path: Path) -> None:
    demo.print_job()
    wait_for_text(tab, "state-text", "Watching", 60)
    wait_for_text(tab, "state-text", "all well", 30)

    wait_for_text(tab, "state-text", "Print paused", 90)
    status = demo.server.api("GET", "/plugin/moop/status")
    demo.server.wait_state({"Paused"}, 30)
    assert FAULT_LAYER <= status["last_check"]["layer"] <= FAULT_LAYER + 3
    assert tab.inner_text("[data-test-id=moop-failure-sentence]") == status["reason"]
    assert tab.inner_text("[data-test-id=moop-failure-done]") == "The print was paused."
    assert tab.is_visible(".ui-pnotify:has-text('The print was paused.')")
    assert tab.is_visible(".moop-legend:has-text('missing')")
    assert len(tab.evaluate("ko.dataFor(document.getElementById('moop_watch')).checks()")) == status["checks"]
    classes = tab.evaluate("MOOP.overlay.counts(ko.dataFor(document.getElementById('moop_watch')).picture.classes)")
    assert classes["missing"] + classes["extra"] > 500  # the picture shows the trouble, not only the words

    tab.evaluate("PNotify.removeAll()")
    tab.click("[data-test-id=moop-pardon]")
    tab.wait_for_selector("[data-test-id=moop-failure]", state="detached")
    tab.click("[data-test-id=moop-watch-toggle]")  # what has come loose will not get better
    wait_for_text(tab, "state-text", "switched off for this print", 10)
    tab.click("#job_pause")
    demo.server.wait_state({"Operational"}, 120)
    wait_for_text(tab, "state-text", "No print is running", 30)
    recordings = demo.server.api("GET", "/plugin/moop/recordings")["recordings"]
    assert len(recordings) == 1


def test_the_past_print_can_be_opened_and_tried_with_other_settings(tab: Any, demo: Demo) -> None:
    tab.click("[data-test-id=moop-page-past]")
    tab.wait_for_selector("[data-test-id=moop-recordings] tbody tr")
    listed = tab.inner_text("[data-test-id=moop-recordings]")
    assert "tug-and-bracket" in listed and " at layer " in listed
    tab.click("[data-test-id=moop-past-open]")
    tab.wait_for_selector("[data-test-id=moop-past-check]:has-text('Layer')")
    tab.select_option("[data-test-id=moop-past-sensitivity]", "low")
    tab.click("[data-test-id=moop-past-replay]")
    tab.wait_for_selector("[data-test-id=moop-past-outcome]:has-text('With these settings')", timeout=120_000)
    told = tab.inner_text("[data-test-id=moop-past-outcome]")
    assert "During the print: a failure at layer" in told
    tab.wait_for_function("ko.dataFor(document.getElementById('moop_past')).hasMasks()")
    assert tab.evaluate("ko.dataFor(document.getElementById('moop_past')).picture.classes.some(value => value === 1)")
    with tab.expect_response(lambda answer: answer.url.endswith("/api/settings") and answer.request.method == "POST"):
        tab.click("[data-test-id=moop-past-use]")
    assert demo.server.api("GET", "/api/settings")["plugins"]["moop"]["sensitivity"] == "low"


def test_axe_finds_nothing_serious_in_past_prints(tab: Any, axe: str) -> None:
    tab.click("[data-test-id=moop-page-past]")
    tab.click("[data-test-id=moop-past-open]")
    tab.wait_for_selector("[data-test-id=moop-past-check]:has-text('Layer')")
    assert serious_violations(tab, axe, "#tab_plugin_moop") == []


def test_a_past_print_is_deleted_only_after_a_question(tab: Any, demo: Demo) -> None:
    tab.click("[data-test-id=moop-page-past]")
    tab.click("[data-test-id=moop-past-delete]")
    dialog = tab.wait_for_selector(".modal:visible:has-text('Delete this recording?')")
    assert len(demo.server.api("GET", "/plugin/moop/recordings")["recordings"]) == 1
    dialog.query_selector(".btn-danger").click()
    tab.wait_for_selector("text=Nothing is recorded yet.")
    assert demo.server.api("GET", "/plugin/moop/recordings")["recordings"] == []
