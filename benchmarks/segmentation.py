"""How well filament is told from everything else: real prints (photographed) and rendered ones, with true masks.

    python benchmarks/segmentation.py [--prints DIR] [--cases DIR] [--json FILE] [--gallery DIR]

DIR (default ../shared/data/real-frames) holds a folder for each print: frames *.jpg with *.mask.png beside them. Learns
from the sixth frame's mask, segments the others, and counts intersection over union inside the box of the print's
masks grown by 10 px. Nothing is tuned per print; the expected masks are made from the true ones with fixed seeds.

CASES (default ../shared/cases) holds recordings with frames/NNNNNN.mask.png: there the live segmenter walks through the
whole print, with the expected masks of its G-code and, once without, once with the recording's thresholds.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
import time
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Callable

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from octoprint_moop.core.expected.views import ExpectedViews
from octoprint_moop.core.gcode.read import read_gcode
from octoprint_moop.core.segmentation.adaptive import AdaptiveSegmenter
from octoprint_moop.core.segmentation.labelled import learn_from_clicks, learn_from_label
from octoprint_moop.core.segmentation.segment import ThresholdSegmenter, segment_hsv, thresholds_of
from octoprint_moop.machine.recording import Recording
from octoprint_moop.machine.renderers import open_renderer

LABELLED = 5
MARGIN_PX = 10
COLOURS = ("black", "white", "grey", "blue", "green", "pink", "red", "yellow", "brown", "orange")


@dataclass(frozen=True, eq=False)
class Print:
    name: str
    colour: str
    files: list[Path]
    frames: list[np.ndarray]
    masks: list[np.ndarray]
    box: tuple[int, int, int, int]

    @classmethod
    def read(cls, folder: Path) -> Print:
        files = sorted(folder.glob("*.jpg"))
        masks = [cv2.imread(str(file.with_suffix(".mask.png")), cv2.IMREAD_GRAYSCALE) for file in files]
        masks = [np.where(mask > 127, np.uint8(255), np.uint8(0)) for mask in masks]
        x, y, w, h = cv2.boundingRect(np.maximum.reduce(masks))
        height, width = masks[0].shape
        box = (
            max(x - MARGIN_PX, 0), max(y - MARGIN_PX, 0), min(x + w + MARGIN_PX, width), min(y + h + MARGIN_PX, height)
        )  # fmt: skip
        words = folder.name.lower()
        colour = next((colour for colour in COLOURS if re.search(colour.replace("orange", "oran?ge"), words)), "other")
        return cls(folder.name, colour, files, [cv2.imread(str(file)) for file in files], masks, box)

    def others(self) -> Iterator[int]:
        return (i for i in range(len(self.files)) if i != LABELLED)


def iou(a: np.ndarray, b: np.ndarray, box: tuple[int, int, int, int] | None = None) -> float:
    if box is not None:
        x0, y0, x1, y1 = box
        a, b = a[y0:y1, x0:x1], b[y0:y1, x0:x1]
    union = np.count_nonzero((a > 0) | (b > 0))
    return np.count_nonzero((a > 0) & (b > 0)) / union if union else 1.0


def _moved(mask: np.ndarray, x_px: int, y_px: int) -> np.ndarray:
    shift = np.float32([[1, 0, x_px], [0, 1, y_px]])
    return cv2.warpAffine(mask, shift, mask.shape[::-1], flags=cv2.INTER_NEAREST)


def nearly_right(mask: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Shifted by up to 2 px, grown or shrunk by up to 2 px."""
    x_px, y_px = rng.integers(-2, 3, 2)
    grow = int(rng.integers(-2, 3))
    mask = _moved(mask, int(x_px), int(y_px))
    if grow:
        kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * abs(grow) + 1,) * 2)
        mask = cv2.dilate(mask, kernel) if grow > 0 else cv2.erode(mask, kernel)
    return mask


def moved_sideways(mask: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Shifted by 20 % of its width, as after a detachment."""
    _, _, w, _ = cv2.boundingRect(mask)
    return _moved(mask, int(max(round(0.2 * w), 1)) * (1 if rng.random() < 0.5 else -1), 0)


def upper_third_added(mask: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Its upper third once more on top, though it is not there, as after a clog."""
    _, y, _, h = cv2.boundingRect(mask)
    third = max(round(h / 3), 1)
    top = mask.copy()
    top[y + third :] = 0
    return cv2.bitwise_or(mask, _moved(top, 0, -third))


EXPECTATIONS: dict[str, Callable] = {
    "nearly right": nearly_right, "moved": moved_sideways, "third added": upper_third_added
}  # fmt: skip


def clicks(mask: np.ndarray, box: tuple[int, int, int, int]) -> tuple[list, list]:
    """Three points on filament and three on background, by a rule: the pixel farthest from the mask's edge, then the
    farthest that is also far from the points before. Background: within the box."""

    def three(where: np.ndarray) -> list[tuple[int, int]]:
        depth = cv2.distanceTransform(cv2.copyMakeBorder(where, 1, 1, 1, 1, cv2.BORDER_CONSTANT), cv2.DIST_L2, 5)
        depth = depth[1:-1, 1:-1]
        rows, columns = np.mgrid[: where.shape[0], : where.shape[1]]
        points: list[tuple[int, int]] = []
        for _ in range(3):
            score = depth.copy()
            for x, y in points:
                score = np.minimum(score, np.hypot(columns - x, rows - y) / 2)
            row, column = np.unravel_index(score.argmax(), score.shape)
            points.append((int(column), int(row)))
        return points

    x0, y0, x1, y1 = box
    crop = mask[y0:y1, x0:x1]
    on, off = three(crop), three(cv2.bitwise_not(crop))
    return [(x + x0, y + y0) for x, y in on], [(x + x0, y + y0) for x, y in off]


class Figures:
    def __init__(self) -> None:
        self.rows: dict[str, dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
        self.nearer: dict[str, list[bool]] = defaultdict(list)
        self.frames: list[tuple[str, str, int, float]] = []

    def add(self, what: str, one: Print, index: int, value: float) -> None:
        self.rows[what]["all"].append(value)
        self.rows[what][one.colour].append(value)
        self.frames.append((what, one.name, index, value))

    def as_dict(self) -> dict:
        return {
            "photographed": True,
            "median_iou": {w: {c: round(float(np.median(v)), 3) for c, v in r.items()} for w, r in self.rows.items()},
            "nearer_to_truth": {what: round(float(np.mean(v)), 3) for what, v in self.nearer.items()},
            "prints": self.by_print(),
        }

    def by_print(self) -> dict:
        table: dict[str, dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
        for what, name, _, value in self.frames:
            table[name][what].append(round(value, 3))
        return table

    def table(self) -> str:
        colours = ["all"] + [c for c in COLOURS if any(c in r for r in self.rows.values())]
        lines = [
            "| median IoU | " + " | ".join(colours) + " | nearer to the truth |",
            "|---" * (len(colours) + 2) + "|",
        ]
        for what, row in self.rows.items():
            cells = [f"{np.median(row[c]):.2f}" if row[c] else "" for c in colours]
            nearer = f"{100 * np.mean(self.nearer[what]):.1f} %" if what in self.nearer else ""
            lines.append(f"| {what} | " + " | ".join(cells) + f" | {nearer} |")
        return "\n".join(lines)


def measure(one: Print, figures: Figures, number: int) -> None:
    learned = learn_from_label(one.frames[LABELLED], one.masks[LABELLED], one.box)
    band = thresholds_of(one.frames[LABELLED], one.masks[LABELLED])
    on, off = clicks(one.masks[LABELLED], one.box)
    clicked = learn_from_clicks(one.frames[LABELLED], on, off, one.box)
    for i in one.others():
        frame, truth = one.frames[i], one.masks[i]
        figures.add("thresholds alone", one, i, iou(segment_hsv(frame, band), truth, one.box))
        figures.add("colour alone", one, i, iou(learned.segment(frame).mask, truth, one.box))
        figures.add("three clicks each", one, i, iou(clicked.segment(frame).mask, truth, one.box))
        for what, expectation in EXPECTATIONS.items():
            rng = np.random.default_rng([number, i])
            expected = expectation(truth, rng)
            seen = learned.segment(frame, expected).mask
            figures.add(what, one, i, iou(seen, truth, one.box))
            if what != "nearly right":
                figures.nearer[what].append(iou(seen, truth) > iou(seen, expected))


def cost(one: Print, repeats: int = 15) -> dict[str, float]:
    """Processor time of segmenting on one thread, in times of decoding the same JPEG, p50; without and with the box."""
    found = {}
    cv2.setNumThreads(1)  # or another program on the machine would be measured too
    for width, height in ((640, 480), (1920, 1080)):
        size = (width, height)
        frame = cv2.resize(one.frames[LABELLED - 1], size, interpolation=cv2.INTER_AREA)
        mask = cv2.resize(one.masks[LABELLED], size, interpolation=cv2.INTER_NEAREST)
        data = cv2.imencode(".jpg", frame, [cv2.IMWRITE_JPEG_QUALITY, 90])[1]
        taught = cv2.resize(one.frames[LABELLED], size, interpolation=cv2.INTER_AREA)
        scale = np.array([width, height] * 2) / np.array([*one.masks[0].shape[::-1]] * 2)
        box = tuple(int(v) for v in np.array(one.box) * scale)
        for where, region in (("no box", None), ("box", box)):
            learned = learn_from_label(taught, mask, region)
            for what, expected in (("colour alone", None), ("expected", mask)):
                decode, segment = [], []
                for _ in range(repeats):
                    began = time.process_time()
                    cv2.imdecode(data, cv2.IMREAD_COLOR)
                    middle = time.process_time()
                    learned.segment(frame, expected)
                    segment.append(time.process_time() - middle)
                    decode.append(middle - began)
                found[f"{width}x{height}, {where}, {what}"] = round(float(np.median(segment) / np.median(decode)), 2)
    cv2.setNumThreads(-1)
    return found


def measure_case(folder: Path) -> dict[str, float]:
    """Median IoU from layer 5 on, over whole frames; learning stops where the recording's fault begins to show."""
    recording = Recording.open(folder)
    fault = json.loads((folder / "truth.json").read_text())["fault"] or {}
    onset = fault.get("first_visible_layer") or float("inf")
    with recording.job_path() as path:
        toolpath = read_gcode(path)
    header = recording.header
    thresholds = header.material
    segmenters = {
        "thresholds alone": ThresholdSegmenter(thresholds),
        "adaptive": AdaptiveSegmenter(None, recording.reference()),
        "adaptive, thresholds given": AdaptiveSegmenter(thresholds, recording.reference()),
    }
    found: dict[str, list[float]] = defaultdict(list)
    with open_renderer() as renderer:
        views = ExpectedViews(toolpath, header.camera(), header.printer.bed, renderer)
        for moment in recording.moments:
            frame = recording.frame(moment)
            expected = views.at(moment.file_pos, moment.position_mm)
            truth = cv2.imread(str((folder / moment.frame).with_suffix(".mask.png")), cv2.IMREAD_GRAYSCALE)
            for name, segmenter in segmenters.items():
                seen = segmenter.observe(frame, expected)
                if moment.layer < onset:
                    segmenter.learn(frame, expected, seen)
                if moment.layer >= 5:
                    found[name].append(iou(seen.mask, truth))
    return {name: round(float(np.median(values)), 3) for name, values in found.items()}


def draw_worst(figures: Figures, prints: dict[str, Print], folder: Path, count: int = 10) -> None:
    """The worst frames by colour alone, the box enlarged: green what is there, red what was seen."""
    folder.mkdir(parents=True, exist_ok=True)
    ranked = sorted((found for found in figures.frames if found[0] == "colour alone"), key=lambda found: found[3])
    for number, (_, name, index, value) in enumerate(ranked[:count], 1):
        one = prints[name]
        seen = learn_from_label(one.frames[LABELLED], one.masks[LABELLED], one.box).segment(one.frames[index]).mask
        x0, y0, x1, y1 = one.box
        plain = one.frames[index][y0:y1, x0:x1]
        drawn = plain.copy()
        for mask, colour in ((one.masks[index], (0, 255, 0)), (seen, (0, 0, 255))):
            edges, _ = cv2.findContours(mask[y0:y1, x0:x1], cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
            cv2.drawContours(drawn, edges, -1, colour, 1)
        pair = cv2.resize(np.hstack([plain, drawn]), None, fx=2, fy=2, interpolation=cv2.INTER_NEAREST)
        cv2.imwrite(str(folder / f"{number:02d}.png"), pair)
        print(f"{number:2d}. IoU {value:.2f}, {name}, frame {index + 1} of {len(one.files)}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    beside = Path(__file__).resolve().parents[2] / "shared" / "data" / "real-frames"
    parser.add_argument("--prints", type=Path, default=beside)
    parser.add_argument("--cases", type=Path, default=beside.parents[1] / "cases")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--gallery", type=Path, help="draw the ten worst frames by colour alone here, and name them")
    arguments = parser.parse_args()
    cv2.setRNGSeed(1)
    figures, costs = Figures(), defaultdict(list)
    prints = [Print.read(folder) for folder in sorted(path for path in arguments.prints.iterdir() if path.is_dir())]
    for number, one in enumerate(prints):
        measure(one, figures, number)
        for case, ratio in cost(one).items():
            costs[case].append(ratio)
    print(figures.table())
    ratios = {case: float(np.median(values)) for case, values in costs.items()}
    print("\n| cost, x imdecode (p50) | |\n|---|---|")
    for case, ratio in ratios.items():
        print(f"| {case} | {ratio:.1f} |")
    cases = {}
    print("\n| rendered, median IoU | thresholds alone | adaptive | adaptive, thresholds given |\n|---|---|---|---|")
    for folder in sorted(path for path in arguments.cases.iterdir() if (path / "truth.json").is_file()):
        cases[folder.name] = measure_case(folder)
        print(f"| {folder.name} | " + " | ".join(f"{value:.2f}" for value in cases[folder.name].values()) + " |")
    if arguments.gallery:
        draw_worst(figures, {one.name: one for one in prints}, arguments.gallery)
    if arguments.json:
        arguments.json.write_text(
            json.dumps({**figures.as_dict(), "cost_ratio_p50": ratios, "rendered_median_iou": cases}, indent=1)
        )


if __name__ == "__main__":
    main()
