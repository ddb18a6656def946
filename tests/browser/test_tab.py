"""The MOOP tab in a real browser. The server is real; what it says of the print is canned, so that each state can be seen."""

from __future__ import annotations

from typing import Any, Callable

import pytest

from .stage import DARK, FAILED, ONE_COLUMN, Canned, check, serious_violations

Open = Callable[[], Any]
TROUBLE = '<img src=x onerror="window.moopOwned=1">'


def text(page: Any, name: str) -> str:
    return str(page.inner_text(f"[data-test-id=moop-{name}]"))


def view_model(page: Any, expression: str) -> Any:
    return page.evaluate(f"ko.dataFor(document.getElementById('moop_watch')).{expression}")


def push(page: Any, message: dict[str, Any]) -> None:
    """As if the server had sent it over the socket."""
    page.evaluate(
        "message => ko.dataFor(document.getElementById('moop_watch')).onDataUpdaterPluginMessage('moop', message)",
        message,
    )


def picture(page: Any) -> Any:
    """The canvas's pixels, once the pictures are there."""
    page.wait_for_function("ko.dataFor(document.getElementById('moop_watch')).view.hasMasks()")
    return page.evaluate("document.getElementById('moop_picture').toDataURL()")


def test_a_print_that_goes_well_is_told_in_one_line(canned: Canned, open_tab: Open) -> None:
    canned.print_of(check(39), check(40))
    page = open_tab()
    page.wait_for_function("document.querySelector('[data-test-id=moop-state-text]').innerText.includes('all well')")
    assert text(page, "state-text").startswith("Watching · layer 41 of 120 · last check 1")
    assert not page.is_visible("[data-test-id=moop-failure]")


def test_the_age_of_the_last_check_grows_without_asking_the_server(canned: Canned, open_tab: Open) -> None:
    canned.print_of(check(0))
    page = open_tab()
    page.wait_for_function("document.querySelector('[data-test-id=moop-state-text]').innerText.includes('14 s ago')")
    assert canned.asked.count("status") <= 2  # at start-up and when the tab was opened


def test_a_failure_says_what_where_since_when_and_what_was_done(canned: Canned, open_tab: Open) -> None:
    canned.print_of(check(6), check(7, "suspect", 0.1), check(8, "suspect", 0.1), FAILED)
    page = open_tab()
    page.wait_for_selector("[data-test-id=moop-failure]")
    told = text(page, "failure")
    for piece in ("Detached from the bed at layer 10", "no longer stands where it was printed", "object: right",
                  "since layer 8", "E is 12 %, the limit 3.0 %", "The print was paused."):  # fmt: skip
        assert piece in told
    assert "failed" in canned.checks[-1]["verdict"] and "Detached" in text(page, "objects")


def test_a_pardoned_failure_is_no_longer_told(canned: Canned, open_tab: Open) -> None:
    canned.print_of(FAILED, action="none", reason="")
    page = open_tab()
    picture(page)
    assert not page.is_visible("[data-test-id=moop-failure]")


def test_a_failure_that_was_only_told_of_stands_while_the_print_goes_on(canned: Canned, open_tab: Open) -> None:
    canned.print_of(FAILED, check(10), action="notify", reason=FAILED["reason"])
    page = open_tab()
    page.wait_for_selector("[data-test-id=moop-failure]:has-text('the print goes on')")
    assert text(page, "state-text").startswith("Watching · layer 11")


def test_a_print_that_is_not_recorded_any_more_says_so_beside_how_it_goes(canned: Canned, open_tab: Open) -> None:
    why = (
        "This print is not recorded any more: the disk is almost full. Make room, and the next print is recorded again."
    )
    canned.print_of(check(8), not_recorded=why)
    page = open_tab()
    assert page.inner_text("[data-test-id=moop-not-recorded]") == why
    assert "Watching · layer 9" in page.inner_text("[data-test-id=moop-state-text]")
    canned.status.update(not_recorded="")
    push(page, {"type": "status", "status": canned.status})
    page.wait_for_selector("[data-test-id=moop-not-recorded]", state="detached")


def test_the_next_print_begins_with_an_empty_plot(canned: Canned, open_tab: Open) -> None:
    canned.print_of(*(check(layer) for layer in range(9)))
    page = open_tab()
    picture(page)
    push(page, {"type": "check", "check": check(0, file_pos=10)})
    page.wait_for_function("ko.dataFor(document.getElementById('moop_watch')).view.checks().length === 1")
    assert text(page, "selected").startswith("Layer 1 ")


def test_a_pushed_failure_stays_on_screen_with_its_pictures_until_it_is_settled(canned: Canned, open_tab: Open) -> None:
    canned.print_of(check(8), FAILED)
    page = open_tab()
    push(page, {"type": "failed", "check": FAILED, "action": "pause"})
    notice = page.wait_for_selector(".ui-pnotify:has-text('Detached from the bed at layer 10')")
    assert "The print was paused." in notice.inner_text()
    page.wait_for_selector(".ui-pnotify figure:has-text('Difference') canvas")
    assert page.evaluate("PNotify.notices[PNotify.notices.length - 1].options.hide") is False
    canned.status.update(action="none", reason="")  # resumed, from wherever
    push(page, {"type": "status", "status": canned.status})
    page.wait_for_selector(".ui-pnotify", state="detached")


def test_a_failure_that_was_settled_before_it_was_told_is_not_announced(canned: Canned, open_tab: Open) -> None:
    canned.print_of(check(8), FAILED, action="none", reason="")
    page = open_tab()
    push(page, {"type": "failed", "check": FAILED, "action": "pause"})
    page.wait_for_timeout(300)
    assert not page.is_visible(".ui-pnotify")


def test_seen_expected_difference_and_plain_are_four_pictures(canned: Canned, open_tab: Open) -> None:
    canned.print_of(FAILED)
    page = open_tab()
    pictures = set()
    for show in ("plain", "seen", "expected", "difference"):
        picture(page)
        page.click(f"[data-test-id=moop-show-{show}]")
        pictures.add(picture(page))
        assert page.get_attribute(f"[data-test-id=moop-show-{show}]", "aria-pressed") == "true"
    assert len(pictures) == 4


def test_the_difference_is_legible_without_colour(canned: Canned, open_tab: Open) -> None:
    canned.print_of(FAILED)
    page = open_tab()
    picture(page)
    # brightness along a line through the missing block: stripes go up and down, a plain tint would not
    changes = page.evaluate("""() => {
        const canvas = document.getElementById('moop_picture');
        const scale = canvas.width / 320;
        const row = canvas.getContext('2d').getImageData(204 * scale, 120 * scale, 52 * scale, 1).data;
        const light = Array.from({length: row.length / 4}, (_, i) => row[4 * i] + row[4 * i + 1] + row[4 * i + 2]);
        const middle = (Math.max(...light) + Math.min(...light)) / 2;
        return light.filter((v, i) => i && (v > middle) !== (light[i - 1] > middle)).length;
    }""")
    assert changes >= 8
    assert "missing (stripes)" in page.inner_text("#moop_watch")


def test_a_click_on_the_plot_opens_that_layers_picture(canned: Canned, open_tab: Open) -> None:
    canned.print_of(*(check(layer) for layer in range(20)))
    page = open_tab()
    picture(page)
    place = view_model(page, "view.plot.pointOffset({x: 5, y: 0.4})")
    with page.expect_request("**/checks/4/frame.jpg"):
        page.click("[data-test-id=moop-plot]", position={"x": place["left"], "y": place["top"]})
    page.wait_for_function("document.querySelector('[data-test-id=moop-selected]').innerText.startsWith('Layer 5 ')")
    page.click("[data-test-id=moop-follow]")
    assert text(page, "selected").startswith("Layer 20 ")


def test_show_where_zooms_to_what_is_wrong(canned: Canned, open_tab: Open) -> None:
    canned.print_of(FAILED)
    page = open_tab()
    before = picture(page)
    page.click("text=Show where")
    assert view_model(page, "view.picture.zoom") > 1.25
    part = view_model(page, "view.picture.part()")
    assert part["x"] < 230 < part["x"] + part["width"] and part["y"] < 120 < part["y"] + part["height"]
    assert picture(page) != before


def test_the_picture_can_be_zoomed_by_keyboard(canned: Canned, open_tab: Open) -> None:
    canned.print_of(check(3))
    page = open_tab()
    picture(page)
    page.focus("#moop_picture")
    page.keyboard.press("+")
    page.keyboard.press("+")
    page.keyboard.press("ArrowRight")
    assert view_model(page, "view.picture.zoom") > 2
    page.keyboard.press("0")
    assert view_model(page, "view.picture.zoom") == 1


def test_the_buttons_ask_the_server_for_what_they_say(canned: Canned, open_tab: Open) -> None:
    canned.print_of(FAILED)
    page = open_tab()
    for button in ("check-now", "watch-toggle", "pardon"):
        page.wait_for_selector(f"[data-test-id=moop-{button}]:not([disabled])")
        page.click(f"[data-test-id=moop-{button}]")
    page.wait_for_function("!ko.dataFor(document.getElementById('moop_watch')).busy()")
    assert canned.posts == [("check", {}), ("watch", {"watching": False}), ("pardon", {})]


def test_names_and_reasons_are_shown_as_text_and_never_run(canned: Canned, open_tab: Open) -> None:
    nasty = {
        **FAILED,
        "reason": TROUBLE,
        "objects": [{"name": TROUBLE, "E": 0.1, "verdict": "failed", "mode": "warping"}],
    }
    canned.print_of(nasty, action="notify", job=TROUBLE)
    page = open_tab()
    push(page, {"type": "failed", "check": nasty, "action": "notify"})
    page.wait_for_selector(".ui-pnotify")
    page.wait_for_timeout(300)
    assert "<img src=x" in text(page, "failure") and "<img src=x" in text(page, "objects")
    assert "<img src=x" in page.inner_text(".ui-pnotify")
    assert page.evaluate("window.moopOwned") is None


def test_a_hidden_tab_asks_for_no_pictures(canned: Canned, open_tab: Open) -> None:
    canned.print_of(check(0))
    page = open_tab()
    picture(page)
    page.click("#temp_link a")
    page.wait_for_timeout(300)
    page.wait_for_function("$.active === 0")
    canned.asked.clear()
    for layer in range(1, 6):
        push(page, {"type": "check", "check": check(layer)})
    page.wait_for_timeout(1500)
    assert canned.asked == []


def test_a_lost_connection_is_told_and_what_was_missed_is_fetched_afterwards(canned: Canned, open_tab: Open) -> None:
    canned.print_of(check(0))
    page = open_tab()
    view_model(page, "onServerDisconnect()")
    assert "connection to the server is lost" in text(page, "trouble")
    canned.print_of(check(0), check(1))
    view_model(page, "onServerReconnect()")
    page.wait_for_function("document.querySelector('[data-test-id=moop-state-text]').innerText.includes('layer 2 of')")
    assert not page.is_visible("[data-test-id=moop-trouble]")


def test_a_refused_request_is_told_in_the_servers_words(canned: Canned, open_tab: Open) -> None:
    canned.print_of(check(0))
    page = open_tab()
    page.expected_errors.append("409")
    page.route(
        "**/plugin/moop/check", lambda route: route.fulfill(status=409, json={"code": "frame", "message": "Too dark."})
    )
    page.wait_for_selector("[data-test-id=moop-check-now]:not([disabled])")
    page.click("[data-test-id=moop-check-now]")
    page.wait_for_selector("[data-test-id=moop-trouble]:has-text('Too dark.')")


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_axe_finds_nothing_serious_in_the_tab(canned: Canned, open_tab: Open, axe: str, theme: str) -> None:
    canned.print_of(check(8), FAILED, not_recorded="This print is not recorded: the disk is almost full.")
    page = open_tab()
    picture(page)
    if theme == "dark":
        page.add_style_tag(content=DARK)
    page.wait_for_timeout(500)  # buttons fade from one colour to another
    assert serious_violations(page, axe, "#tab_plugin_moop") == []


def test_the_tab_fits_a_telephone(canned: Canned, open_tab: Open) -> None:
    long = "a_part_with_a_name_that_nobody_could_ever_print_on_one_line_" * 3
    canned.print_of({**FAILED, "reason": long, "objects": [{"name": long, "E": 0.1, "verdict": "ok", "mode": None}]})
    page = open_tab()
    page.set_viewport_size({"width": 400, "height": 900})
    page.add_style_tag(content=ONE_COLUMN)
    picture(page)
    page.wait_for_timeout(400)
    wide = page.evaluate("""() => [...document.querySelectorAll('#tab_plugin_moop *')]
        .filter(element => element.getBoundingClientRect().right > 400.5 && !element.closest('.moop-read, .moop-name'))
        .map(element => element.outerHTML.slice(0, 120))""")
    assert wide == []
