"""Where the tests find recordings and photographs that are too large for this repository."""

from __future__ import annotations

import os
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of shared recordings, photographs and G-code: `../shared` beside the checkout, or $MOOP_SHARED."""
    beside = Path(__file__).resolve().parents[2] / "shared"
    folder = Path(os.environ.get("MOOP_SHARED", beside))
    if not (folder / "cases").is_dir():
        pytest.skip(f"no shared recordings at {folder}")
    return folder
