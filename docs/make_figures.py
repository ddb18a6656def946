"""Draws the figures of docs/how-it-works.md: those of the paper, from our own recordings.

    python docs/make_figures.py ../shared/cases/dtu-paper ../shared/cases/cube-clean [--folder docs/images]

The first recording fails, the second doesn't. Needs matplotlib (`pip install -e ".[figures]"`); about half a minute.
"""

from __future__ import annotations

import argparse
import os
import sys
from dataclasses import dataclass
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import cv2
import matplotlib.pyplot as plt
import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from octoprint_moop.core.checks import Check, Pictures  # noqa: E402
from octoprint_moop.core.gcode.read import read_gcode  # noqa: E402
from octoprint_moop.core.inspection import Inspector  # noqa: E402
from octoprint_moop.core.overlay import difference  # noqa: E402
from octoprint_moop.machine.recording import Recording  # noqa: E402
from octoprint_moop.machine.renderers import open_renderer  # noqa: E402

MARGIN_PX = 25


@dataclass(frozen=True)
class Looked:
    """One recording, replayed: its checks, and what they looked at."""

    checks: list[Check]
    pictures: list[Pictures]

    @property
    def failed(self) -> int | None:
        """Number of the first failed check."""
        return next((n for n, check in enumerate(self.checks) if check.verdict == "failed"), None)

    def errors(self) -> tuple[list[int], list[float], list[float]]:
        """Layer, E and limit of each check that compared something."""
        judged = [check for check in self.checks if check.comparison]
        layers = [check.moment.layer or 0 for check in judged]
        return layers, [c.comparison.error_ratio for c in judged if c.comparison], [c.limit or np.nan for c in judged]


def look(folder: Path) -> Looked:
    recording = Recording.open(folder)
    with recording.job_path() as path:
        toolpath = read_gcode(path)
    checks, pictures = [], []
    with open_renderer() as renderer:
        inspector = Inspector(recording.header, toolpath, renderer, reference_bgr=recording.reference())
        for moment in recording.moments:
            checks.append(inspector.check(recording.frame(moment), moment))
            assert inspector.pictures is not None
            pictures.append(inspector.pictures)
    return Looked(checks, pictures)


def window(pictures: Pictures) -> tuple[slice, slice]:
    """Where the print is."""
    x, y, w, h = cv2.boundingRect(pictures.expected | pictures.observed)
    return slice(max(0, y - MARGIN_PX), y + h + MARGIN_PX), slice(max(0, x - MARGIN_PX), x + w + MARGIN_PX)


def panels(path: Path, shown: list[tuple[str, np.ndarray]], rows: int = 1) -> None:
    """Pictures side by side (BGR or masks), each with its title."""
    columns = -(-len(shown) // rows)
    high, wide = shown[0][1].shape[:2]
    figure, axes = plt.subplots(
        rows, columns, figsize=(3.6 * columns, rows * (3.6 * high / wide + 0.35)), squeeze=False
    )
    for axis, (title, picture) in zip(axes.flat, shown):
        axis.imshow(picture if picture.ndim == 2 else picture[:, :, ::-1], cmap="gray", vmin=0, vmax=255)
        axis.set_title(title, fontsize=10)
        axis.set_axis_off()
    figure.tight_layout(pad=0.4)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def masks(path: Path, looked: Looked, number: int) -> None:
    """The paper's road from a frame to its difference."""
    pictures = looked.pictures[number]
    part = window(pictures)
    wrong = cv2.bitwise_xor(pictures.expected, pictures.observed) & cv2.bitwise_not(pictures.ignored)
    layer = looked.checks[number].moment.layer
    panels(path, [
        (f"frame, layer {layer}", pictures.frame[part]), ("observed", pictures.observed[part]),
        ("expected", pictures.expected[part]), ("observed XOR expected", wrong[part]),
    ])  # fmt: skip


def error_by_layer(path: Path, looked: dict[str, Looked]) -> None:
    """E by layer, with what the print tolerates, and where it was stopped."""
    figure, axis = plt.subplots(figsize=(8, 3.6))
    for (name, one), colour in zip(looked.items(), ("tab:red", "tab:blue")):
        layers, errors, limits = one.errors()
        axis.plot(layers, errors, color=colour, label=name)
        axis.plot(layers, limits, color=colour, linestyle=":", linewidth=1)
        if one.failed is not None:
            layer = one.checks[one.failed].moment.layer or 0
            axis.axvline(layer, color=colour, linewidth=0.8)
            axis.annotate(f"stopped at layer {layer}", (layer, axis.get_ylim()[1] * 0.9), xytext=(-6, 0),
                          textcoords="offset points", ha="right", color=colour)  # fmt: skip
    axis.set_xlabel("layer")
    axis.set_ylabel("E")
    axis.set_ylim(bottom=0)
    axis.legend(frameon=False, loc="center left")
    figure.tight_layout()
    figure.savefig(path, metadata={"Date": None})
    plt.close(figure)


def before_and_after(path: Path, looked: Looked, number: int) -> None:
    """The last good layer above the first failed one: as the camera saw them, and with what differs."""
    part = window(looked.pictures[number])
    shown = []
    for n, word in ((number - 1, "before"), (number, "after")):
        pictures, check = looked.pictures[n], looked.checks[n]
        compared = difference(pictures.frame, pictures.expected, pictures.observed, pictures.ignored)
        error = check.comparison.error_ratio if check.comparison else float("nan")
        shown += [
            (f"{word}: layer {check.moment.layer}", pictures.frame[part]),
            (f"E {error:.4f}, {check.verdict}", compared[part]),
        ]
    panels(path, shown, rows=2)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("failing", type=Path)
    parser.add_argument("clean", type=Path)
    parser.add_argument("--folder", type=Path, default=ROOT / "docs" / "images")
    options = parser.parse_args()
    os.makedirs(options.folder, exist_ok=True)
    failing, clean = look(options.failing), look(options.clean)
    if failing.failed is None:
        sys.exit(f"{options.failing}: no failure is seen in it, so there is nothing to draw.")
    masks(options.folder / "figure-masks.png", failing, failing.failed // 2)
    error_by_layer(options.folder / "figure-error.svg", {"a print that fails": failing, "one that does not": clean})
    before_and_after(options.folder / "figure-failure.png", failing, failing.failed)


if __name__ == "__main__":
    main()
