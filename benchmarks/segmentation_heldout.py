"""What the constants of the segmentation owe to the prints they were chosen on: cross-validation.

    python benchmarks/segmentation_heldout.py [--prints DIR] [--json FILE]

Each constant is tried at a half, as it is, and at its double, the others as they are. For each print left out (and, a
second time, for each printer left out with all its prints) the best of the three on all other prints is taken for each
constant, all together, and the print left out is measured with these. If the held-out figures fall far below the
others, the constants were fitted to the prints. About ten minutes.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import segmentation as bench

from octoprint_moop.core.segmentation import appearance, clicks, explain, weigh

FACTORS = (0.5, 1.0, 2.0)
CONSTANTS = {
    "seen": [
        (appearance, "_STAY_SIGMA"), (appearance, "_STRETCH"), (weigh, "_EXPECTED_WEIGHT"), (weigh, "_WRONG_LOOK"),
        (weigh, "_GUIDE_NOISE"), (weigh, "_GUIDE_RADIUS_PX"), (explain, "_BORDER_WEIGHT"), (explain, "_BORDER_SLOPE"),
        (explain, "_SIDE_PX"), (explain, "_NEAR_PX"), (explain, "_CLIP"),
    ],
    "clicked": [(clicks, "_EDGE"), (clicks, "_COLOUR"), (clicks, "_END"), (clicks, "_SPOT_PX")],
}  # fmt: skip
CLICKED = ("three clicks each", "at the edge", "at random, seed 0")
Settings = dict[tuple[object, str], float]


@contextlib.contextmanager
def constants(changed: Settings) -> Iterator[None]:
    """The modules with these constants, and with the tables made of them."""
    before = {(module, name): getattr(module, name) for module, name in changed}
    tables = appearance._STAY, appearance._OPPONENT, weigh._ODDS
    try:
        for (module, name), value in changed.items():
            setattr(module, name, type(before[module, name])(value))
        appearance._STAY, weigh._ODDS = appearance._stay_table(), weigh._odds_table()
        appearance._OPPONENT = tables[1].copy()
        stretch = before.get((appearance, "_STRETCH"), appearance._STRETCH)
        appearance._OPPONENT[1:, :3] *= appearance._STRETCH / stretch
        yield
    finally:
        for (module, name), value in before.items():
            setattr(module, name, value)
        appearance._STAY, appearance._OPPONENT, weigh._ODDS = tables


def measured(prints: list[bench.Print], which: str, numbers: list[int]) -> dict[int, dict[str, list[float]]]:
    """For each of the prints numbered, what was measured in each of its frames."""
    found: dict[int, dict[str, list[float]]] = {}
    for number in numbers:
        one = prints[number]
        frame, label = one.frames[bench.LABELLED], one.masks[bench.LABELLED]
        rows: dict[str, list[float]] = {}
        if which == "clicked":
            for rule in CLICKED:
                points = bench.clicks(label, one.box, bench.CLICKS[rule])
                learned = bench.learn_from_clicks(frame, *points, one.box)
                rows[rule] = [
                    bench.iou(learned.segment(one.frames[i]).mask, one.masks[i], one.box) for i in one.others()
                ]
        else:
            learned = bench.learn_from_label(frame, label, one.box)
            for i in one.others():
                frame, truth = one.frames[i], one.masks[i]
                rows.setdefault("colour alone", []).append(bench.iou(learned.segment(frame).mask, truth, one.box))
                for what, expectation in bench.EXPECTATIONS.items():
                    expected = expectation(truth, np.random.default_rng([number, i]))
                    seen = learned.segment(frame, expected).mask
                    rows.setdefault(what, []).append(bench.iou(seen, truth, one.box))
                    if what != "nearly right":
                        nearer = bench.iou(seen, truth) > bench.iou(seen, expected)
                        rows.setdefault(f"{what}, nearer to the truth", []).append(float(nearer))
        found[number] = rows
    return found


def score(found: dict[int, dict[str, list[float]]], numbers: list[int]) -> float:
    return float(np.mean([np.mean([np.mean(values) for values in found[n].values()]) for n in numbers]))


def figures(found: dict[int, dict[str, list[float]]]) -> dict[str, float]:
    """Over all frames: the share that is nearer to the truth; the median of everything else."""
    rows: dict[str, list[float]] = {}
    for per_print in found.values():
        for what, values in per_print.items():
            rows.setdefault(what, []).extend(values)
    return {
        what: round(float(np.mean(v) if what.endswith("truth") else np.median(v)), 3) for what, v in rows.items()
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--prints", type=Path, default=bench.PRINTS)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    prints = bench.read_prints(arguments.prints)
    everyone = list(range(len(prints)))
    printers = {one.name.split("_")[0] for one in prints}
    folds = {
        "a print left out": [[number] for number in everyone],
        "a printer left out": [[n for n in everyone if prints[n].name.startswith(p + "_")] for p in sorted(printers)],
    }
    results: dict[str, dict] = {"machine": bench.machine(), "as they are": {}, **{name: {} for name in folds}}
    chosen: dict[str, list[str]] = {name: [] for name in folds}
    for which, names in CONSTANTS.items():
        as_it_is = measured(prints, which, everyone)
        tried = {}
        for module, name in names:
            for factor in FACTORS:
                setting = {(module, name): getattr(module, name) * factor}
                with constants(setting):
                    tried[module, name, factor] = (
                        as_it_is if factor == 1 else measured(prints, which, everyone)
                    )  # fmt: skip
                print(which, name, factor, figures(tried[module, name, factor]), file=sys.stderr)
        results["as they are"].update(figures(as_it_is))
        for fold, groups in folds.items():
            held_out = {}
            for group in groups:
                others = [n for n in everyone if n not in group]
                best = {
                    (module, name): max(FACTORS, key=lambda factor: score(tried[module, name, factor], others))
                    for module, name in names
                }
                chosen[fold] += [f"{name} x{factor}" for (_, name), factor in best.items() if factor != 1]
                with constants({key: getattr(*key) * factor for key, factor in best.items()}):
                    held_out.update(measured(prints, which, group))
            results[fold].update(figures(held_out))
    results["chosen otherwise"] = {
        fold: {name: names.count(name) for name in sorted(set(names))} for fold, names in chosen.items()
    }
    print(json.dumps(results, indent=1))
    if arguments.json:
        arguments.json.write_text(json.dumps(results, indent=1) + "\n")


if __name__ == "__main__":
    main()
