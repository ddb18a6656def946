"""`moop replay`: what the plugin would have concluded from a recording."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import click

from ..core.checks import Check, Pictures, Summary
from ..core.errors import MeshError, SettingsError
from ..core.expected.placing import Placement
from ..core.settings import Settings, read_value
from ..machine.recording import Recording
from ..machine.renderers import open_renderer
from ..machine.replaying import Replay
from ..machine.roads import MeshChoice
from .report import Report


@click.command()
@click.argument("recording", type=click.Path(path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="JSON lines on standard output: a check each, then a summary.")
@click.option("--set", "changes", multiple=True, metavar="KEY=VALUE", help="A setting other than its default.")
@click.option("--report", "page", type=click.Path(path_type=Path, dir_okay=False), metavar="FILE.html",
              help="Also write a page with plot and pictures, to be read anywhere.")  # fmt: skip
@click.option("--fresh", is_flag=True, help="Look at every frame anew, whatever an earlier replay has kept.")
@click.option("--mesh", type=click.Path(path_type=Path), help="Compare with this model (STL, OBJ, 3MF), as the paper.")
@click.option(
    "--mesh-at", metavar="X,Y[,DEG]", help="Middle of the model on the bed, mm, and its turn; else by bounds."
)
@click.option("--layer-height-mm", type=float, help="With --mesh, where the G-code cannot be read.")
def replay(
    recording: Path, as_json: bool, changes: tuple[str, ...], page: Path | None, fresh: bool,
    mesh: Path | None, mesh_at: str | None, layer_height_mm: float | None,
) -> None:  # fmt: skip
    """Run the live plugin's pipeline over RECORDING, in time order and without looking ahead.

    What the frames show is kept beside them, so that another sensitivity is a matter of a moment.
    """
    if mesh is None and (mesh_at is not None or layer_height_mm is not None):
        raise click.UsageError("--mesh-at and --layer-height-mm are about a model: name it with --mesh.")
    if page is not None and not page.absolute().parent.is_dir():
        raise click.UsageError(f"--report {page}: there is no folder {page.absolute().parent} to write it to.")
    settings = _settings(changes)
    report = Report(f"Replay of {recording.resolve().name}")
    opened = Recording.open(recording)
    choice = None if mesh is None else MeshChoice(mesh, placement_from(mesh_at), layer_height_mm)
    replaying = Replay(opened, settings, mesh=choice)
    kept = None if fresh or page is not None else replaying.kept()
    checks: list[Check] = []
    with contextlib.ExitStack() as stack:
        looked: Iterable[tuple[Check, Pictures | None]]
        if kept is not None:
            looked = ((check, None) for check in kept)
        else:
            for note in () if replaying.road.solid is None else replaying.road.notes:
                click.echo(note, err=True)
            looked = replaying.looked(stack.enter_context(open_renderer()))
        for check, pictures in looked:
            checks.append(check)
            if page is not None:
                report.add(check, pictures)
            click.echo(json.dumps(check.to_json()) if as_json else _sentence(check))
    summary = Summary.of(checks)
    if page is not None:
        report.write(page, summary, _summary_sentence(summary))
    click.echo(json.dumps(summary.to_json()) if as_json else _summary_sentence(summary))


def placement_from(text: str | None) -> Placement:
    """Raises MeshError unless the text is two or three numbers."""
    if text is None:
        return Placement()
    parts = text.split(",")
    if len(parts) not in (2, 3):
        raise MeshError(f"--mesh-at {text!r}: write X,Y or X,Y,DEG, as in 100,110,90.")
    return Placement.from_json(dict(zip(("x_mm", "y_mm", "turn_deg"), parts)))


def _settings(changes: tuple[str, ...]) -> Settings:
    """Raises SettingsError naming the setting that is unknown or out of its range."""
    values = {}
    for change in changes:
        name, equals, value = change.partition("=")
        if not equals:
            raise SettingsError(f"--set {change}: write KEY=VALUE, as in sensitivity=high.")
        values[name.strip()] = read_value(name.strip(), value.strip())
    return replace(Settings(), **values)


def _sentence(check: Check) -> str:
    error = "  –   " if check.comparison is None else f"{check.comparison.error_ratio:6.4f}"
    return f"layer {check.moment.layer + 1:4d}  E {error}  {check.verdict:12s} {check.reason}".rstrip()


def _summary_sentence(summary: Summary) -> str:
    if summary.first_failed_layer is None:
        return f"{summary.checks} checks, no failure seen."
    return f"{summary.checks} checks. Failed at layer {summary.first_failed_layer + 1}: {summary.mode}."
