"""Takes the pictures in docs/images: the demo's print, seen in a real Chromium. `python docs/make_screenshots.py [FOLDER]`.

Needs playwright and a Chromium; about two minutes.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from playwright.sync_api import sync_playwright

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from octoprint_moop.demo.run import Demo  # noqa: E402
from tests.browser.stage import DARK, FLAGS, ONE_COLUMN, chromium_path, log_in, show_tab, wait_for_page  # noqa: E402

WIDE, NARROW = {"width": 1280, "height": 1000}, {"width": 400, "height": 800}


def open_tab(page: Any, url: str) -> None:
    page.goto(url + "/?l10n=en")
    wait_for_page(page)
    show_tab(page)
    page.wait_for_selector("[data-test-id=moop-state-text]:visible")
    page.wait_for_timeout(2500)  # pictures, plot


def take(page: Any, folder: Path, name: str) -> None:
    """In the page's own colours at 1280 px, under a dark theme, and at 400 px in one column as mobile layouts do."""
    page.evaluate("PNotify.removeAll()")
    page.wait_for_timeout(500)
    page.screenshot(path=folder / f"{name}.png", full_page=True)
    style = page.add_style_tag(content=DARK)
    page.evaluate("$(window).trigger('resize')")
    page.wait_for_timeout(600)
    page.screenshot(path=folder / f"{name}-dark.png", full_page=True)
    style.evaluate("element => element.remove()")
    style = page.add_style_tag(content=ONE_COLUMN)
    page.set_viewport_size(NARROW)
    page.wait_for_timeout(600)
    page.screenshot(path=folder / f"{name}-narrow.png", full_page=True)
    style.evaluate("element => element.remove()")
    page.set_viewport_size(WIDE)
    page.wait_for_timeout(600)


def main(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as basedir, sync_playwright() as playwright:
        with Demo(Path(basedir), fault="detachment", fault_layer=24) as demo:
            browser = playwright.chromium.launch(executable_path=chromium_path(), args=FLAGS)
            page = browser.new_page(viewport=WIDE)
            log_in(page, demo.server.url, demo.server.user, demo.server.password)
            demo.print_job()
            while demo.server.api("GET", "/plugin/moop/status")["checks"] < 12:
                time.sleep(0.5)
            open_tab(page, demo.server.url)
            take(page, folder, "tab-watching")
            demo.wait_for_the_end()
            page.wait_for_selector("[data-test-id=moop-failure]")
            page.wait_for_timeout(2500)
            take(page, folder, "tab-failure")
            page.click("text=Show where")
            page.wait_for_timeout(500)
            page.locator(".moop-frame").first.screenshot(path=folder / "difference.png")
            page.click("[data-test-id=moop-page-setup]")
            page.click("[data-test-id=moop-step-trial]")
            page.wait_for_timeout(3000)
            take(page, folder, "setup-trial")
            demo.server.api("POST", "/api/job", json={"command": "cancel"})
            page.click("[data-test-id=moop-page-past]")
            page.click("[data-test-id=moop-past-open]")
            page.click("[data-test-id=moop-past-replay]")
            page.wait_for_selector("[data-test-id=moop-past-outcome]:has-text('With these settings')", timeout=120_000)
            page.wait_for_timeout(1500)
            take(page, folder, "past-print")
            page.click("#navbar_show_settings")
            page.click("#settings_plugin_moop_link a")
            page.wait_for_timeout(2500)
            page.screenshot(path=folder / "settings.png")
            browser.close()


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).with_name("images"))
