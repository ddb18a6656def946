"""Whether layers and filament are what the slicer says: `python benchmarks/slicers.py [--zoo FOLDER] [--write]`.

Slices small models with many settings by whichever of PrusaSlicer and Slic3r is installed, reads each file, and compares it with the
slicer's own words: its layer comments (Slic3r has none: the settings tell how many there must be) and the filament that it says it
uses. `--zoo` adds a folder of other people's files. `--write` keeps the figures and puts the table into docs/rendering.md.
"""

from __future__ import annotations

import argparse
import json
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.tables import ROOT, put, save, table
from octoprint_moop.core.gcode.read import read_gcode

FLAVORS = (
    "reprap", "reprapfirmware", "repetier", "teacup", "makerware", "marlin", "marlin2", "sailfish", "mach3", "machinekit",
    "smoothie",
)  # fmt: skip
START = "G28\nG1 Z0.3 F3000\nG1 X60 E15 F1000 ; prime\nG92 E0\n"
TWO = ["--nozzle-diameter", "0.4,0.4", "--filament-diameter", "1.75,1.75"]
PRUSA: dict[str, list[str]] = {
    "as it comes": [],
    "a start G-code that primes": ["--start-gcode", START],
    "relative E": ["--use-relative-e-distances"],
    "raft": ["--raft-layers", "3"],
    "supports": ["--support-material"],
    "brim and skirt": ["--brim-width", "4", "--skirts", "2", "--skirt-height", "3"],
    "vase": ["--spiral-vase", "--perimeters", "1", "--fill-density", "0", "--top-solid-layers", "0"],
    "two copies": ["--duplicate", "2", "--gcode-label-objects"],
    "one object after the other": ["--duplicate", "2", "--complete-objects", "--gcode-label-objects"],
    "volumetric E": ["--use-volumetric-e"],
    "firmware retraction": ["--use-firmware-retraction"],
    "volumetric E, firmware retraction": [
        "--use-volumetric-e",
        "--use-firmware-retraction",
        "--use-relative-e-distances",
    ],
    "z-hop and wipe": ["--retract-lift", "0.6", "--wipe", "--use-relative-e-distances"],
    "two tools": [*TWO, "--infill-extruder", "2", "--solid-infill-extruder", "2"],
    "two filaments and a wipe tower": [
        *TWO,
        "--infill-extruder",
        "2",
        "--single-extruder-multi-material",
        "--wipe-tower",
        "--use-relative-e-distances",
    ],
    "tool changes that feed": [*TWO, "--infill-extruder", "2", "--toolchange-gcode", "G1 E-20\nG1 E23"],
    "fine layers": ["--layer-height", "0.1", "--first-layer-height", "0.25"],
    "ironing": ["--ironing"],
    "fuzzy skin": ["--fuzzy-skin", "external"],
    "infill every third layer": ["--infill-every-layers", "3", "--layer-height", "0.1"],
    "layer G-code": ["--layer-gcode", "M117 layer [layer_num]", "--before-layer-gcode", ";BEFORE"],
    "filament of 2.85 mm, nozzle of 0.6 mm": ["--filament-diameter", "2.85", "--nozzle-diameter", "0.6"],
    **{f"flavor {flavor}": ["--gcode-flavor", flavor] for flavor in FLAVORS},
}
SLIC3R: dict[str, list[str]] = {
    "as it comes": [],
    "relative E": ["--use-relative-e-distances"],
    "raft": ["--raft-layers", "3"],
    "supports": ["--support-material"],
    "brim": ["--brim-width", "4"],
    "vase": ["--spiral-vase", "--perimeters", "1", "--fill-density", "0", "--top-solid-layers", "0"],
    "one object after the other": ["--duplicate", "2", "--complete-objects"],
    "volumetric E": ["--use-volumetric-e"],
    "firmware retraction": ["--use-firmware-retraction"],
    **{
        f"flavor {flavor}": ["--gcode-flavor", flavor]
        for flavor in ("teacup", "repetier", "makerware", "mach3", "smoothie")
    },
}
ADDED = ("raft", "supports")  # with layers of their own, of which Slic3r says nothing
LAYER = re.compile(rb"^;(?:LAYER_CHANGE|LAYER:-?\d+)\s*$", re.MULTILINE)
FILAMENT = re.compile(rb"^; filament used (?:\[mm\] )?= ([\d., ]+)", re.MULTILINE)


def model(path: Path) -> None:
    """A cup with a rim that overhangs: walls, floors, infill, and something to support."""
    outside = trimesh.creation.cylinder(9, 10, sections=48)
    rim = trimesh.creation.annulus(9, 13, 1.2, sections=48)
    outside.apply_translation((0, 0, 5))
    rim.apply_translation((0, 0, 9.4))
    trimesh.util.concatenate([outside, rim]).export(path)


def sliced(command: list[str], file: Path) -> bytes | None:
    done = subprocess.run(command, capture_output=True, timeout=300)
    return file.read_bytes() if done.returncode == 0 and file.exists() else None


def compared(slicer: str, what: str, data: bytes, file: Path, layers: int | None = None) -> dict[str, Any]:
    """layers : how many there must be, where no comments say so"""
    toolpath = read_gcode(file)
    said = FILAMENT.findall(data)
    figures = [float(number) for number in said[0].replace(b" ", b"").split(b",") if number] if said else []
    used = round(sum(figures), 2) or None
    return {
        "slicer": slicer, "settings": what, "layers_said": len(LAYER.findall(data)) or layers, "layers": toolpath.layers,
        "filament_said_mm": used, "filament_mm": round(toolpath.filament_mm, 2),
        "filament_own_mm": round(toolpath.filament_own_mm, 2), "notes": list(toolpath.notes),
        "objects": len(toolpath.objects),
    }  # fmt: skip


def by_prusaslicer(folder: Path, stl: Path) -> list[dict[str, Any]]:
    found = []
    said = subprocess.run(["prusa-slicer", "--help"], capture_output=True, text=True).stdout
    version = " ".join(re.findall(r"PrusaSlicer-?(\d[\d.]*)", said)[:1] or ["?"])
    version = f"PrusaSlicer {version}"
    for what, options in PRUSA.items():
        file = folder / "out.gcode"
        file.unlink(missing_ok=True)
        data = sliced(["prusa-slicer", "-g", *options, "-o", str(file), str(stl)], file)
        if data is None:
            print(f"{version}, {what}: could not be sliced", file=sys.stderr)
            continue
        found.append(compared(version, what, data, file))
    return found


def by_slic3r(folder: Path, stl: Path) -> list[dict[str, Any]]:
    found = []
    version = "Slic3r " + subprocess.run(["slic3r", "--version"], capture_output=True, text=True).stdout.strip()
    for what, options in SLIC3R.items():
        file = folder / "out.gcode"
        file.unlink(missing_ok=True)
        data = sliced(
            ["slic3r", "--layer-height", "0.25", "--first-layer-height", "0.25", *options, "-o", str(file), str(stl)],
            file,
        )
        if data is None:
            print(f"{version}, {what}: could not be sliced", file=sys.stderr)
            continue
        found.append(
            compared(version, what, data, file, None if what in ADDED else 40 * (2 if "--duplicate" in options else 1))
        )
    return found


def zoo(folder: Path) -> list[dict[str, Any]]:
    found = []
    for file in sorted(folder.glob("*.gcode")):
        toolpath = read_gcode(file)
        found.append({"file": file.name, "slicer": toolpath.slicer, "layers": toolpath.layers,
                      "objects": len(toolpath.objects), "filament_mm": round(toolpath.filament_mm, 2)})  # fmt: skip
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--zoo", type=Path)
    parser.add_argument("--write", action="store_true")
    arguments = parser.parse_args()
    rows = []
    with tempfile.TemporaryDirectory() as name:
        folder, stl = Path(name), Path(name) / "cup.stl"
        model(stl)
        for slicer, slice_all in (("prusa-slicer", by_prusaslicer), ("slic3r", by_slic3r)):
            if shutil.which(slicer):
                rows += slice_all(folder, stl)
    figures: dict[str, Any] = {"files": rows}
    if arguments.zoo:
        figures["zoo"] = zoo(arguments.zoo)
    print(json.dumps(figures, indent=1))
    if arguments.write:
        save("slicers", "python benchmarks/slicers.py --write", "none", figures)
        put(ROOT / "docs" / "rendering.md", "slicers", as_table(rows))


def as_table(rows: list[dict[str, Any]]) -> str:
    lines = []
    for row in rows:
        said, found = row["filament_said_mm"], row["filament_mm"]
        percent = f"{100 * (found / said - 1):+.2f} %" if said else "–"
        lines.append(
            [row["slicer"], row["settings"], row["layers_said"] or "–", row["layers"], said or "–", found, percent]
        )
    head = ["slicer", "settings", "layers, as it says", "read", "filament, as it says, mm", "read, mm", "off by"]
    return table(head, [[str(cell) for cell in line] for line in lines])


if __name__ == "__main__":
    np.seterr(all="ignore")
    main()
