"""Where the tests find recordings too large for this repository, and which of them may run side by side."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest

LIVE = ("tests/browser/", "tests/demo/", "tests/host/", "tests/test_packaging.py")  # servers, printers, browsers


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """What lives in real time comes last."""
    items.sort(key=lambda item: item.nodeid.startswith(LIVE))


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: Any, log: Any) -> Any:
    """What only computes may run side by side, a file's tests together; what lives in real time runs one by one."""
    from xdist.scheduler import LoadScopeScheduling

    class Scheduling(LoadScopeScheduling):
        def _split_scope(self, nodeid: str) -> str:
            return "live" if nodeid.startswith(LIVE) else nodeid.split("::")[0]

    return Scheduling(config, log)


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of shared recordings, photographs and G-code: `../shared` beside the checkout, or $MOOP_SHARED."""
    beside = Path(__file__).resolve().parents[2] / "shared"
    folder = Path(os.environ.get("MOOP_SHARED", beside))
    if not (folder / "cases").is_dir():
        pytest.skip(f"no shared recordings at {folder}")
    return folder
