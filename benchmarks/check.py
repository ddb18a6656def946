"""What one whole check costs after the frame has arrived, in decodings of that frame, and where the time goes.

    python benchmarks/check.py [--cases DIR] [--checks 60] [--write] > check.json

DIR (default ../shared/cases) holds recordings; their prints are watched from the first frame on by the product's own
Inspector, once as they are (640x480) and once enlarged to 1920x1080: frames by cubic interpolation and cut to shape, with
a sensor's noise put back so that they are as hard to decode as a real camera's, and the camera with them.

One thread of OpenCV, and the processor's time, not the clock's: what a check takes from the printer's computer. A check
is decoding and `Inspector.check`, which ends with the verdict, for which the printer waits; what it teaches is learned
afterwards (`Inspector.learn`) and is told with it and without. Ratios are to the median of the decodings in the same run.
Each print is watched several times, and the least that each check took counts: other programs on the computer are not
what is measured. The first check, which draws the print (see render.py), is told apart; the last is that in which the
print fails, if it does: it is paused then. `steps_ms` are means over the others, each without what other steps within it
take, learning included.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

# before numpy and the software renderer are loaded, which look at these once
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("LP_NUM_THREADS", "1")

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.tables import ROOT, machine, put, save, table
from octoprint_moop.core import inspection
from octoprint_moop.core.camera import Camera
from octoprint_moop.core.decision.course import Course
from octoprint_moop.core.decision.decide import FAILED
from octoprint_moop.core.decision.diagnose import Naming
from octoprint_moop.core.decision.memory import Memory
from octoprint_moop.core.gcode.read import read_gcode
from octoprint_moop.core.view.light import Light, LightChange
from octoprint_moop.core.view.stabilise import Stabiliser
from octoprint_moop.core.view.turns import Turns
from octoprint_moop.core.view.view import View
from octoprint_moop.machine.pictures import decode
from octoprint_moop.machine.recording import Recording
from octoprint_moop.machine.renderers import open_renderer

LARGE_PX = (1920, 1080)
NOISE_SIGMA, JPEG_QUALITY = 2.5, 85
STEPS: tuple[tuple[Any, str, str], ...] = (
    (View, "steady", "usable, small pictures"),
    (Stabiliser, "turn", "camera's turn"),
    (Turns, "undo", "turn taken out"),
    (Light, "change", "light measured"),
    (LightChange, "undone", "light undone"),
    (View, "expected", "expected"),
    (View, "print_map", "expected"),
    (View, "observe", "segment"),
    (View, "occluded", "occluders"),
    (inspection, "compare", "E"),
    (inspection, "find", "evidence"),
    (Naming, "name", "name"),
    (Memory, "learn", "pixels' past"),
    (View, "learn", "learn colours"),
    (View, "check_calibration", "calibration"),
    (Course, "rule", "rule"),
)


class Stopwatch:
    """Processor time of each step, without that of the steps within it."""

    def __init__(self) -> None:
        self.spent_s: dict[str, float] = defaultdict(float)
        self._within_s = [0.0]

    def around(self, function: Callable, name: str) -> Callable:
        def timed(*arguments: Any, **named: Any) -> Any:
            self._within_s.append(0.0)
            began_s = time.process_time()
            try:
                return function(*arguments, **named)
            finally:
                whole_s = time.process_time() - began_s
                self.spent_s[name] += whole_s - self._within_s.pop()
                self._within_s[-1] += whole_s

        return timed


@contextmanager
def steps_timed() -> Iterator[Stopwatch]:
    watch = Stopwatch()
    with ExitStack() as stack:
        for owner, attribute, name in STEPS:
            stack.enter_context(patch.object(owner, attribute, watch.around(getattr(owner, attribute), name)))
        yield watch


class Enlarged:
    """Pictures of one size made LARGE_PX: enlarged to cover it, and cut to shape."""

    def __init__(self, size_px: tuple[int, int]) -> None:
        self._scale = max(LARGE_PX[0] / size_px[0], LARGE_PX[1] / size_px[1])
        self._whole_px = tuple(round(side * self._scale) for side in size_px)
        self._cut_px = tuple((whole - kept) // 2 for whole, kept in zip(self._whole_px, LARGE_PX))
        self._rng = np.random.default_rng(1)

    def picture(self, frame_bgr: np.ndarray) -> np.ndarray:
        large = cv2.resize(frame_bgr, self._whole_px, interpolation=cv2.INTER_CUBIC)
        (x, y), (width, height) = self._cut_px, LARGE_PX
        noise = self._rng.normal(0, NOISE_SIGMA, (height, width, 3))
        return np.clip(large[y : y + height, x : x + width] + noise, 0, 255).astype(np.uint8)

    def camera(self, camera: Camera) -> Camera:
        K = camera.K.copy()
        K[:2] *= self._scale
        K[:2, 2] += (self._scale - 1) / 2 - np.array(self._cut_px)  # pixel centres lie at whole numbers
        return replace(camera, image_size_px=LARGE_PX, K=K)


def measured(folder: Path, checks: int, large: bool, runs: int) -> dict[str, Any]:
    """One recording watched from its first frame on, several times."""
    recording = Recording.open(folder)
    header, reference = recording.header, recording.reference()
    blobs = [(folder / moment.frame).read_bytes() for moment in recording.moments[:checks]]
    if large:
        enlarged = Enlarged(header.camera().image_size_px)
        header = replace(header, cameras=((None, enlarged.camera(header.camera())),))
        reference = None if reference is None else enlarged.picture(reference)
        blobs = [_jpeg(enlarged.picture(decode(blob))) for blob in blobs]
    with recording.job_path() as job:
        toolpath = read_gcode(job)
    times_s, steps_s = [], []
    for _ in range(runs):
        decodings_s, checks_s, lessons_s, verdicts = [], [], [], defaultdict(int)
        with open_renderer() as renderer, steps_timed() as watch:
            inspector = inspection.Inspector(header, toolpath, renderer, reference_bgr=reference)
            for number, (blob, moment) in enumerate(zip(blobs, recording.moments)):
                began_s = time.process_time()
                frame = decode(blob)
                decoded_s = time.process_time()
                check = inspector.check(frame, moment)
                done_s = time.process_time()
                inspector.learn()
                decodings_s.append(decoded_s - began_s)
                checks_s.append(done_s - began_s)
                lessons_s.append(time.process_time() - done_s)
                verdicts[check.verdict] += 1
                if number == 0:
                    watch.spent_s.clear()
                if check.verdict == FAILED:
                    break
        times_s.append((decodings_s, checks_s, lessons_s))
        steps_s.append({name: spent_s / (len(checks_s) - 1) for name, spent_s in watch.spent_s.items()})
    decodings_s, checks_s, lessons_s = np.min(times_s, axis=0)
    steps_s = {name: min(steps[name] for steps in steps_s) for name in steps_s[0]}
    decoding_s = float(np.median(decodings_s))
    after, learned = checks_s[1:], (checks_s + lessons_s)[1:]
    p50_s, p95_s = np.percentile(after, [50, 95])
    learned_p50_s, learned_p95_s = np.percentile(learned, [50, 95])
    others_s = max(float(np.mean(learned) - np.mean(decodings_s[1:])) - sum(steps_s.values()), 0.0)
    return {
        "recording": folder.name, "size": "x".join(map(str, header.camera().image_size_px)),
        "renderer": renderer.name, "objects": len(toolpath.objects), "beads": len(toolpath),
        "checks": len(checks_s), "verdicts": dict(verdicts), "jpeg_bytes": int(np.median([len(blob) for blob in blobs])),
        "decode_ms": _ms(decoding_s), "p50_ms": _ms(p50_s), "p95_ms": _ms(p95_s), "first_ms": _ms(checks_s[0]),
        "p50_decodings": round(p50_s / decoding_s, 2), "p95_decodings": round(p95_s / decoding_s, 2),
        "p50_with_learning_decodings": round(learned_p50_s / decoding_s, 2),
        "p95_with_learning_decodings": round(learned_p95_s / decoding_s, 2),
        "steps_ms": {"decode": _ms(np.mean(decodings_s[1:])),
                     **{name: _ms(spent_s) for name, spent_s in steps_s.items()},
                     "all else": _ms(others_s)},
    }  # fmt: skip


def _ms(seconds: float) -> float:
    return round(float(seconds) * 1000, 3)


def _jpeg(frame_bgr: np.ndarray) -> bytes:
    return cv2.imencode(".jpg", frame_bgr, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1].tobytes()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--cases", type=Path, default=ROOT.parent / "shared/cases", help="a folder of recordings")
    parser.add_argument("--checks", type=int, default=60, help="of each recording, at most")
    parser.add_argument("--runs", type=int, default=3, help="of each recording")
    parser.add_argument("--size", choices=("as recorded", "1920x1080", "both"), default="both")
    parser.add_argument("--only", default="", help="recordings whose names contain this")
    parser.add_argument("--write", action="store_true", help="also into results/ and the document")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    folders = [path.parent for path in sorted(options.cases.glob(f"*{options.only}*/recording.json"))]
    if not folders:
        parser.error(f"there is no recording in {options.cases}: name a folder of recordings with --cases")
    rows = []
    for large in (False, True):
        if options.size in ("both", "1920x1080" if large else "as recorded"):
            for folder in folders:
                rows.append(measured(folder, options.checks, large, options.runs))
                print(_line(rows[-1]), file=sys.stderr)
    json.dump({"machine": machine(), "threads": 1, "checks": rows}, sys.stdout, indent=1)
    print()
    if options.write:
        save("check", "python benchmarks/check.py --write", "rendered", {"threads": 1, "checks": rows})
        put(ROOT / "docs" / "rendering.md", "check", as_table(rows))


def as_table(rows: list[dict[str, Any]]) -> str:
    """Figures in decodings of the same frame, and where the time goes."""
    head = ["recording", "size", "objects", "p50", "p95", "p50, learned", "p95, learned", "decode, ms", "most of it"]
    lines = []
    for number, row in enumerate(rows):
        steps = sorted(row["steps_ms"].items(), key=lambda step: -step[1])
        most = ", ".join(f"{name} {ms:.1f} ms" for name, ms in steps[:4] if name != "decode")
        names = (
            "p50_decodings",
            "p95_decodings",
            "p50_with_learning_decodings",
            "p95_with_learning_decodings",
            "decode_ms",
        )
        figures = [row[name] for name in names]
        case = f"rendered case {number % (len(rows) // len({one['size'] for one in rows})) + 1}"
        lines.append([case, row["size"], row["objects"], *figures, most])
    return table(head, lines)


def _line(row: dict[str, Any]) -> str:
    return (
        f"{row['recording']:20s} {row['size']:>9s}  p50 {row['p50_decodings']:5.1f}  p95 {row['p95_decodings']:5.1f} "
        f"(learned {row['p50_with_learning_decodings']:.1f}, {row['p95_with_learning_decodings']:.1f}) "
        f"decodings of {row['decode_ms']:.2f} ms; "
        + ", ".join(f"{name} {ms:.2f}" for name, ms in row["steps_ms"].items())
    )


if __name__ == "__main__":
    main()
