"""Who may not do a thing sees no button for it, and is refused by the server all the same."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from octoprint_moop.demo.server import DemoServer

from .stage import Canned, check, log_in, show_tab

GUEST, PASSWORD = "onlooker", "only-looking"


@pytest.fixture(scope="module")
def onlooker(chromium: Any, server: DemoServer) -> Iterator[Any]:
    """The tab as a user sees it who may look at OctoPrint and nothing else."""
    user = {
        "name": GUEST,
        "password": PASSWORD,
        "active": True,
        "admin": False,
        "groups": ["readonly"],
        "permissions": [],
    }
    server.api("POST", "/api/access/users", json=user)
    context = chromium.new_context(viewport={"width": 1280, "height": 1000})
    page = context.new_page()
    log_in(page, server.url, GUEST, PASSWORD)
    show_tab(page)
    page.wait_for_selector("[data-test-id=moop-state-text]:visible")
    yield page
    context.close()
    server.api("DELETE", f"/api/access/users/{GUEST}")


@pytest.mark.parametrize("button", ["check-now", "watch-toggle", "pardon", "not-set-up"])
def test_an_onlooker_sees_the_state_and_no_buttons(onlooker: Any, button: str) -> None:
    onlooker.wait_for_function("ko.dataFor(document.getElementById('moop_watch')).status()")
    assert "No print is running" in onlooker.inner_text("[data-test-id=moop-state-text]")
    assert not onlooker.is_visible(f"[data-test-id=moop-{button}]")


def test_the_set_up_tells_an_onlooker_who_can_help(onlooker: Any) -> None:
    onlooker.click("[data-test-id=moop-page-setup]")
    onlooker.wait_for_selector("text=You do not have the permission to set MOOP up.")
    assert not onlooker.is_visible("[data-test-id=moop-step-camera]")


def test_an_onlooker_sees_a_past_print_and_why_it_cannot_be_looked_at_anew(onlooker: Any) -> None:
    canned = Canned(onlooker)
    canned.checks = [check(3)]
    canned.recordings = [
        {"name": "2026-11-01_10-00-00_job", "bytes": 10**6, "job": "a.gcode", "checks": 1, "verdict": "ok"}
    ]
    try:
        onlooker.click("[data-test-id=moop-page-past]")
        onlooker.click("[data-test-id=moop-past-open]")
        onlooker.wait_for_selector("[data-test-id=moop-past-no-trial]:visible")
        assert "who may control MOOP" in onlooker.inner_text("[data-test-id=moop-past-no-trial]")
        for name in ("replay", "use", "sliders", "progress"):
            assert not onlooker.is_visible(f"[data-test-id=moop-past-{name}]"), name
        assert onlooker.is_visible("[data-test-id=moop-past-close]")
        assert "a trial, below" not in onlooker.inner_text("#moop_past_opened")
    finally:
        onlooker.unroute_all(behavior="wait")


def test_who_may_not_even_look_is_told_so_on_every_page(chromium: Any, server: DemoServer) -> None:
    group = {
        "key": "bare",
        "name": "Bare",
        "description": "",
        "permissions": ["STATUS", "SETTINGS_READ"],
        "subgroups": [],
    }
    server.api("POST", "/api/access/groups", json=group)
    user = {"name": "stranger", "password": PASSWORD, "active": True, "admin": False, "groups": ["bare"]}
    server.api("POST", "/api/access/users", json={**user, "permissions": []})
    server.api("PUT", "/api/access/users/stranger", json={"groups": ["bare"], "active": True, "admin": False})
    context = chromium.new_context()
    try:
        page = context.new_page()
        log_in(page, server.url, "stranger", PASSWORD)
        show_tab(page)
        for name in ("watch", "past", "setup"):
            page.click(f"[data-test-id=moop-page-{name}]")
            page.wait_for_selector("text=You do not have the permission to >> visible=true")
            assert not page.is_visible("[data-test-id=moop-past-asking]")
            assert not page.is_visible("[data-test-id=moop-state-text]")
    finally:
        context.close()
        server.api("DELETE", "/api/access/users/stranger")
        server.api("DELETE", "/api/access/groups/bare")


@pytest.mark.parametrize(
    "call",
    [
        "checkNow()",
        "watch(false)",
        "pardon()",
        "saveSetup({})",
        "deleteRecording('x')",
        "keepRecording('x', true)",
        "replay('x', {})",
        "measureBedMotion({confirmed: true})",
        "useCalibration(1)",
        "revertCalibration()",
        "deleteCalibration(1)",
        "makeMarkers({})",
        "takePosePicture()",
        "takeBoardPicture({square_mm: 15})",
        "findLens({})",
    ],
)
def test_the_server_refuses_an_onlooker_whatever_the_page_shows(onlooker: Any, call: str) -> None:
    status = onlooker.evaluate(
        f"() => new Promise(done => OctoPrint.plugins.moop.{call}.done(() => done(200)).fail(request => done(request.status)))"
    )
    assert status == 403
