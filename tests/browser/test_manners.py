"""How the page behaves towards those who use it: by keyboard alone, on a telephone, over a wire that breaks, unseen."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Callable

import pytest

from octoprint_moop.demo.server import DemoServer

from .stage import DARK, FAILED, ONE_COLUMN, WIDE, Canned, check, log_in, serious_violations, show_tab
from .wire import Wire

Open = Callable[[], Any]
TROUBLE = '<img src=x onerror="window.moopOwned=1">'
TELEPHONE = {"width": 400, "height": 900}


def past_prints(*jobs: str) -> list[dict[str, Any]]:
    """As `GET recordings` answers."""
    return [
        {"name": f"2026-11-0{n + 1}_10-00-00_job", "bytes": 4_000_000 * (n + 1), "job": job, "checks": 20, "keep": n == 0,
         "verdict": "failed", "mode": "detachment", "layer": 9, "ended": "cancelled"}
        for n, job in enumerate(jobs)
    ]  # fmt: skip


def open_past(page: Any) -> None:
    page.click("[data-test-id=moop-page-past]")
    page.wait_for_selector("[data-test-id=moop-recordings] tbody tr")


def open_setup(page: Any, step: str) -> None:
    page.click("[data-test-id=moop-page-setup]")
    page.click(f"[data-test-id=moop-step-{step}]")
    page.wait_for_timeout(300)
    page.wait_for_function("!ko.dataFor(document.getElementById('moop_setup')).busy()")


def too_wide(page: Any) -> list[str]:
    """What reaches out of the screen at its right."""
    return list(
        page.evaluate("""() => [...document.querySelectorAll('#tab_plugin_moop *')]
        .filter(element => element.getBoundingClientRect().right > innerWidth + 0.5 && element.checkVisibility()
                           && !element.closest('.moop-read, .moop-name'))
        .map(element => element.outerHTML.slice(0, 120))""")
    )


# --- keyboard and screen reader ---------------------------------------------------------------------------------------


def test_everything_in_the_tab_is_reached_by_keyboard_and_seen_when_it_is(canned: Canned, open_tab: Open) -> None:
    canned.print_of(check(8), FAILED)
    page = open_tab()
    page.wait_for_selector("[data-test-id=moop-pardon]")
    page.wait_for_function("ko.dataFor(document.getElementById('moop_watch')).view.hasMasks()")
    page.focus("[data-test-id=moop-page-watch]")
    reached = set()
    for _ in range(40):
        page.keyboard.press("Tab")
        name, seen = page.evaluate("""() => {
            const style = getComputedStyle(document.activeElement);
            const seen = style.outlineStyle !== 'none' || style.boxShadow !== 'none' || style.borderStyle !== 'none';
            return [document.activeElement.dataset.testId || '', seen];
        }""")
        if name:
            reached.add(name)
            assert seen, f"nobody sees that {name} has the focus"
    there = page.evaluate("""() => [...document.querySelectorAll('#moop_watch button, #moop_watch canvas[tabindex]')]
        .filter(element => element.checkVisibility() && !element.disabled).map(element => element.dataset.testId)""")
    assert set(filter(None, there)) - reached == set()


def test_a_failure_is_settled_by_keyboard_alone(canned: Canned, open_tab: Open) -> None:
    canned.print_of(FAILED)
    page = open_tab()
    page.wait_for_selector("[data-test-id=moop-pardon]:not([disabled])")
    page.focus("[data-test-id=moop-pardon]")
    page.keyboard.press("Enter")
    page.wait_for_function("!ko.dataFor(document.getElementById('moop_watch')).busy()")
    assert canned.posts == [("pardon", {})]


def test_a_point_of_the_bed_is_placed_by_keyboard_alone(canned: Canned, open_tab: Open) -> None:
    page = open_tab()
    open_setup(page, "place")
    page.wait_for_function("ko.dataFor(document.getElementById('moop_setup')).picture.image")
    page.focus("#moop_setup_picture")
    for key in ("+", "+", "ArrowRight", "Enter"):
        page.keyboard.press(key)
    placed = page.evaluate("ko.dataFor(document.getElementById('moop_setup')).place.points()[0].px()")
    assert placed[0] > 160 and placed[1] == pytest.approx(120, abs=2)  # right of the middle of 320 x 240
    with page.expect_response("**/calibrate/guides"):
        page.evaluate("ko.dataFor(document.getElementById('moop_setup')).place.forget()")


def test_a_failure_is_announced_and_the_ticking_age_is_not(canned: Canned, open_tab: Open) -> None:
    canned.print_of(FAILED)
    page = open_tab()
    page.evaluate(
        "message => ko.dataFor(document.getElementById('moop_watch')).onDataUpdaterPluginMessage('moop', message)",
        {"type": "failed", "check": FAILED, "action": "pause"},
    )
    said = page.inner_text("#moop_watch [aria-live=assertive]")
    assert "Detached from the bed at layer 10" in said and "The print was paused." in said
    assert (
        page.evaluate("document.querySelector('[data-test-id=moop-state]').closest('[aria-live], [role=alert]')")
        is None
    )


# --- past prints ------------------------------------------------------------------------------------------------------


def test_the_slider_stands_at_the_check_that_is_shown(canned: Canned, open_tab: Open) -> None:
    canned.recordings = past_prints("a.gcode")
    canned.checks = [check(layer) for layer in range(5)]
    page = open_tab()
    open_past(page)
    page.click("[data-test-id=moop-past-open]")
    page.wait_for_selector("[data-test-id=moop-past-check]:has-text('Layer 5')")
    assert page.input_value("[data-test-id=moop-past-layer]") == "4"


# --- the set-up, in mid-print -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("printing", [False, True])
def test_what_is_kept_while_something_prints_is_said_to_hold_from_the_next_print_on(
    canned: Canned, open_tab: Open, printing: bool
) -> None:
    if printing:
        canned.print_of(check(3))
    page = open_tab()
    open_setup(page, "bed")
    page.click("[data-test-id=moop-bed-z]")
    page.click("[data-test-id=moop-keep-bed]")
    page.wait_for_selector("[data-test-id=moop-setup-saved]:has-text('How the bed moves is kept.')")
    assert ("from the next one on" in page.inner_text("[data-test-id=moop-setup-saved]")) == printing


# --- themes and screens -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("where", ["past", "setup"])
def test_under_a_dark_theme_axe_finds_nothing_serious(canned: Canned, open_tab: Open, axe: str, where: str) -> None:
    canned.recordings = past_prints("a.gcode", "b.gcode")
    canned.checks = [check(8), FAILED]
    page = open_tab()
    page.add_style_tag(content=DARK)
    if where == "past":
        open_past(page)
        page.locator("[data-test-id=moop-past-open]").first.click()
        page.wait_for_selector("[data-test-id=moop-past-check]:has-text('Layer')")
    else:
        open_setup(page, "place")
    page.wait_for_timeout(500)
    assert serious_violations(page, axe, "#tab_plugin_moop") == []


def test_past_prints_and_set_up_fit_a_telephone_whatever_the_names(canned: Canned, open_tab: Open) -> None:
    canned.recordings = past_prints("a_job_with_a_name_that_nobody_could_ever_print_on_one_line_" * 3 + ".gcode")
    canned.checks = [check(8), FAILED]
    page = open_tab()
    open_past(page)
    edge = page.evaluate("document.querySelector('#moop_past').getBoundingClientRect().right")
    delete = page.locator("[data-test-id=moop-past-delete]").bounding_box()
    assert delete["x"] + delete["width"] <= edge  # the last button of a row is not cut off on a wide screen either
    page.set_viewport_size(TELEPHONE)
    page.add_style_tag(content=ONE_COLUMN)
    page.click("[data-test-id=moop-past-open]")
    page.wait_for_selector("[data-test-id=moop-past-check]:has-text('Layer')")
    assert too_wide(page) == []
    page.click("[data-test-id=moop-past-close]")
    for step in ("camera", "bed", "lens", "place", "filament", "action", "trial"):
        open_setup(page, step)
        assert too_wide(page) == [], step


def test_nothing_jumps_when_another_picture_or_another_layer_is_shown(canned: Canned, open_tab: Open) -> None:
    canned.print_of(*(check(layer) for layer in range(12)))
    page = open_tab()
    page.wait_for_function("ko.dataFor(document.getElementById('moop_watch')).view.hasMasks()")
    where = "[...document.querySelectorAll('#moop_picture, #moop_plot, .moop-steps')].map(e => e.getBoundingClientRect().top)"
    for letters in ("0", "1.5px"):  # fonts are of different widths, and legends break into lines
        page.add_style_tag(content=f"#moop_watch {{ letter-spacing: {letters}; }}")
        page.wait_for_timeout(200)
        before = page.evaluate(where)
        for button in (
            "show-plain",
            "show-seen",
            "show-expected",
            "show-difference",
            "step-back",
            "step-back",
            "follow",
        ):
            page.click(f"[data-test-id=moop-{button}]")
            page.wait_for_timeout(80)
            assert page.evaluate(where) == before, (button, letters)


# --- markup in names --------------------------------------------------------------------------------------------------


def test_a_past_print_with_markup_in_its_name_is_shown_as_text_and_asked_about_as_text(
    canned: Canned, open_tab: Open
) -> None:
    canned.recordings = past_prints(TROUBLE)
    page = open_tab()
    open_past(page)
    assert TROUBLE in page.inner_text("[data-test-id=moop-recordings]")
    page.click("[data-test-id=moop-past-delete]")
    dialog = page.wait_for_selector(".modal:visible:has-text('Delete this recording?')")
    page.wait_for_timeout(300)
    assert TROUBLE in dialog.inner_text()
    assert page.evaluate("window.moopOwned") is None


# --- traffic ----------------------------------------------------------------------------------------------------------


def test_a_browser_tab_in_the_background_asks_for_nothing_and_catches_up_when_it_is_seen(
    canned: Canned, open_tab: Open
) -> None:
    canned.print_of(check(0))
    page = open_tab()
    page.wait_for_function("ko.dataFor(document.getElementById('moop_watch')).view.hasMasks()")
    hide = """hidden => {
        Object.defineProperty(document, 'hidden', {configurable: true, get: () => hidden});
        document.dispatchEvent(new Event('visibilitychange'));
    }"""
    page.evaluate(hide, True)
    canned.asked.clear()
    for layer in range(1, 4):
        page.evaluate(
            "message => ko.dataFor(document.getElementById('moop_watch')).onDataUpdaterPluginMessage('moop', message)",
            {"type": "check", "check": check(layer)},
        )
    page.wait_for_timeout(1200)
    asked = list(canned.asked)
    canned.print_of(*(check(layer) for layer in range(4)))
    page.evaluate(hide, False)
    page.wait_for_function("document.querySelector('[data-test-id=moop-selected]').innerText.startsWith('Layer 4 ')")
    page.evaluate("delete document.hidden")
    assert asked == []


def test_an_answer_that_was_long_on_its_way_does_not_undo_what_was_told_meanwhile(
    canned: Canned, open_tab: Open
) -> None:
    canned.print_of(*(check(layer) for layer in range(3)))
    page = open_tab()
    page.wait_for_function("ko.dataFor(document.getElementById('moop_watch')).view.checks().length === 3")
    on_their_way: list[tuple[Any, Any]] = []
    status, checks = dict(canned.status), {"checks": list(canned.checks)}
    page.route("**/plugin/moop/status", lambda route: on_their_way.append((route, status)), times=1)
    page.route("**/plugin/moop/checks", lambda route: on_their_way.append((route, checks)), times=1)
    page.evaluate("void ko.dataFor(document.getElementById('moop_watch')).refresh()")
    canned.print_of(*(check(layer) for layer in range(4)))
    page.evaluate(
        "messages => messages.forEach(message => "
        "ko.dataFor(document.getElementById('moop_watch')).onDataUpdaterPluginMessage('moop', message))",
        [{"type": "status", "status": canned.status}, {"type": "check", "check": check(3)}],
    )
    while len(on_their_way) < 2:
        page.wait_for_timeout(20)
    for route, answer in on_their_way:
        route.fulfill(json=answer)
    page.wait_for_function("$.active === 0")
    assert page.evaluate("ko.dataFor(document.getElementById('moop_watch')).status().checks") == 4
    assert page.evaluate("ko.dataFor(document.getElementById('moop_watch')).view.checks().length") == 4


# --- a wire that breaks -----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def wired(chromium: Any, server: DemoServer) -> Iterator[tuple[Any, Wire]]:
    """The tab as seen over a wire that can be cut."""
    with Wire(server.port) as wire:
        context = chromium.new_context(viewport=WIDE)
        page = context.new_page()
        log_in(page, wire.url, server.user, server.password)
        show_tab(page)
        page.wait_for_function("ko.dataFor(document.getElementById('moop_watch')).status()")
        yield page, wire
        context.close()


def test_a_lost_connection_is_told_and_what_was_missed_is_asked_for_when_it_is_back(wired: tuple[Any, Wire]) -> None:
    page, wire = wired
    wire.cut()
    page.wait_for_function(
        "document.querySelector('[data-test-id=moop-trouble]').innerText.includes('connection to the server is lost')",
        timeout=60_000,
    )
    with page.expect_response("**/plugin/moop/status", timeout=60_000):
        wire.mend()
    page.wait_for_function("!ko.dataFor(document.getElementById('moop_watch')).trouble()")


def test_a_moments_interruption_is_caught_up_on_too(wired: tuple[Any, Wire]) -> None:
    page, wire = wired
    with page.expect_response("**/plugin/moop/status", timeout=60_000):
        wire.cut()
        wire.mend()


def test_the_set_up_tells_why_the_webcam_gives_no_picture(page: Any) -> None:
    """As the server says it: there are other webcams than the classic one, and other reasons than its address."""
    page.expected_errors += ["/plugin/moop/frame"]
    why = "OctoPrint has no webcam named 'upstairs'. Choose one in the settings."
    page.route("**/plugin/moop/frame*", lambda route: route.fulfill(status=400, json={"code": "frame", "message": why}))
    show_tab(page)
    open_setup(page, "camera")
    page.wait_for_load_state("networkidle")  # nothing that comes later may wipe it away
    assert page.inner_text("[data-test-id=moop-setup-trouble]") == why
    open_setup(page, "camera")  # again, where one is already
    page.wait_for_load_state("networkidle")
    assert page.inner_text("[data-test-id=moop-setup-trouble]") == why
