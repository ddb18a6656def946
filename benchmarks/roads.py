"""Both roads to the expected mask, beads and mesh, against one another: `python benchmarks/roads.py RECORDING … [--write]`.

A recording must have a model.stl as placed. IoU over all layers; once as it is, once without the neighbourhood of skirts and towers, which both
roads draw as beads.
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
from octoprint_moop.core.expected.meshroad import BESIDES
from octoprint_moop.core.expected.views import ExpectedViews
from octoprint_moop.machine.recording import Recording
from octoprint_moop.machine.renderers import open_renderer
from octoprint_moop.machine.roads import MeshChoice


def compared(folder: Path) -> dict[str, Any]:
    recording = Recording.open(folder)
    assert recording.mesh_path is not None, f"{folder} has no model.stl"
    road = recording.road(MeshChoice(recording.mesh_path))
    toolpath, camera, bed = road.toolpath, recording.header.camera(), recording.header.printer.bed
    at = bed.reference_mm
    whole, apart = [], []
    with open_renderer() as renderer:
        beads, mesh = (ExpectedViews(toolpath, camera, bed, one) for one in (renderer, road.drawn_by(renderer)))
        besides = np.flatnonzero(np.isin(toolpath.role, np.array(BESIDES, dtype=np.uint8)))
        there = beads.covered_at(at, besides) if besides.size else np.zeros(camera.image_size_px[::-1], np.uint8)
        elsewhere = cv2.dilate(there, np.ones((3, 3), np.uint8)) == 0
        for file_pos in toolpath.layer_end_pos.tolist():
            one, other = (views.at(file_pos, at).mask > 0 for views in (beads, mesh))
            whole.append((one & other).sum() / (one | other).sum())
            if (one & elsewhere).any():
                apart.append((one & other & elsewhere).sum() / ((one | other) & elsewhere).sum())
    return {
        "recording": folder.name, "layers": len(whole), "iou_mean": round(float(np.mean(whole)), 4),
        "iou_least": round(float(np.min(whole)), 4), "without_skirts_mean": round(float(np.mean(apart)), 4),
        "without_skirts_least": round(float(np.min(apart)), 4), "notes": list(road.solid.notes) if road.solid else [],
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("recordings", type=Path, nargs="+")
    parser.add_argument("--write", action="store_true")
    arguments = parser.parse_args()
    figures = [compared(folder) for folder in arguments.recordings if (folder / "model.stl").exists()]
    print(json.dumps(figures, indent=1))
    if arguments.write:
        save("roads", "python benchmarks/roads.py --write ../shared/cases/*", "rendered", figures)
        put(ROOT / "docs" / "rendering.md", "roads", as_table(figures))


def as_table(figures: list[dict[str, Any]]) -> str:
    head = ["model", "layers", "mean IoU", "least", "without skirts", "least"]
    names = ("layers", "iou_mean", "iou_least", "without_skirts_mean", "without_skirts_least")
    rows = [[f"rendered case {number}", *(row[name] for name in names)] for number, row in enumerate(figures, 1)]
    return table(head, rows)


if __name__ == "__main__":
    main()
