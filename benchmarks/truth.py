"""The expected mask against a recording's true masks: `python benchmarks/truth.py RECORDING … [--write]`.

IoU from layer 5 on, up to a failure: as it is drawn; without the neighbourhood of skirts and towers; and with beads left uncut, as the true
masks were drawn, in which the ends of a long bead are joined by a straight line where the lens bends it.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.tables import ROOT, put, save, table
from octoprint_moop.core.expected import beads
from octoprint_moop.core.expected.meshroad import BESIDES
from octoprint_moop.core.expected.views import ExpectedViews
from octoprint_moop.machine.recording import Recording
from octoprint_moop.machine.renderers import open_renderer

FIRST_LAYER = 5


def compared(folder: Path) -> dict[str, Any]:
    recording, truth = Recording.open(folder), json.loads((folder / "truth.json").read_text())
    toolpath, camera, bed = recording.road().toolpath, recording.header.camera(), recording.header.printer.bed
    onset = truth["fault"]["onset_layer"] if truth.get("fault") else toolpath.layers
    moments = [moment for moment in recording.moments if FIRST_LAYER <= moment.layer < onset]
    whole, apart, uncut = [], [], []
    straight_rad = beads.STRAIGHT_RAD
    with open_renderer() as renderer:
        views = ExpectedViews(toolpath, camera, bed, renderer)
        besides = np.flatnonzero(np.isin(toolpath.role, np.array(BESIDES, dtype=np.uint8)))
        for moment in moments:
            true = cv2.imread(str(folder / Path(moment.frame).with_suffix(".mask.png")), cv2.IMREAD_GRAYSCALE) > 0
            mask = views.at(moment.file_pos, moment.position_mm).mask > 0
            whole.append(_iou(mask, true))
            elsewhere = np.ones_like(mask)
            if besides.size:
                there = views.covered_at(moment.position_mm, besides)
                elsewhere = cv2.dilate(there, np.ones((5, 5), np.uint8)) == 0
            apart.append(_iou(mask & elsewhere, true & elsewhere))
        beads.STRAIGHT_RAD = np.inf
        try:
            plain = ExpectedViews(toolpath, camera, bed, renderer)
            for moment in moments[::4]:
                true = cv2.imread(str(folder / Path(moment.frame).with_suffix(".mask.png")), cv2.IMREAD_GRAYSCALE) > 0
                uncut.append(_iou(plain.at(moment.file_pos, moment.position_mm).mask > 0, true))
        finally:
            beads.STRAIGHT_RAD = straight_rad
    return {
        "recording": folder.name, "frames": len(whole), "iou_mean": round(float(np.mean(whole)), 4),
        "iou_least": round(float(np.min(whole)), 4), "without_skirts_mean": round(float(np.mean(apart)), 4),
        "uncut_mean": round(float(np.mean(uncut)), 4),
    }  # fmt: skip


def _iou(one: np.ndarray, other: np.ndarray) -> float:
    return float((one & other).sum() / (one | other).sum())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("recordings", type=Path, nargs="+")
    parser.add_argument("--write", action="store_true")
    arguments = parser.parse_args()
    figures = [compared(folder) for folder in arguments.recordings if (folder / "truth.json").exists()]
    print(json.dumps(figures, indent=1))
    if arguments.write:
        save("truth", "python benchmarks/truth.py --write ../shared/cases/*", "rendered", figures)
        put(ROOT / "docs" / "rendering.md", "truth", as_table(figures))


def as_table(figures: list[dict[str, Any]]) -> str:
    head = ["model", "frames", "mean IoU", "least", "without skirts", "long beads left straight"]
    names = ("frames", "iou_mean", "iou_least", "without_skirts_mean", "uncut_mean")
    return table(
        head, [[f"rendered case {number}", *(row[name] for name in names)] for number, row in enumerate(figures, 1)]
    )


if __name__ == "__main__":
    main()
