"""`moop replay`: what the plugin would have concluded from a recording."""

from __future__ import annotations

import json
from pathlib import Path

import click

from ..core.gcode import read_gcode
from ..core.inspection import Check, Inspector, Summary
from ..machine.recording import Recording
from ..machine.renderers import open_renderer


@click.command()
@click.argument("recording", type=click.Path(path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="JSON lines on standard output: a check each, then a summary.")
def replay(recording: Path, as_json: bool) -> None:
    """Run the live plugin's pipeline over RECORDING, in time order and without looking ahead."""
    opened = Recording.open(recording)
    with opened.job_path() as path:
        toolpath = read_gcode(path)
    checks: list[Check] = []
    with open_renderer() as renderer:
        inspector = Inspector(opened.header, toolpath, renderer, reference_bgr=opened.reference())
        for moment in opened.moments:
            check = inspector.check(opened.frame(moment), moment)
            checks.append(check)
            click.echo(json.dumps(check.to_json()) if as_json else _sentence(check))
    summary = Summary.of(checks)
    click.echo(json.dumps(summary.to_json()) if as_json else _summary_sentence(summary))


def _sentence(check: Check) -> str:
    error = "  –   " if check.comparison is None else f"{check.comparison.error_ratio:6.4f}"
    return f"layer {check.moment.layer:4d}  E {error}  {check.verdict:12s} {check.reason}".rstrip()


def _summary_sentence(summary: Summary) -> str:
    if summary.first_failed_layer is None:
        return f"{summary.checks} checks, no failure seen."
    return f"{summary.checks} checks. Failed at layer {summary.first_failed_layer}: {summary.mode}."
