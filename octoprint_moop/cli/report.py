"""`moop replay --report FILE.html`: one page, with its pictures inside, to be read without MOOP and sent with a bug report."""

from __future__ import annotations

import base64
from dataclasses import dataclass, field
from html import escape
from pathlib import Path

import cv2
import numpy as np

from ..core.checks import Check, Pictures, Summary
from ..core.overlay import INKS, difference, outlined

WIDEST_PX = 640
MOST_SHOWN = 30  # checks with pictures; three each make a page of some 5 MB

STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem; color: #222 }
figure { display: inline-block; margin: 0 .5rem .5rem 0; width: 31% } img { width: 100% } figcaption { font-size: 13px }
table { border-collapse: collapse; font-variant-numeric: tabular-nums } td, th { padding: .1rem .7rem; text-align: left }
td:nth-child(2) { text-align: right } tr.failed, tr.camera_moved { font-weight: bold } svg { width: 100% }
.key { display: inline-block; width: 1em; height: 1em; vertical-align: -.15em; margin: 0 .3em 0 .8em }
@media (max-width: 40rem) { figure { width: 100% } }
"""


@dataclass
class Report:
    """Collects the checks of one replay; pictures are kept small, and only where the verdict changes."""

    title: str
    checks: list[Check] = field(default_factory=list)
    figures: dict[int, list[str]] = field(default_factory=dict)  # by number of the check; data URIs
    _before: Pictures | None = None

    def add(self, check: Check, pictures: Pictures | None) -> None:
        """The next check, and what it looked at; None where nothing could be compared."""
        number = len(self.checks)
        if number == 0:
            self._show(number, pictures)
        elif self.checks[-1].verdict != check.verdict:
            self._show(number - 1, self._before)
            self._show(number, pictures)
        self.checks.append(check)
        self._before = pictures

    def _show(self, number: int, pictures: Pictures | None) -> None:
        if pictures is None or number in self.figures or len(self.figures) >= MOST_SHOWN:
            return
        frame, expected, observed = pictures.frame, pictures.expected, pictures.observed
        compared = difference(frame, expected, observed, pictures.ignored)
        self.figures[number] = [_data_uri(p) for p in (outlined(frame, observed), outlined(frame, expected), compared)]

    def write(self, path: Path, summary: Summary, outcome: str) -> None:
        """Raises OSError where the file cannot be written."""
        shown = "".join(self._pictures(number) for number in sorted(self.figures))
        rows = "".join(_row(check) for check in self.checks)
        key = "".join(
            f'<span class="key" style="background:rgb({r},{g},{b})"></span>{ink.name}'
            for ink in INKS
            for b, g, r in [ink.colour_bgr]
        )
        path.write_text(
            f'<!doctype html><html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width">'
            f"<title>{escape(self.title)}</title><style>{STYLE}</style><h1>{escape(self.title)}</h1>"
            f"<p><strong>{escape(outcome)}</strong> {self._what_failed()}</p>"
            f"<h2>E by layer</h2>{_plot(self.checks)}"
            f"<p>E is the share of wrong pixels in the silhouette of the complete print. Dashed: what this print tolerates. "
            f"A check takes {summary.ms_p50:g} ms, one in twenty more than {summary.ms_p95:g} ms.</p>"
            f"<h2>Where the verdict changed</h2><p>{key}</p>{shown or '<p>None could be compared.</p>'}"
            f"<h2>All checks</h2><table><tr><th>layer<th>E<th>verdict<th>why</tr>{rows}</table>"
            f"<p>Layers are counted from 1, as in slicers' previews; the recording's files count from 0.</p></html>\n",
            encoding="utf-8",
        )

    def _what_failed(self) -> str:
        return escape(next((check.reason for check in self.checks if check.verdict == "failed"), ""))

    def _pictures(self, number: int) -> str:
        check = self.checks[number]
        captions, layer = ("seen", "expected", "difference"), check.moment.layer + 1
        figures = "".join(
            f'<figure><img src="{uri}" alt="{caption}, layer {layer}"><figcaption>{caption}</figcaption></figure>'
            for uri, caption in zip(self.figures[number], captions)
        )
        return f"<h3>Layer {layer}: {escape(check.verdict)}</h3><p>{escape(check.reason)}</p>{figures}"


def _row(check: Check) -> str:
    error = "–" if check.comparison is None else f"{check.comparison.error_ratio:.4f}"
    return (
        f'<tr class="{escape(check.verdict)}"><td>{check.moment.layer + 1}<td>{error}<td>{escape(check.verdict)}'
        f"<td>{escape(check.reason)}</tr>"
    )


def _data_uri(picture_bgr: np.ndarray) -> str:
    shrink = min(1.0, WIDEST_PX / picture_bgr.shape[1])
    small = cv2.resize(picture_bgr, None, fx=shrink, fy=shrink, interpolation=cv2.INTER_AREA)
    jpeg = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, 85])[1].tobytes()
    return "data:image/jpeg;base64," + base64.b64encode(jpeg).decode("ascii")


def _plot(checks: list[Check]) -> str:
    """E by layer as SVG, its limit dashed, failures ringed."""
    judged = [(check.moment.layer or 0, check.comparison.error_ratio, check) for check in checks if check.comparison]
    if not judged:
        return ""
    width, height, left, bottom = 900, 260, 60, 30
    most_e = max(0.02, *(error for _, error, _ in judged), *(check.limit or 0 for *_, check in judged)) * 1.05
    last = max(1, *(layer for layer, *_ in judged))

    def at(layer: float, error: float) -> str:
        return f"{left + layer / last * (width - left - 10):.1f},{(height - bottom) * (1 - error / most_e) + 5:.1f}"

    line = " ".join(at(layer, error) for layer, error, _ in judged)
    limit = " ".join(at(layer, check.limit) for layer, _, check in judged if check.limit is not None)
    rings = "".join(
        '<circle cx="{}" cy="{}" r="5" fill="none" stroke="#b00"/>'.format(*at(layer, error).split(","))
        for layer, error, check in judged
        if check.verdict == "failed"
    )
    ticks = "".join(
        '<text x="{}" y="{}" text-anchor="end" font-size="12">{:.1%}</text>'.format(left - 6, at(0, e).split(",")[1], e)
        for e in (0, most_e / 2.1, most_e / 1.05)
    )
    return (
        f'<svg viewBox="0 0 {width} {height}" role="img" aria-label="E by layer">{ticks}'
        f'<text x="{left}" y="{height - 4}" font-size="12">layer 1</text>'
        f'<text x="{width - 10}" y="{height - 4}" text-anchor="end" font-size="12">layer {last + 1}</text>'
        f'<polyline points="{limit}" fill="none" stroke="#777" stroke-dasharray="5 4"/>'
        f'<polyline points="{line}" fill="none" stroke="#06c" stroke-width="2"/>{rings}</svg>'
    )
