"""What is in the wheel, and that it installs beside OctoPrint as OctoPrint's plugin manager would do it."""

from __future__ import annotations

import subprocess
import sys
import tarfile
import venv
import zipfile
from pathlib import Path
from shutil import copytree, ignore_patterns

import pytest

from octoprint_moop.demo.server import DemoServer

ROOT = Path(__file__).resolve().parents[1]
NO_NETWORK = ("No matching distribution found for setuptools", "Failed to establish a new connection",
              "Temporary failure in name resolution", "NameResolutionError", "ReadTimeoutError")  # fmt: skip


def pip(python, *arguments):
    """Runs pip; skips the test where there is no network, and fails with pip's own words where pip does."""
    done = subprocess.run(
        [str(python), "-m", "pip", "--disable-pip-version-check", *map(str, arguments)],
        stdin=subprocess.DEVNULL, capture_output=True, text=True,
    )  # fmt: skip
    said = done.stdout + done.stderr
    if done.returncode and any(words in said for words in NO_NETWORK):
        pytest.skip("no package index can be reached")
    assert done.returncode == 0, said[-3000:]
    return said


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    """A copy to build from, so that nothing is left in the checkout."""
    left_out = ignore_patterns(
        ".git", ".venv*", "build", "dist", "*.egg-info", ".*_cache", "__pycache__", ".hypothesis", "test-results"
    )
    return copytree(ROOT, tmp_path_factory.mktemp("packages") / "source", ignore=left_out)


@pytest.fixture(scope="module")
def wheel(source):
    pip(sys.executable, "wheel", "--no-deps", "--wheel-dir", source.parent, source)
    return next(source.parent.glob("octoprint_moop-*.whl"))


def test_the_source_package_holds_all_that_a_checkout_holds(source):
    pytest.importorskip("setuptools")
    checkout = {str(path.relative_to(source)) for path in source.rglob("*") if path.is_file()}
    command = [sys.executable, "setup.py", "-q", "sdist", "--dist-dir", "../sdist"]
    done = subprocess.run(command, cwd=source, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    with tarfile.open(next((source.parent / "sdist").glob("*.tar.gz"))) as packed:
        found = {str(Path(*Path(name).parts[1:])) for name in packed.getnames()}
    ours = {name for name in checkout if not name.startswith((".", "extras/"))}
    assert ours <= found, sorted(ours - found)


def test_the_wheel_holds_every_module_asset_and_template_and_nothing_else(wheel):
    with zipfile.ZipFile(wheel) as packed:
        found = {name for name in packed.namelist() if ".dist-info/" not in name}
    suffixes = {".py", ".js", ".css", ".less", ".jinja2", ".gz", ".svg", ".png", ".pot", ".po", ".mo"}
    package = ROOT / "octoprint_moop"
    wanted = {
        str(path.relative_to(ROOT)) for path in package.rglob("*")
        if path.suffix in suffixes and "__pycache__" not in path.parts
    }  # fmt: skip
    assert found == wanted
    assert any(name.startswith("octoprint_moop/templates/") for name in found)
    assert "octoprint_moop/demo/job.gcode.gz" in found


def test_the_wheel_names_its_plugin_its_command_its_licence_and_nothing_that_octoprint_pins(wheel):
    with zipfile.ZipFile(wheel) as packed:
        about = {Path(name).name: packed.read(name).decode() for name in packed.namelist() if ".dist-info/" in name}
    assert "[octoprint.plugin]\nmoop = octoprint_moop" in about["entry_points.txt"]
    assert "moop = octoprint_moop.cli:main" in about["entry_points.txt"]
    assert "GNU AFFERO GENERAL PUBLIC LICENSE" in about["LICENSE"]
    assert "AGPL-3.0-or-later" in about["METADATA"]
    required = {
        line.split(": ", 1)[1].split(";")[0].strip() for line in about["METADATA"].splitlines()
        if line.startswith("Requires-Dist") and "extra ==" not in line
    }  # fmt: skip
    names = {"".join(c for c in text if c.isalnum() or c == "-").rstrip("0123456789") for text in required}
    assert names == {"numpy", "opencv-python-headless", "trimesh", "click", "moderngl"}
    assert not any("<" in text or "==" in text for text in required)


@pytest.mark.slow
def test_the_wheel_loads_beside_octoprint_in_an_empty_environment_and_after_octoprints_update(wheel, tmp_path):
    versions = ["1.11.8", "2.0.0rc7"]
    if sys.version_info >= (3, 14):
        versions.remove("1.11.8")  # does not run on this Python
    venv.create(tmp_path / "env", with_pip=True)
    python = tmp_path / "env" / "bin" / "python"
    install = (python, "install", "--quiet", "--no-compile", "--prefer-binary")
    pip(*install, "wheel")
    pip(*install, f"OctoPrint=={versions[0]}", wheel)
    loads_in(python, versions[0], tmp_path / "base")
    for version in versions[1:]:
        pip(*install, f"OctoPrint=={version}")
        loads_in(python, version, tmp_path / version)


def loads_in(python, octoprint, basedir):
    """A server of that environment has the plugin, its tab, its German words, and nothing to complain of."""
    assert "No broken requirements" in pip(python, "check")
    with DemoServer(basedir, octoprint_python=python) as server:
        assert server.api("GET", "/api/version")["server"] == octoprint
        plugins = {plugin["key"]: plugin for plugin in server.api("GET", "/plugin/pluginmanager/plugins")["plugins"]}
        assert plugins["moop"]["enabled"] and plugins["moop"]["origin"] == "entry_point"
        assert server.api("GET", "/plugin/moop/status")["watching"] is False
        page = server.request("GET", "/").text
        assert "tab_plugin_moop" in page and "Past prints" in page
        assert "Frühere Drucke" in server.request("GET", "/", headers={"Accept-Language": "de"}).text
        troubles = [line for line in server.log_text().splitlines() if "moop" in line and " - ERROR - " in line]
        assert not troubles
