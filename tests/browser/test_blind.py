"""Whatever makes the watch blind is told with its reason, and with the button that mends it."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Iterator
from typing import Any, Callable

import pytest

import octoprint_moop.core
import octoprint_moop.machine
from octoprint_moop.core.errors import MoopError
from octoprint_moop.machine import blindness
from octoprint_moop.machine.link import Interrupted

from .stage import Canned, check

Open = Callable[[], Any]


def kinds_of_error(kind: type[MoopError] = MoopError) -> Iterator[type[MoopError]]:
    yield kind
    for below in kind.__subclasses__():
        yield from kinds_of_error(below)


def codes() -> list[str]:
    """Every reason that the status can have, from the source: the watch's own, and those of all errors it may meet."""
    for package in (octoprint_moop.core, octoprint_moop.machine):
        for module in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
            importlib.import_module(module.name)
    rooms = tuple(package.__name__ for package in (octoprint_moop.core, octoprint_moop.machine))
    errors = {kind.code for kind in kinds_of_error() if kind.__module__.startswith(rooms)}
    return sorted((errors | set(blindness.MEANINGS)) - {Interrupted.code})  # which nobody is ever told of


def blind(page: Any, canned: Canned, code: str, why: str) -> None:
    """As if the server had told it over the socket."""
    canned.print_of(check(3), blind=why, blind_code=code, watching=False)
    page.evaluate("status => ko.dataFor(document.getElementById('moop_watch')).takeStatus(status)", canned.status)


def test_every_reason_has_its_words_and_its_button(canned: Canned, open_tab: Open) -> None:
    canned.print_of(check(3))
    page = open_tab()
    assert set(codes()) == set(page.evaluate("MOOP.blind.codes"))
    for code in codes():
        blind(page, canned, code, f"It is because of {code}.")
        assert f"Nobody is watching this print: It is because of {code}." in page.inner_text(
            "[data-test-id=moop-state]"
        )
        assert len(page.inner_text("[data-test-id=moop-blind-advice]")) > 20, code
        assert page.is_visible("[data-test-id=moop-mend]") and page.inner_text("[data-test-id=moop-mend]"), code


@pytest.mark.parametrize(
    ("code", "shown"),
    [
        ("not_set_up", "[data-test-id=moop-setup-verdicts]"),
        ("unusable", "[data-test-id=moop-setup-verdicts]"),
        ("camera_moved", "[data-test-id=moop-place-points]"),
        ("segmentation", "#moop_setup_filament"),
        ("out_of_view", "#settings_dialog [data-test-id=moop-field-capture]"),
        ("bug", "#settings_plugin_logging"),
        ("gcode", "#files"),
        ("not_held", "#connection"),
    ],
)
def test_the_button_leads_to_where_it_can_be_mended(canned: Canned, open_tab: Open, code: str, shown: str) -> None:
    canned.print_of(check(3))
    page = open_tab()
    blind(page, canned, code, "So it is.")
    page.click("[data-test-id=moop-mend]")
    page.wait_for_selector(f"{shown} >> visible=true")
    page.wait_for_function("!ko.dataFor(document.getElementById('moop_setup')).busy()")


def test_watching_is_tried_again_from_the_tab(canned: Canned, open_tab: Open) -> None:
    canned.print_of(check(3))
    page = open_tab()
    blind(page, canned, "eye", "The process that looks has ended.")
    page.click("[data-test-id=moop-mend]")
    page.wait_for_function("!ko.dataFor(document.getElementById('moop_watch')).busy()")
    assert canned.posts == [("watch", {"watching": True})]


def test_when_no_print_runs_nobody_is_called_blind(canned: Canned, open_tab: Open) -> None:
    page = open_tab()
    assert not page.is_visible("[data-test-id=moop-blind]")
