"""The command line, `moop`. Each subcommand is a module of this package and is imported only when it is called."""

from __future__ import annotations

import errno
import importlib
import os
import sys
from collections.abc import Sequence
from typing import Any, NoReturn

# Before NumPy is imported: our matrices are small, and more threads would only wait for each other.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

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
    """Finds a subcommand by name, and turns whatever goes wrong into one line and exit status 2."""

    def main(  # type: ignore[override]  # of which it has several
        self,
        args: Sequence[str] | None = None,
        prog_name: str | None = None,
        standalone_mode: bool = True,
        **extra: Any,
    ) -> Any:
        if not standalone_mode:
            return super().main(args, prog_name, standalone_mode=False, **extra)
        try:
            done = super().main(args, prog_name, standalone_mode=False, **extra)
        except click.UsageError as error:
            if type(error).__name__ == "NoArgsIsHelpError":  # from click 8.2 on; it is the help text
                error.show()
                sys.exit(error.exit_code)
            command = error.ctx.command_path if error.ctx is not None else "moop"
            said = " ".join(error.format_message().split()).rstrip(".")
            _say(f"{said}. `{command} --help` says what can be given.")
        except click.Abort:
            click.echo("moop: stopped.", err=True)
            sys.exit(1)
        except Exception as error:  # a bug of ours; its traceback is for who asks for it
            if os.environ.get("MOOP_TRACEBACK"):
                raise
            said = " ".join(f"{type(error).__name__}: {error}".split())
            _say(f"this should not have happened ({said}). Please report it, with what MOOP_TRACEBACK=1 makes it say.")
        sys.exit(done if isinstance(done, int) else 0)

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
            _say(str(error))
        except OSError as error:
            if error.errno == errno.EPIPE:  # whoever reads has read enough
                raise
            _say(f"{error.filename or 'a file'}: {error.strerror or error}. Look at its name, its rights and the disk.")
        except ImportError as error:
            _say(f"a library does not load ({error}). `moop doctor` says how to mend it.")


def _say(what: str) -> NoReturn:
    click.echo(f"moop: {what}", err=True)
    sys.exit(2)


@click.group(cls=Commands)
@click.version_option(package_name="octoprint-moop")
def main() -> None:
    """Sees a 3D print fail, says what failed, and pauses it at that layer."""
    # OpenCV would otherwise print its own warnings about damaged pictures between ours.
    os.environ.setdefault("OPENCV_LOG_LEVEL", "ERROR")
