"""The whole road in a real browser: a real print is seen to fail, pauses, is resumed from the tab, and ends."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from octoprint_moop.demo.run import Demo

from .stage import OCTOPRINT, log_in, serious_violations, show_tab

FAULT_LAYER = 12


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Demo]:
    folder = tmp_path_factory.mktemp("demo")
    with Demo(folder, fault="detachment", fault_layer=FAULT_LAYER, octoprint_python=OCTOPRINT) as running:
        yield running


@pytest.fixture(scope="module")
def tab(chromium: Any, demo: Demo) -> Iterator[Any]:
    context = chromium.new_context(viewport={"width": 1280, "height": 1400})
    page = context.new_page()
    errors: list[str] = []
    page.on("console", lambda message: errors.append(message.text) if message.type == "error" else None)
    page.on("pageerror", lambda error: errors.append(str(error)))
    log_in(page, demo.server.url, demo.server.user, demo.server.password)
    show_tab(page)
    yield page
    context.close()
    assert errors == []


def wait_for_text(page: Any, name: str, piece: str, timeout_s: float) -> None:
    page.wait_for_selector(f"[data-test-id=moop-{name}]:has-text('{piece}')", timeout=1000 * timeout_s)


def wait_for_checks(page: Any, demo: Demo, more: int) -> None:
    """Returns when so many further checks were made, and fails when the print is stopped meanwhile."""
    before = demo.server.api("GET", "/plugin/moop/status")["checks"]
    for _ in range(240):
        status = demo.server.api("GET", "/plugin/moop/status")
        assert demo.server.job_state() == "Printing", status["reason"]
        if status["checks"] >= before + more:
            assert status["watching"] and status["action"] == "none", status["blind"]
            return
        page.wait_for_timeout(250)
    raise AssertionError(f"after a minute {status['checks'] - before} of {more} checks were made: {status['blind']}")


def test_a_print_that_comes_loose_is_seen_told_and_goes_on_watched_when_the_user_says_so(tab: Any, demo: Demo) -> None:
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
    for where in (".ui-pnotify", "[data-test-id=moop-failure]"):
        tab.wait_for_selector(f"{where} figure:has-text('Difference') canvas")
        assert tab.locator(f"{where} figure").all_inner_texts() == ["Seen", "Expected", "Difference"]
    assert tab.is_visible(".moop-legend:has-text('missing')")
    assert len(tab.evaluate("ko.dataFor(document.getElementById('moop_watch')).view.checks()")) == status["checks"]
    classes = tab.evaluate(
        "MOOP.overlay.counts(ko.dataFor(document.getElementById('moop_watch')).view.picture.classes)"
    )
    assert classes["missing"] + classes["extra"] > 500  # the picture shows the trouble, not only the words

    tab.click("[data-test-id=moop-pardon]")
    tab.wait_for_selector("[data-test-id=moop-failure]", state="detached")
    tab.wait_for_selector(".ui-pnotify:has-text('MOOP')", state="detached")  # what was pardoned is no longer announced
    tab.click("[data-test-id=moop-resume-pardoned]")
    demo.server.wait_state({"Printing"}, 30)
    wait_for_checks(tab, demo, 6)  # what has come loose still lies there
    wait_for_text(tab, "state-text", "Watching · layer", 10)


def test_octoprints_own_resume_accepts_what_was_found_and_what_is_new_is_found_again(tab: Any, demo: Demo) -> None:
    demo.set_off("detachment", 0)  # the other object, this time
    wait_for_text(tab, "state-text", "Print paused", 90)
    demo.server.wait_state({"Paused"}, 30)
    tab.click("#job_pause")
    demo.server.wait_state({"Printing"}, 30)
    wait_for_checks(tab, demo, 3)
    assert not tab.is_visible("[data-test-id=moop-failure]")
    tab.wait_for_selector(".ui-pnotify:has-text('MOOP')", state="detached")
    demo.server.api("POST", "/api/job", json={"command": "cancel"})
    demo.server.wait_state({"Operational"}, 60)
    wait_for_text(tab, "state-text", "No print is running", 30)
    assert len(demo.server.api("GET", "/plugin/moop/recordings")["recordings"]) == 1


def test_a_past_print_is_listed_with_its_picture_and_its_end(tab: Any, demo: Demo) -> None:
    tab.click("[data-test-id=moop-page-past]")
    tab.wait_for_selector("[data-test-id=moop-recordings] tbody tr")
    listed = tab.inner_text("[data-test-id=moop-recordings]")
    assert "tug-and-bracket" in listed and " at layer " in listed
    tab.wait_for_function("document.querySelector('.moop-thumbnail img').naturalWidth === 192")
    assert "of the 1000 MB" in tab.inner_text("[data-test-id=moop-past-room]")


def test_a_past_print_that_is_kept_says_so_here_and_on_the_server(tab: Any, demo: Demo) -> None:
    for keep in (True, False):
        tab.click("[data-test-id=moop-past-keep]")
        tab.wait_for_selector(f"[data-test-id=moop-past-keep][aria-pressed={str(keep).lower()}]")
        assert demo.server.api("GET", "/plugin/moop/recordings")["recordings"][0]["keep"] is keep


def test_a_past_print_is_downloaded_with_its_pictures_or_without(tab: Any, tmp_path: Path) -> None:
    names = []
    for button in ("download", "download-bare"):
        with tab.expect_download() as download:
            tab.click(f"[data-test-id=moop-past-{button}]")
        download.value.save_as(tmp_path / "one.zip")
        with zipfile.ZipFile(tmp_path / "one.zip") as packed:
            names.append({Path(name).suffix for name in packed.namelist()})
    assert ".jpg" in names[0] and ".jpg" not in names[1] and names[0] - {".jpg"} == names[1]


def test_the_past_print_can_be_opened_and_tried_with_other_settings(tab: Any, demo: Demo) -> None:
    tab.click("[data-test-id=moop-past-open]")
    tab.wait_for_selector("[data-test-id=moop-past-check]:has-text('Layer')")
    tab.select_option("[data-test-id=moop-past-sensitivity]", "low")
    tab.click("[data-test-id=moop-past-replay]")
    tab.wait_for_selector("[data-test-id=moop-past-progress]:has-text('Picture ')")
    tab.wait_for_selector("[data-test-id=moop-past-outcome]:has-text('With these settings')", timeout=120_000)
    told = tab.inner_text("[data-test-id=moop-past-outcome]")
    assert "During the print: a failure at layer" in told
    tab.wait_for_function("ko.dataFor(document.getElementById('moop_past')).opened.view.hasMasks()")
    before = tab.evaluate("ko.dataFor(document.getElementById('moop_past')).opened.run")
    tab.select_option("[data-test-id=moop-past-sensitivity]", "high")  # tried without another click
    tab.wait_for_function(
        f"ko.dataFor(document.getElementById('moop_past')).opened.run === {before + 1}", timeout=60_000
    )
    tab.select_option("[data-test-id=moop-past-sensitivity]", "low")
    tab.wait_for_function(
        f"ko.dataFor(document.getElementById('moop_past')).opened.run === {before + 2}", timeout=60_000
    )
    classes = tab.evaluate(
        "MOOP.overlay.counts(ko.dataFor(document.getElementById('moop_past')).opened.view.picture.classes)"
    )
    assert classes["matched"] > 0
    with tab.expect_response(lambda answer: answer.url.endswith("/api/settings") and answer.request.method == "POST"):
        tab.click("[data-test-id=moop-past-use]")
    assert demo.server.api("GET", "/api/settings")["plugins"]["moop"]["sensitivity"] == "low"


def test_axe_finds_nothing_serious_in_past_prints(tab: Any, axe: str) -> None:
    assert serious_violations(tab, axe, "#tab_plugin_moop") == []


def test_a_past_print_is_deleted_only_after_a_question(tab: Any, demo: Demo) -> None:
    tab.click("[data-test-id=moop-past-delete]")
    dialog = tab.wait_for_selector(".modal:visible:has-text('Delete this recording?')")
    assert len(demo.server.api("GET", "/plugin/moop/recordings")["recordings"]) == 1
    dialog.query_selector(".btn-danger").click()
    tab.wait_for_selector("text=Nothing is recorded yet.")
    assert demo.server.api("GET", "/plugin/moop/recordings")["recordings"] == []
