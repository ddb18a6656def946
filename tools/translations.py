"""What people read in the page, for translators: `python tools/translations.py` (or `make translations`).

Collects the marked sentences into octoprint_moop/translations/messages.pot, brings every language's messages.po up to
date with it, and compiles those. With --check nothing is written, and it fails where something is out of date.
With --new LANGUAGE (a code like fr) an empty messages.po is begun.

Marked is what stands in _() in a template, in gettext(), say() or N_() in a script, and the sentence and unit of each
setting. N_() marks what is translated elsewhere. Needs Babel, which comes with OctoPrint.
"""

from __future__ import annotations

import argparse
import datetime
import gettext
import io
import sys
from collections.abc import Iterator
from pathlib import Path

from babel.messages.catalog import Catalog
from babel.messages.extract import extract_from_dir
from babel.messages.mofile import write_mo
from babel.messages.pofile import read_po, write_po

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from octoprint_moop.core.settings import described  # noqa: E402 - found by the line above

PACKAGE = ROOT / "octoprint_moop"
FOLDER = PACKAGE / "translations"
TEMPLATE = FOLDER / "messages.pot"
METHODS = [("templates/**.jinja2", "jinja2"), ("static/js/**.js", "javascript")]
KEYWORDS = {"_": None, "gettext": None, "say": None, "N_": None}
UNITS = {"mm", "mm/s", "s", "min", "°", "MB", ""}  # alike in every language
BUGS = "https://github.com/octoprint-moop/octoprint_moop/issues"
HEADER = "# What octoprint-moop says to people. Distributed under the licence of octoprint-moop itself."
ONCE = datetime.datetime(2026, 11, 22, tzinfo=datetime.timezone.utc)  # a date that changes would be all that changes


def collected() -> Catalog:
    """Everything that is marked, in the order of the files."""
    catalog = Catalog(charset="utf-8", fuzzy=False)
    for file, line, message, comments, _ in sorted(extract_from_dir(PACKAGE, METHODS, keywords=KEYWORDS)):
        catalog.add(message, locations=[(f"octoprint_moop/{file}", line)], auto_comments=comments)
    for name, limits in described().items():
        for text in sorted({limits["sentence"], limits.get("unit", "")} - UNITS):
            catalog.add(text, locations=[("octoprint_moop/core/settings.py", 1)], auto_comments=[f"setting {name}"])
    return catalog


def as_text(catalog: Catalog) -> bytes:
    """A .po or .pot file, without the line numbers, dates and versions that would differ with every change elsewhere."""
    catalog.creation_date = catalog.revision_date = ONCE
    catalog.project, catalog.version, catalog.msgid_bugs_address = "octoprint-moop", "", BUGS
    catalog.header_comment = HEADER
    if "EMAIL@ADDRESS" in catalog.last_translator:
        catalog.last_translator = catalog.language_team = ""
    written = io.BytesIO()
    write_po(written, catalog, width=120, include_lineno=False, ignore_obsolete=True)
    return b"".join(line for line in written.getvalue().splitlines(True) if not line.startswith(b'"Generated-By'))


def compiled(catalog: Catalog) -> bytes:
    written = io.BytesIO()
    write_mo(written, catalog)
    return written.getvalue()


def files() -> Iterator[tuple[Path, bytes]]:
    """Each file of the translations, with what belongs in it now."""
    template = collected()
    yield TEMPLATE, as_text(template)
    for path in sorted(FOLDER.glob("*/LC_MESSAGES/messages.po")):
        with path.open("rb") as stream:
            language = read_po(stream, locale=path.parts[-3], charset="utf-8")
        language.update(template, no_fuzzy_matching=True)
        yield path, as_text(language)
        yield path.with_suffix(".mo"), compiled(language)


def said(path: Path, data: bytes) -> dict[str, str]:
    """Sentence -> translation in a file of any of the three kinds. Headers and line breaks are Babel's own matter."""
    if path.suffix == ".mo":
        found = gettext.GNUTranslations(io.BytesIO(data))._catalog.items()  # type: ignore[attr-defined]
    else:
        found = [(message.id, message.string) for message in read_po(io.BytesIO(data))]
    return {str(text): str(translation) for text, translation in found if text}


def main() -> int:
    parser = argparse.ArgumentParser(description="Collect, bring up to date and compile the translations.")
    parser.add_argument("--check", action="store_true", help="write nothing; fail where something is out of date")
    parser.add_argument("--new", metavar="LANGUAGE", help="begin a language, as a code like fr or pt_BR")
    wanted = parser.parse_args()
    if wanted.new:
        begun = FOLDER / wanted.new / "LC_MESSAGES" / "messages.po"
        begun.parent.mkdir(parents=True, exist_ok=True)
        if not begun.exists():
            begun.write_bytes(as_text(Catalog(locale=wanted.new, charset="utf-8", fuzzy=False)))
    stale = [
        (path, now) for path, now in files() if not path.exists() or said(path, path.read_bytes()) != said(path, now)
    ]
    for path, now in stale:
        print(f"{path.relative_to(ROOT)} {'is out of date: run `make translations`' if wanted.check else 'is written'}")
        if not wanted.check:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(now)
    return 1 if wanted.check and stale else 0


if __name__ == "__main__":
    sys.exit(main())
