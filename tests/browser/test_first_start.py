"""What a new user sees: OctoPrint's assistant says once where MOOP is set up."""

from __future__ import annotations

from typing import Any

import pytest

from octoprint_moop.demo.server import DemoServer

from .stage import OCTOPRINT


def test_octoprints_assistant_points_to_the_set_up(chromium: Any, tmp_path_factory: pytest.TempPathFactory) -> None:
    never_seen = {"server": {"seenWizards": {"moop": None}}}
    with DemoServer(tmp_path_factory.mktemp("first"), octoprint_python=OCTOPRINT, settings=never_seen) as server:
        context = chromium.new_context(viewport={"width": 1280, "height": 900})
        page = context.new_page()
        page.goto(server.url + "/?l10n=en")
        page.wait_for_function("window.OctoPrint && OctoPrint.loginui && OctoPrint.loginui.startedUp", timeout=60_000)
        page.fill("#login-user", server.user)
        page.fill("#login-password", server.password)
        page.click("#login-button")
        page.wait_for_selector("#wizard_dialog:visible :text('show it where the camera stands')", timeout=60_000)
        context.close()
