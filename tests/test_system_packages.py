"""What pip cannot install is installed where that is allowed, else the command is printed; only the vital stops make."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

SCRIPT = Path(__file__).resolve().parents[1] / "tools" / "system-packages.sh"


@pytest.fixture
def machine(tmp_path):
    """Runs the script on a machine made of stubs: (needs, user, what Python cannot do, whether sudo asks nothing)."""

    def run(*needs, user=1000, lacks="", sudo=False):
        stubs = {
            "python": f'case "$*" in *{lacks or "nothing"}*) exit 1;; esac',
            "id": f"echo {user}",
            "sudo": f'[ {int(sudo)} = 1 ] || exit 1; [ "$1" = -n ] && exit 0; echo "$@" >>{tmp_path}/ran',
            "apt-get": f'echo "$@" >>{tmp_path}/ran',
            "cc": "",
            "chromium": "",
        }
        for name, body in stubs.items():
            (tmp_path / name).write_text(f"#!/bin/sh\n{body}\n")
            (tmp_path / name).chmod(0o755)
        done = subprocess.run(
            ["/bin/sh", str(SCRIPT), "python", *needs], capture_output=True, text=True,
            env={**os.environ, "PATH": f"{tmp_path}:/usr/bin:/bin"},
        )  # fmt: skip
        ran = (tmp_path / "ran").read_text() if (tmp_path / "ran").exists() else ""
        return done.returncode, done.stdout, ran

    return run


def test_where_everything_is_there_nothing_is_said_or_done(machine):
    assert machine("python", "chromium") == (0, "", "")


def test_without_venv_and_rights_make_stops_with_the_command(machine):
    status, said, ran = machine("python", lacks="ensurepip")
    assert (status, ran) == (1, "")
    assert "sudo apt-get install -y --no-install-recommends python3-venv" in said


def test_without_opengl_and_rights_make_goes_on_with_the_command_printed(machine):
    status, said, ran = machine("gl", lacks="libEGL")
    assert (status, ran) == (0, "")
    assert "libegl1" in said and said.count("sudo apt-get install") == 1


@pytest.mark.parametrize("rights", [{"user": 0}, {"sudo": True}])
def test_root_and_a_sudo_that_does_not_ask_install(machine, rights):
    status, said, ran = machine("gl", lacks="libEGL", **rights)
    assert status == 0
    assert "install -y --no-install-recommends libegl1" in ran
    assert "Please run" not in said


def test_a_python_that_is_too_old_is_named(machine):
    status, said, _ = machine("python", lacks="version_info")
    assert status == 1
    assert "3.9 or newer" in said
