"""How well filament is told from everything else: real prints (photographed) and rendered ones, with true masks.

    python benchmarks/segmentation.py [--prints DIR] [--cases DIR] [--json FILE] [--gallery DIR]

DIR (default ../shared/data/real-frames) holds a folder for each print: frames *.jpg with *.mask.png beside them. Learns
from the sixth frame's mask, segments the others, and counts intersection over union inside the box of the print's
masks grown by 10 px. Nothing is tuned per print; the expected masks are made from the true ones with fixed seeds.

CASES (default ../shared/cases) holds recordings with frames/NNNNNN.mask.png: there the live segmenter walks through the
whole print, with the expected masks of its G-code and, once without, once with the recording's thresholds.

segmentation_heldout.py asks what the constants owe to these prints; segmentation_table.py makes the tables of the docs.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import re
import sys
import time
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import date
from functools import partial
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
GALLERY_PX = 360
PRINTS = Path(__file__).resolve().parents[2] / "shared" / "data" / "real-frames"
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


Points = list[tuple[int, int]]


def farthest(where: np.ndarray) -> Points:
    """The pixel farthest from the edge, then twice the farthest that is also far from the points before."""
    depth = cv2.distanceTransform(cv2.copyMakeBorder(where, 1, 1, 1, 1, cv2.BORDER_CONSTANT), cv2.DIST_L2, 5)
    depth = depth[1:-1, 1:-1]
    rows, columns = np.mgrid[: where.shape[0], : where.shape[1]]
    points: Points = []
    for _ in range(3):
        score = depth.copy()
        for x, y in points:
            score = np.minimum(score, np.hypot(columns - x, rows - y) / 2)
        row, column = np.unravel_index(score.argmax(), score.shape)
        points.append((int(column), int(row)))
    return points


def quartiles(where: np.ndarray) -> Points:
    """At a quarter, a half and three quarters of the pixels in reading order."""
    rows, columns = np.nonzero(where)
    return [(int(columns[len(rows) * q // 4]), int(rows[len(rows) * q // 4])) for q in (1, 2, 3)]


def at_random(where: np.ndarray, seed: int) -> Points:
    rows, columns = np.nonzero(where)
    chosen = np.random.default_rng(seed).choice(len(rows), 3, replace=False)
    return [(int(columns[i]), int(rows[i])) for i in chosen]


def at_the_edge(where: np.ndarray) -> Points:
    """At random among the pixels 2 to 5 px from the edge."""
    inner, core = (cv2.erode(where, np.ones((side, side), np.uint8)) for side in (3, 11))
    band = cv2.subtract(inner, core)
    return at_random(band if cv2.countNonZero(band) >= 3 else where, 0)


CLICKS: dict[str, Callable[[np.ndarray], Points]] = {
    "three clicks each": farthest, "at quartiles": quartiles, "at the edge": at_the_edge,
    **{f"at random, seed {seed}": partial(at_random, seed=seed) for seed in range(3)},
}  # fmt: skip


def clicks(mask: np.ndarray, box: tuple[int, int, int, int], rule: Callable[[np.ndarray], Points]) -> list[Points]:
    """Three points on filament and three on background, the latter within the box, by a rule."""
    x0, y0, x1, y1 = box
    crop = mask[y0:y1, x0:x1]
    return [[(x + x0, y + y0) for x, y in rule(where)] for where in (crop, cv2.bitwise_not(crop))]


def without_colour(frame: np.ndarray) -> np.ndarray:
    """As a monochrome camera would have seen it. Infrared also changes how bright each filament is; this does not."""
    return cv2.cvtColor(cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR)


class Figures:
    """Intersection over union by print and by what was asked; and whether what was seen is nearer to the truth."""

    def __init__(self) -> None:
        self.iou: dict[str, dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
        self.nearer: dict[str, dict[str, list[bool]]] = defaultdict(lambda: defaultdict(list))
        self.colours: dict[str, str] = {}

    def add(self, what: str, one: Print, value: float) -> None:
        self.colours[one.name] = one.colour
        self.iou[one.name][what].append(round(value, 3))

    def as_dict(self) -> dict:
        return {"colours": self.colours, "iou": self.iou, "nearer_to_truth": self.nearer}


def measure(one: Print, figures: Figures, number: int, others: bool = True) -> None:
    """others : the thresholds, other ways of clicking, and cameras without colour too"""
    frame, label = one.frames[LABELLED], one.masks[LABELLED]
    learned = learn_from_label(frame, label, one.box)
    clicked = {name: learn_from_clicks(frame, *clicks(label, one.box, rule), one.box) for name, rule in CLICKS.items()}
    if others:
        clicked["no box given"] = learn_from_clicks(frame, *clicks(label, one.box, farthest))
    grey = learn_from_label(without_colour(frame), label, one.box)
    band = thresholds_of(frame, label)
    for i in one.others():
        frame, truth = one.frames[i], one.masks[i]

        def add(what: str, seen: np.ndarray, truth: np.ndarray = truth) -> None:
            figures.add(what, one, iou(seen, truth, one.box))

        if others:
            add("thresholds alone", segment_hsv(frame, band))
            add("no colour", grey.segment(without_colour(frame)).mask)
        add("colour alone", learned.segment(frame).mask)
        for name, model in clicked.items():
            add(name, model.segment(frame).mask)
        for what, expectation in EXPECTATIONS.items():
            expected = expectation(truth, np.random.default_rng([number, i]))
            seen = learned.segment(frame, expected).mask
            add(what, seen)
            if others:
                add(f"no colour, {what}", grey.segment(without_colour(frame), expected).mask)
            if what != "nearly right":
                figures.nearer[one.name][what].append(bool(iou(seen, truth) > iou(seen, expected)))


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
    """The worst frames by colour alone, the box enlarged: as it is, and with green what is there, red what was seen."""
    folder.mkdir(parents=True, exist_ok=True)
    ranked = sorted(
        (value, name, index)
        for name, rows in figures.iou.items()
        for value, index in zip(rows["colour alone"], prints[name].others())
    )
    for number, (value, name, index) in enumerate(ranked[:count], 1):
        one = prints[name]
        seen = learn_from_label(one.frames[LABELLED], one.masks[LABELLED], one.box).segment(one.frames[index]).mask
        x0, y0, x1, y1 = _about(one.masks[index], one.box)
        plain = one.frames[index][y0:y1, x0:x1]
        scale = GALLERY_PX / max(plain.shape[:2])
        plain = cv2.resize(plain, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        drawn = plain.copy()
        for mask, colour in ((one.masks[index], (0, 255, 0)), (seen, (0, 0, 255))):
            large = cv2.resize(mask[y0:y1, x0:x1], plain.shape[1::-1], interpolation=cv2.INTER_NEAREST)
            edges, _ = cv2.findContours(large, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
            cv2.drawContours(drawn, edges, -1, colour, 1)
        pair = np.hstack([plain, np.full((plain.shape[0], 4, 3), 255, np.uint8), drawn])
        cv2.imwrite(str(folder / f"segmentation-worst-{number:02d}.jpg"), pair, [cv2.IMWRITE_JPEG_QUALITY, 80])
        print(f"{number:2d}. IoU {value:.2f}, {one.colour}, frame {index + 1} of {len(one.files)}, {name}")


def _about(mask: np.ndarray, box: tuple[int, int, int, int]) -> tuple[int, int, int, int]:
    """The mask with some of what is around it, within the box."""
    x, y, w, h = cv2.boundingRect(mask)
    margin = max(w // 3, 40)
    x0, y0, x1, y1 = box
    return max(x - margin, x0), max(y - margin, y0), min(x + w + margin, x1), min(y + h + margin, y1)


def machine() -> dict[str, str | int | None]:
    return {
        "date": date.today().isoformat(), "processor": platform.machine(), "cores": os.cpu_count(),
        "python": platform.python_version(), "numpy": np.__version__, "opencv": cv2.__version__,
    }  # fmt: skip


def read_prints(folder: Path) -> list[Print]:
    return [Print.read(path) for path in sorted(path for path in folder.iterdir() if path.is_dir())]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--prints", type=Path, default=PRINTS)
    parser.add_argument("--cases", type=Path, default=PRINTS.parents[1] / "cases")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--gallery", type=Path, help="draw the ten worst frames by colour alone here, and name them")
    arguments = parser.parse_args()
    figures, costs, cases = Figures(), defaultdict(list), {}
    prints = read_prints(arguments.prints)
    for number, one in enumerate(prints):
        measure(one, figures, number)
        for case, ratio in cost(one).items():
            costs[case].append(ratio)
        print(one.name, {what: round(float(np.median(values)), 2) for what, values in figures.iou[one.name].items()})
    for folder in sorted(path for path in arguments.cases.iterdir() if (path / "truth.json").is_file()):
        cases[folder.name] = measure_case(folder)
        print(folder.name, cases[folder.name])
    if arguments.gallery:
        draw_worst(figures, {one.name: one for one in prints}, arguments.gallery)
    if arguments.json:
        results = {
            "machine": machine(),
            "photographed": figures.as_dict(),
            "cost_ratio_p50": {case: float(np.median(values)) for case, values in costs.items()},
            "rendered_median_iou": cases,
        }
        arguments.json.write_text(json.dumps(results, separators=(",", ":")) + "\n")


if __name__ == "__main__":
    main()
