"""`moop demo`: the whole thing with no printer and no camera."""

from __future__ import annotations

import contextlib
import json
import signal
import tempfile
from collections.abc import Iterator
from pathlib import Path
from types import FrameType
from typing import Any

import click

from ..core.errors import MoopError

FAULTS = ("none", "detachment", "extrusion_stop", "layer_shift", "spaghetti", "warping")


@click.command()
@click.option("--fault", type=click.Choice(FAULTS), default="detachment", show_default=True, help="What goes wrong.")
@click.option(
    "--fault-layer",
    type=click.IntRange(min=0),
    help="In which layer (counted from 0, as in JSON); each kind has its own if left out.",
)
@click.option("--once", is_flag=True, help="Exit when the print has ended or paused.")
@click.option("--json", "as_json", is_flag=True, help="With --once: one JSON line on standard output.")
@click.option(
    "--port", type=click.IntRange(0, 65535), default=0, help="Port of the server on loopback; a free one if left out."
)
@click.option("--keep", type=click.Path(path_type=Path), help="Folder for the server's files, kept afterwards.")
@click.option(
    "--seed",
    type=click.IntRange(min=0),
    default=1,
    show_default=True,
    help="For another room, light and course of the fault.",
)
def demo(
    fault: str, fault_layer: int | None, once: bool, as_json: bool, port: int, keep: Path | None, seed: int
) -> None:
    """Print a job on a virtual printer before a simulated webcam, and let something go wrong with it."""
    try:
        import octoprint  # noqa: F401
    except ImportError:
        raise MoopError("OctoPrint is not installed here. Use `make demo`, or pip install OctoPrint.") from None
    from ..demo.run import Demo

    def say(text: str) -> None:
        click.echo(text, err=as_json)

    with _ended_by_signals(), _folder(keep) as folder:
        say("Starting OctoPrint ...")
        try:
            with Demo(folder, fault, fault_layer, port, seed) as running:
                server = running.server
                say(f"Open {server.url}/#tab_plugin_moop  user: {server.user}  password: {server.password}")
                begins = running.fault_layer
                what = "Nothing will go wrong." if begins is None else f"{fault} in layer {begins + 1}."
                if not once:
                    say(f"To let more go wrong: curl -X POST {running.webcam.address}/fault/spaghetti (or another)")
                say(f"Printing {running.job.name}, {running.toolpath.layers} layers. {what}")
                running.print_job()
                outcome = running.wait_for_the_end(lambda status: say(_line(status)))
                say(_end(outcome.to_json()))
                if as_json:
                    click.echo(json.dumps(outcome.to_json()))
                if not once:
                    say("The server runs on; Ctrl-C ends it.")
                    signal.pause()
        except KeyboardInterrupt:
            say("Ended.")


def _line(status: dict[str, Any]) -> str:
    check = status["last_check"]
    error = "" if check["E"] is None else f"  E {check['E']:.4f}"
    return f"layer {check['layer'] + 1:3d}{error}  {check['verdict']}  {check['reason']}".rstrip()


def _end(outcome: dict[str, Any]) -> str:
    if outcome["paused"]:
        return f"The print paused at layer {outcome['layer'] + 1} after {outcome['seconds']:.0f} s: {outcome['reason']}"
    return f"The print ended ({outcome['state']}) after {outcome['seconds']:.0f} s, {outcome['checks']} checks."


@contextlib.contextmanager
def _folder(keep: Path | None) -> Iterator[Path]:
    if keep is not None:
        yield keep
        return
    # The server's last threads may still write while the folder goes.
    folder = tempfile.TemporaryDirectory(prefix="moop-demo-")
    try:
        yield Path(folder.name)
    finally:
        with contextlib.suppress(OSError):
            folder.cleanup()


@contextlib.contextmanager
def _ended_by_signals() -> Iterator[None]:
    """Whatever ends us, ends the server too: SIGTERM and SIGHUP become what Ctrl-C is."""

    def interrupt(number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    before = {number: signal.signal(number, interrupt) for number in (signal.SIGTERM, signal.SIGHUP)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
