"""Who may import whom. One direction: core, then machine, then what people touch."""

from __future__ import annotations

import ast
import sys
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "octoprint_moop"
STANDARD = set(sys.stdlib_module_names) if hasattr(sys, "stdlib_module_names") else None

# room -> (rooms of this package that it may import besides itself, other people's packages)
ROOMS = {
    "core": (set(), {"numpy", "cv2"}),
    "machine": ({"core"}, {"numpy", "cv2"}),
    "demo": ({"core", "machine"}, {"numpy", "cv2"}),
    "cli": ({"core", "machine", "demo"}, {"numpy", "cv2", "click"}),
    "host": ({"core", "machine"}, {"octoprint", "flask", "flask_babel", "click"}),
}
# the one place for each library that is not everybody's
ALONE = {
    "core/expected/solid.py": {"trimesh"},
    "core/calibration/plate_mesh.py": {"trimesh"},
    "machine/gl.py": {"moderngl"},
    "host/downloads.py": {"tornado"},  # it is what OctoPrint serves large files by
    "machine/webcam.py": {"octoprint"},
    "demo/make_job.py": {"trimesh"},
    "demo/server.py": {"requests", "yaml"},  # both come with OctoPrint
    "demo/witness.py": {"octoprint", "octoprint_moop"},  # a plugin of its own, in the demo's server only
    "cli/demo.py": {"octoprint"},
}
NOT_AT_ONCE = {"numpy", "cv2", "trimesh", "moderngl"}  # a broken wheel must not keep a server from starting


def modules() -> list[Path]:
    return sorted(path for path in PACKAGE.rglob("*.py") if path != PACKAGE / "__init__.py")


def imported(path: Path, everywhere: bool = True) -> tuple[set[str], set[str]]:
    """(rooms of this package, other packages) that a module names in its imports; only at its top if not everywhere."""
    tree = ast.parse(path.read_text())
    package = ("octoprint_moop", *path.relative_to(PACKAGE).parts[:-1])
    rooms, others = set(), set()
    for node in ast.walk(tree) if everywhere else tree.body:
        if isinstance(node, ast.Import):
            others |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and not node.level:
            others.add((node.module or "").split(".")[0])
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1]
            target = [*base[1:], *(node.module.split(".") if node.module else [])]
            rooms |= {target[0]} if target else {alias.name for alias in node.names}
    return rooms, others - {"__future__"}


@pytest.mark.parametrize("path", modules(), ids=lambda path: str(path.relative_to(PACKAGE)))
def test_a_module_imports_only_from_rooms_below_its_own(path):
    room = path.relative_to(PACKAGE).parts[0]
    allowed_rooms, allowed_packages = ROOMS[room]
    allowed_packages = allowed_packages | ALONE.get(path.relative_to(PACKAGE).as_posix(), set())
    rooms, others = imported(path)
    assert rooms - {room} <= allowed_rooms
    if STANDARD is not None:
        assert others - STANDARD <= allowed_packages


@pytest.mark.parametrize("name", ["host/plugin.py", "host/api.py", "__init__.py"])
def test_what_octoprint_loads_needs_no_native_library(name):
    """Followed through this package's own modules, as the import system does."""
    seen, waiting = set(), [PACKAGE / name]
    while waiting:
        path = waiting.pop()
        if path in seen or not path.is_file():
            continue
        seen.add(path)
        _, others = imported(path, everywhere=False)
        assert not others & NOT_AT_ONCE, (
            f"{name} reaches {path.relative_to(PACKAGE)}, which imports {others & NOT_AT_ONCE}"
        )
        waiting += own_modules(path)


def own_modules(path: Path) -> list[Path]:
    """The files of this package that a module imports at its top."""
    package = path.relative_to(PACKAGE).parts[:-1]
    found = []
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.ImportFrom) and node.level:
            base = PACKAGE.joinpath(*package[: len(package) - node.level + 1])
            parts = node.module.split(".") if node.module else []
            found += [base.joinpath(*parts).with_suffix(".py"), base.joinpath(*parts, "__init__.py")]
            found += [base.joinpath(*parts, alias.name).with_suffix(".py") for alias in node.names]
    return found


def test_nothing_is_called_utils():
    assert not [path for path in modules() if path.stem in ("utils", "util", "helpers", "misc", "common")]
