"""MOOP's page in OctoPrint's settings, against a real server and its real settings."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Callable

import pytest

from octoprint_moop.core.settings import DEFAULTS
from octoprint_moop.demo.server import DemoServer

from .stage import DARK, Canned, serious_violations


@pytest.fixture
def settings_page(page: Any, canned: Canned, server: DemoServer) -> Iterator[Callable[[], Any]]:
    def opened() -> Any:
        page.click("#navbar_show_settings")
        page.click("#settings_plugin_moop_link a")
        page.wait_for_selector("#settings_plugin_moop legend:visible")
        page.wait_for_timeout(400)  # the dialog slides in
        return page

    yield opened
    server.api("POST", "/api/settings", json={"plugins": {"moop": {**DEFAULTS}}})


def stored(server: DemoServer) -> dict[str, Any]:
    return dict(server.api("GET", "/api/settings")["plugins"]["moop"])


def field(name: str) -> str:
    return f"[data-test-id=moop-field-{name}]"


def save(page: Any) -> None:
    with page.expect_response(lambda answer: answer.url.endswith("/api/settings") and answer.request.method == "POST"):
        page.click("#settings_dialog > .modal-footer .btn-primary")
    page.wait_for_selector("#settings_dialog", state="hidden")


def test_what_is_changed_in_the_page_is_what_the_server_keeps(settings_page: Any, server: DemoServer) -> None:
    page = settings_page()
    page.add_style_tag(content="#settings_plugin_moop { letter-spacing: 1px; }")  # so that lines are full and break
    page.uncheck(field("watch_prints"))
    page.select_option(field("on_failed"), "notify")
    page.fill(field("saturation_min"), "0,55")
    page.click("[data-test-id=moop-expert] summary")
    page.fill(field("settle_s"), "1.5")
    page.keyboard.press("Tab")
    save(page)
    kept = stored(server)
    assert kept["watch_prints"] is False and kept["on_failed"] == "notify"
    assert float(kept["saturation_min"]) == 0.55 and float(kept["settle_s"]) == 1.5
    untouched = set(DEFAULTS) - {"watch_prints", "on_failed", "saturation_min", "settle_s"}
    assert {name: kept[name] for name in untouched} == {name: DEFAULTS[name] for name in untouched}


def test_nothing_of_the_page_is_cut_off_at_the_dialogs_edge(settings_page: Any) -> None:
    page = settings_page()
    page.click("[data-test-id=moop-expert] summary")
    box = "document.querySelector('#settings_dialog_content')"
    assert page.evaluate(f"{box}.scrollWidth - {box}.clientWidth") <= 0


def test_a_value_out_of_range_is_told_at_its_field_and_never_saved(settings_page: Any, server: DemoServer) -> None:
    page = settings_page()
    page.fill(field("value_min"), "7")
    page.keyboard.press("Tab")
    assert "0 to 1 is allowed" in page.inner_text("[data-test-id=moop-wrong-value_min]")
    assert page.get_attribute(field("value_min"), "aria-invalid") == "true"
    page.select_option(field("on_failed"), "cancel")
    save(page)
    page.wait_for_selector(".ui-pnotify:has-text('not everything was saved')")
    assert stored(server)["value_min"] == DEFAULTS["value_min"] and stored(server)["on_failed"] == "cancel"


def test_a_default_is_one_click_away(settings_page: Any) -> None:
    page = settings_page()
    group = page.locator(".control-group", has=page.locator(field("saturation_min")))
    assert not group.locator("text=Use the default").is_visible()
    page.fill(field("saturation_min"), "0.9")
    page.keyboard.press("Tab")
    group.locator("text=Use the default").click()
    assert float(page.input_value(field("saturation_min"))) == DEFAULTS["saturation_min"]


def test_a_click_on_the_filament_takes_its_colour(settings_page: Any) -> None:
    page = settings_page()
    page.wait_for_selector("#moop_settings_filament .moop-note:has-text('Click on the filament')")
    canvas = page.locator("#moop_settings_filament .moop-picture")
    canvas.scroll_into_view_if_needed()
    box = canvas.bounding_box()
    canvas.click(position={"x": 90 / 320 * box["width"], "y": 120 / 240 * box["height"]})
    low, high = (float(page.input_value(field(name))) for name in ("hue_min_deg", "hue_max_deg"))
    assert low < 219 < high and high - low < 60  # the block's colour is (200, 90, 30) in BGR: hue 219
    page.wait_for_function(
        "document.querySelector('#moop_settings_filament [data-test-id=moop-filament-share]').innerText.includes('4.7 %')"
    )


def test_the_ring_can_be_dragged(settings_page: Any) -> None:
    page = settings_page()
    ring = page.locator("#moop_settings_filament [data-test-id=moop-ring]")
    ring.scroll_into_view_if_needed()
    box = ring.bounding_box()
    centre = (box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.mouse.move(centre[0] + 0.45 * box["width"], centre[1])
    page.mouse.down()
    page.mouse.move(centre[0], centre[1] + 0.45 * box["height"])  # a quarter further, clockwise
    page.mouse.up()
    hues = {page.input_value(field(name)) for name in ("hue_min_deg", "hue_max_deg")}
    assert "90" in hues


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_axe_finds_nothing_serious_in_the_settings(settings_page: Any, axe: str, theme: str) -> None:
    page = settings_page()
    page.click("[data-test-id=moop-expert] summary")
    if theme == "dark":
        page.add_style_tag(content=DARK)
    page.wait_for_timeout(500)
    assert serious_violations(page, axe, "#settings_plugin_moop") == []
