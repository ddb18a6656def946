"""The documents say what was measured, and lead where they say."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

pytest.importorskip("octoprint")  # the benchmark of G-code compares with its reader

from benchmarks.documents import TABLES, differing

ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted([*(ROOT / "docs").glob("*.md"), *ROOT.glob("*.md")])


def test_every_table_of_a_document_is_what_the_results_say():
    assert [f"{document.name}: {mark}" for document, mark, _ in differing()] == []


def test_every_marked_table_has_somebody_who_makes_it():
    marked = {(page.name, mark) for page in PAGES for mark in re.findall(r"<!-- ([\w-]+) -->", page.read_text())}
    assert marked == {(name, mark) for name, tables in TABLES.items() for mark in tables}


def test_every_link_within_the_documents_leads_somewhere():
    for page in PAGES:
        for target in re.findall(r"\]\((?!https?:|mailto:)([^)\s]+)\)", page.read_text()):
            name, _, anchor = target.partition("#")
            there = (page.parent / name).resolve() if name else page
            assert there.exists(), f"{page.name}: {target}"
            if anchor:
                headings = re.findall(r"^#+ (.+)$", there.read_text(), re.MULTILINE)
                assert anchor in {slug(heading) for heading in headings}, f"{page.name}: {target}"


def slug(heading: str) -> str:
    """A heading's anchor, as GitHub makes it."""
    plain = re.sub(r"[`*]|\[([^\]]*)\]\([^)]*\)", r"\1", heading.strip().lower())
    return re.sub(r"[^\w\- ]", "", plain).replace(" ", "-")


def test_every_script_that_a_document_tells_to_run_is_there():
    for page in PAGES:
        for script in re.findall(r"python ((?:benchmarks|docs|tools)/\w+\.py)", page.read_text()):
            assert (ROOT / script).is_file(), f"{page.name}: {script}"
        for module in re.findall(r"python -m benchmarks\.(\w+)", page.read_text()):
            assert (ROOT / "benchmarks" / f"{module}.py").is_file(), f"{page.name}: {module}"


def test_every_step_that_the_benchmark_of_a_check_times_is_there():
    from benchmarks.check import STEPS

    assert [f"{owner.__name__}.{name}" for owner, name, _ in STEPS if not hasattr(owner, name)] == []
