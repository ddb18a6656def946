"""What people read is marked for translators, collected, and shipped in German as well."""

from __future__ import annotations

import ast
import json
import re
import shutil
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import pytest

pytest.importorskip("babel")
from babel.messages.catalog import Catalog
from babel.messages.pofile import read_po

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "octoprint_moop"
STRING = r'"(?:[^"\\]|\\.)*"'
PLACEHOLDER = re.compile(r"%\(\w+\)s")


def read(name: str) -> Catalog:
    with (PACKAGE / "translations" / name).open("rb") as stream:
        return read_po(stream)


@pytest.fixture(scope="module")
def template() -> Catalog:
    return read("messages.pot")


def test_the_collected_sentences_and_the_compiled_languages_are_those_of_the_sources():
    done = subprocess.run(
        [sys.executable, ROOT / "tools" / "translations.py", "--check"], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_every_language_says_every_sentence_and_keeps_its_values(template):
    languages = sorted((PACKAGE / "translations").glob("*/LC_MESSAGES/messages.po"))
    assert languages
    for path in languages:
        language = read(str(path.relative_to(PACKAGE / "translations")))
        for message in template:
            if message.id:
                said = language[message.id].string
                assert said, f"{path.parts[-3]} has no word for {message.id!r}"
                assert set(PLACEHOLDER.findall(said)) == set(PLACEHOLDER.findall(message.id)), message.id


def test_nothing_that_a_script_marks_escapes_the_collector(template):
    """Babel passes over a call within another call's values; such a sentence would stay English for ever."""
    for path in sorted((PACKAGE / "static" / "js").glob("*.js")):
        for found in re.findall(rf"\b(?:say|N_|gettext)\(\s*({STRING}(?:\s*\+\s*{STRING})*)", path.read_text()):
            sentence = "".join(json.loads(piece) for piece in re.findall(STRING, found))
            assert sentence in template, f"{path.name}: {sentence!r} is marked but not collected"


def test_no_words_stand_unmarked_in_a_template():
    for path in sorted((PACKAGE / "templates").rglob("*.jinja2")):
        page = Words()
        page.feed(re.sub(r"\{[#%{].*?[#%}]\}", "", path.read_text(), flags=re.S))
        left = set(re.findall(r"[^\W\d_]{2,}", " ".join(page.words))) - {"mm", "MOOP"}
        assert not left, f"{path.name}: {sorted(left)}"


class Words(HTMLParser):
    """What a person reads or hears of a page: its text and the attributes that are said."""

    def __init__(self) -> None:
        super().__init__()
        self.words: list[str] = []

    def handle_data(self, data: str) -> None:
        self.words.append(data)

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        self.words += [
            value or "" for name, value in attributes if name in ("title", "alt", "aria-label", "placeholder")
        ]


def test_what_the_page_tells_again_is_what_the_server_says():
    """Each pattern of moop_told.js stands so in a source; and of what is said of a failure, none is missing there."""
    node = shutil.which("node")
    if node is None:
        pytest.skip("node is not installed here")
    script = PACKAGE / "static" / "js" / "moop_told.js"
    show = f"console.log(JSON.stringify(require({json.dumps(str(script))}).sentences))"
    patterns = json.loads(subprocess.run([node, "-e", show], capture_output=True, text=True, check=True).stdout)
    known = {PLACEHOLDER.sub("{}", pattern) for pattern in patterns}
    said = {path: sentences(path) for path in PACKAGE.rglob("*.py")}
    everything = "\n".join(text for texts in said.values() for text in texts)
    assert [text for text in sorted(known) if text not in everything] == []
    unsaid = {"The picture is not wanted any more.", "The picture came too late.", "The printer went on meanwhile."}
    for name in (
        "core/checks.py", "core/decision/diagnose.py", "core/decision/telling.py", "core/view/usable.py", "core/view/view.py",
        "host/plugin.py", "machine/ledger.py", "machine/looks.py", "machine/passing.py", "machine/webcam.py",
    ):  # fmt: skip
        spoken = {
            text
            for text in said[PACKAGE / name]
            if re.fullmatch(r"[A-Z{].* .*[.?!]", text) and "Prints are" not in text
        }
        elsewhere = {"See the checks, their pictures and the recordings.", "Set up printer geometry, camera and filament.",
                     "Watch or not, check now, try other settings on recordings, delete them."}  # fmt: skip
        assert spoken - known - unsaid - elsewhere == set(), name


def sentences(path: Path) -> set[str]:
    """The strings of a module that are no docstrings, with {} for each value."""
    tree = ast.parse(path.read_text())
    passed = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            passed |= {id(value) for value in node.values}
            found.add("".join(value.value if isinstance(value, ast.Constant) else "{}" for value in node.values))
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in passed:
            found.add(node.value)
    return found
