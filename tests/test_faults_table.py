"""docs/faults.md says for each fault what happens, and which test shows it: those tests exist."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
ROWS = [line for line in (ROOT / "docs/faults.md").read_text().splitlines() if line.startswith("|")][2:]
NAMED = re.compile(r"`(?:(…|[\w/.]*\.py))(?:::(\w+))?`")


def named_in(row: str) -> list[tuple[Path, str]]:
    """(file, test) of each that a row names; the test "" for a whole file."""
    found, path = [], ROOT
    for name, test in NAMED.findall(row.rsplit("|", 2)[-2]):
        if name != "…":
            path = ROOT / name if name.startswith("tests/") else ROOT / "tests/host" / name
        found.append((path, test))
    return found


@pytest.mark.parametrize("row", [row for row in ROWS if "→" not in row and "---" not in row and "`" in row])
def test_each_row_names_tests_that_exist(row):
    named = named_in(row)
    assert named, row
    for path, test in named:
        assert path.is_file(), path
        assert f"def {test}(" in path.read_text() if test else True, f"{path.name} has no {test}"


def test_no_row_goes_without_a_test():
    faults = [row for row in ROWS if len(row.split("|")) == 5 and "---" not in row]
    assert len(faults) > 40
    assert not [row for row in faults if not named_in(row)]
