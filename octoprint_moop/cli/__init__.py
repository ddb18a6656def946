"""The command line, `moop`. Each subcommand is a module of this package and is imported only when it is called."""

from __future__ import annotations

import importlib
import os
from typing import Any

import click

from ..core.errors import MoopError

# name -> (module of this package, attribute): so that `moop --help` needs no OpenCV and a broken wheel breaks one command
COMMANDS = {
    "calibrate": ("calibrate", "calibrate"),
    "demo": ("demo", "demo"),
    "doctor": ("doctor", "doctor"),
    "index": ("index", "index"),
    "markers": ("markers", "markers"),
    "mask": ("mask", "mask"),
    "replay": ("replay", "replay"),
    "segment": ("segment", "segment"),
}


class Commands(click.Group):
    """Finds a subcommand by name, and turns what the user can mend into one line and exit status 2."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return sorted(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in COMMANDS:
            return None
        module, attribute = COMMANDS[cmd_name]
        return getattr(importlib.import_module(f".{module}", __name__), attribute)

    def invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except MoopError as error:
            click.echo(f"moop: {error}", err=True)
            ctx.exit(2)
        except OSError as error:
            click.echo(f"moop: {error.filename or 'a file'}: {error.strerror or error}.", err=True)
            ctx.exit(2)
        except ImportError as error:
            click.echo(f"moop: a library does not load ({error}). `moop doctor` says how to mend it.", err=True)
            ctx.exit(2)


@click.group(cls=Commands)
@click.version_option(package_name="octoprint-moop")
def main() -> None:
    """Sees a 3D print fail, says what failed, and pauses it at that layer."""
    # OpenCV would otherwise print its own warnings about damaged pictures between ours.
    os.environ.setdefault("OPENCV_LOG_LEVEL", "ERROR")
