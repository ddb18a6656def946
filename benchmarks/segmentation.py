"""How well filament is told from everything else: real prints (photographed) with true masks.

    python benchmarks/segmentation.py [--prints DIR] [--json FILE] [--only PART]

DIR (default ../shared/data/real-frames) holds a folder for each print: frames *.jpg with *.mask.png beside them. Learns
from the sixth frame's mask, segments the others, and counts intersection over union inside the box of the print's
masks grown by 10 px. Nothing is tuned per print; the expected masks are made from the true ones with fixed seeds.
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

from octoprint_moop.core.labelled import learn_from_clicks, learn_from_label
from octoprint_moop.core.segment import segment_hsv, thresholds_of

LABELLED = 5
MARGIN_PX = 10
COLOURS = ("black", "white", "grey", "blue", "green", "pink", "red", "yellow", "brown", "orange")
MISSPELT = {"orage": "orange"}


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
        for wrong, right in MISSPELT.items():
            words = words.replace(wrong, right)
        colour = next((colour for colour in COLOURS if re.search(colour, words)), "other")
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
    """Times of segmenting, as multiples of decoding the same JPEG, p50; whole frame and the box alone."""
    data = np.fromfile(one.files[LABELLED - 1], np.uint8)
    found = {}
    for width, height in ((640, 480), (1920, 1080)):
        size = (width, height)
        frame = cv2.resize(one.frames[LABELLED - 1], size, interpolation=cv2.INTER_AREA)
        mask = cv2.resize(one.masks[LABELLED], size, interpolation=cv2.INTER_NEAREST)
        data = cv2.imencode(".jpg", frame, [cv2.IMWRITE_JPEG_QUALITY, 90])[1]
        taught = cv2.resize(one.frames[LABELLED], size, interpolation=cv2.INTER_AREA)
        scale = np.array([width, height] * 2) / np.array([*one.masks[0].shape[::-1]] * 2)
        box = tuple(int(v) for v in np.array(one.box) * scale)
        for where, region in (("whole frame", None), ("box", box)):
            learned = learn_from_label(taught, mask, region)
            for what, expected in (("colour alone", None), ("expected", mask)):
                decode, segment = [], []
                for _ in range(repeats):
                    began = time.perf_counter()
                    cv2.imdecode(data, cv2.IMREAD_COLOR)
                    middle = time.perf_counter()
                    learned.segment(frame, expected)
                    segment.append(time.perf_counter() - middle)
                    decode.append(middle - began)
                found[f"{width}x{height}, {where}, {what}"] = round(float(np.median(segment) / np.median(decode)), 2)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    beside = Path(__file__).resolve().parents[2] / "shared" / "data" / "real-frames"
    parser.add_argument("--prints", type=Path, default=beside)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--worst", type=int, default=0, help="also name the worst frames by colour alone")
    arguments = parser.parse_args()
    cv2.setRNGSeed(1)
    figures, costs = Figures(), defaultdict(list)
    for number, folder in enumerate(sorted(path for path in arguments.prints.iterdir() if path.is_dir())):
        one = Print.read(folder)
        measure(one, figures, number)
        for what, ratio in cost(one).items():
            costs[what].append(ratio)
    print(figures.table())
    ratios = {what: float(np.median(values)) for what, values in costs.items()}
    print("\n| cost, x imdecode (p50) | |\n|---|---|")
    for what, ratio in ratios.items():
        print(f"| {what} | {ratio:.1f} |")
    if arguments.worst:
        ranked = sorted((f for f in figures.frames if f[0] == "colour alone"), key=lambda f: f[3])
        for what, name, index, value in ranked[: arguments.worst]:
            print(f"{value:.2f} {name} frame {index}")
    if arguments.json:
        arguments.json.write_text(json.dumps({**figures.as_dict(), "cost_ratio_p50": ratios}, indent=1))


if __name__ == "__main__":
    main()
