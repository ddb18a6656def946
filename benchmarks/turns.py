"""Is a camera that was turned found where it stands now? Drawn prints, turned by a known amount through their lens.

    python -m benchmarks.turns [--bases 20] [--write]

Each base is a good print of painted.py at 320 x 240: any colour, bed, camera and light, one in five with its head in view, calibration true. At six of its
layers the picture is turned by 0, 2, 6, 14 and 28 px (as of a picture 640 px across), half of these in dimmed light, with noise of its own; the camera last
stood still. *Found* is within 1 px, or an eighth of the turn; *not told* is where the stabiliser says that it cannot tell, or that the view is lost.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.painted import PaintedStory
from benchmarks.tables import ROOT, put, save, table
from octoprint_moop.core.camera import Camera
from octoprint_moop.core.expected.views import ExpectedViews
from octoprint_moop.core.view.backdrop import Backdrop
from octoprint_moop.core.view.glance import Glance
from octoprint_moop.core.view.turns import STILL
from octoprint_moop.machine.renderers import open_renderer

MODELS = Path(os.environ.get("MOOP_SHARED", ROOT.parent / "shared")) / "data" / "gcode-zoo"
SIZES_PX = (0, 2, 6, 14, 28)
SIZE_PX, FIRST_SEED = (320, 240), 40000
STEP = 4  # the warp is smooth: so many pixels apart it is computed
OUTCOMES = ("found", "not told", "said to stand still", "found elsewhere")


def turned(frame_bgr: np.ndarray, camera: Camera, rvec: np.ndarray) -> np.ndarray:
    """The picture as the camera sees it once it has turned, lens and all."""
    height, width = frame_bgr.shape[:2]
    x, y = np.meshgrid(np.arange(0.0, width, STEP), np.arange(0.0, height, STEP))
    rays = camera.rays(np.column_stack([x.ravel(), y.ravel()])) @ cv2.Rodrigues(rvec)[0]
    source, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), camera.K, camera.distortion)
    source, enlarge = source.reshape(*x.shape, 2).astype(np.float32), np.diag([STEP, STEP, 1.0])[:2]
    maps = [cv2.warpAffine(source[..., n], enlarge, (width, height), borderMode=cv2.BORDER_REPLICATE) for n in (0, 1)]
    return cv2.remap(frame_bgr, maps[0], maps[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def measure(seed: int, renderer: Any) -> list[dict[str, Any]]:
    """What was said of each turned picture of one base."""
    story, rng = PaintedStory.good(seed, MODELS, SIZE_PX, still=False), np.random.default_rng([seed, 31])
    camera, px = story.header.camera(), SIZE_PX[0] / 640
    numbers = sorted({0, 1, *(len(story) * n // 4 for n in (1, 2, 3)), len(story) - 1})
    expected = ExpectedViews(story.toolpath, camera, story.header.printer.bed, renderer, None)
    first, found = story.moment(0), []
    backdrop = Backdrop(
        camera, story.header.printer, story.reference, story.header.printer.bed.reference_mm,
        expected.at(first.file_pos, first.position_mm, parked=first.parked),
    )  # fmt: skip
    for number in numbers:
        moment, frame = story.moment(number), story.picture(number).frame
        for size_px in SIZES_PX:
            rvec = rng.normal(0, 1, 3) * [1, 1, 0.4]
            rvec *= size_px * px / camera.K[0, 0] / np.hypot(*rvec[:2])
            gain = rng.choice([1.0, 0.55]) if size_px else 1.0
            seen = turned(frame, camera, rvec) * gain + rng.normal(0, 1.0, frame.shape)
            stabiliser = backdrop.stabiliser
            told = stabiliser.turn(Glance(np.clip(seen, 0, 255).astype(np.uint8)), moment.position_mm, STILL)
            off_px = stabiliser.turns.apart_px(told.rvec, rvec) / px
            outcome = "found elsewhere"
            if told is STILL if not size_px else off_px < max(1.0, size_px / 8):
                outcome = "found"
            elif told is STILL:
                outcome = "said to stand still" if stabiliser.sure else "not told"
            found.append({"seed": seed, "bed": story.header.printer.bed.kind, "head": not moment.parked,
                          "size_px": size_px, "outcome": outcome, "off_px": round(float(off_px), 2)})  # fmt: skip
    return found


def summed(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """By size of the turn, with the head in view and without: how often what was said, and the median error where it was found."""
    sums = []
    for size_px in SIZES_PX:
        for head in (False, True):
            own = [row for row in rows if row["size_px"] == size_px and row["head"] is head]
            off_px = [row["off_px"] for row in own if row["outcome"] == "found"]
            sums.append({"size_px": size_px, "head": head, "pictures": len(own), **Counter(row["outcome"] for row in own),
                         "off_px": round(float(np.median(off_px)), 2) if off_px else None})  # fmt: skip
    return sums


def as_table(sums: list[dict[str, Any]]) -> str:
    lines = [
        [f"{one['size_px']} px{', head in view' if one['head'] else ''}", one["pictures"],
         *(one.get(outcome, 0) for outcome in OUTCOMES), f"{one['off_px']:.2f} px" if one["off_px"] and one["size_px"] else "–"]
        for one in sums
    ]  # fmt: skip
    return table(["turned by", "pictures", *OUTCOMES, "median error where found"], lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bases", type=int, default=20)
    parser.add_argument("--write", action="store_true", help="keep the results, and put the table into the document")
    wanted = parser.parse_args()
    cv2.setNumThreads(1)
    with open_renderer() as renderer:
        rows = [row for n in range(wanted.bases) for row in measure(FIRST_SEED + n, renderer)]
    sums = summed(rows)
    print(as_table(sums))
    if wanted.write:
        save("turns", "python -m benchmarks.turns --write", "drawn", sums)
        put(ROOT / "docs" / "decision.md", "turns", as_table(sums))


if __name__ == "__main__":
    main()
