"""Makes the demo's job again: two small parts, sliced by PrusaSlicer. Run by hand; its result is part of the package.

python -m octoprint_moop.demo.make_job        (needs `prusa-slicer` on the path, and scipy)
"""

from __future__ import annotations

import gzip
import subprocess
import tempfile
from pathlib import Path

import numpy as np
import trimesh

from .run import JOB

BED_CENTRE_MM = (125.0, 105.0)

# Real files wait for the heat here (M109, M190); the virtual printer would take minutes over it.
START = r"M83\nM140 S60\nM104 S210\nG28\nG1 Z5 F5000\nG1 X10 Y3 F6000\nG1 Z0.3 F1000\nG1 X60 E6 F1000\nG1 X90 E9 F1000"
SETTINGS = {
    "bed_shape": "0x0,250x0,250x210,0x210", "nozzle_diameter": "0.4", "filament_diameter": "1.75",
    "layer_height": "0.3", "first_layer_height": "0.3", "perimeters": "2", "fill_density": "12%",
    "fill_pattern": "rectilinear", "top_solid_layers": "3", "bottom_solid_layers": "3", "skirts": "1",
    "skirt_distance": "4", "brim_width": "0", "seam_position": "aligned", "perimeter_speed": "60",
    "external_perimeter_speed": "50", "infill_speed": "80", "solid_infill_speed": "80", "top_solid_infill_speed": "60",
    "gap_fill_speed": "60", "first_layer_speed": "40", "travel_speed": "130", "cooling": "0", "temperature": "210",
    "first_layer_temperature": "210", "first_layer_bed_temperature": "60", "bed_temperature": "60",
    "retract_length": "0.8", "retract_lift": "0.2", "retract_layer_change": "1",
    "gcode_label_objects": "1", "resolution": "0.05",
    "use_relative_e_distances": "1", "gcode_flavor": "marlin2", "start_gcode": START,
    # The bed comes to where the camera looks, and the head goes out of the picture: the set-up of the paper.
    "layer_gcode": r"G92 E0\nG1 X0 Y200 F7800",
    "end_gcode": r"G1 E-2 F2400\nG1 X0 Y200 F7800\nM104 S0\nM140 S0\nM84",
}  # fmt: skip


def hull(*points_mm: tuple[float, float, float]) -> trimesh.Trimesh:
    return trimesh.convex.convex_hull(np.array(points_mm, dtype=float))


def tug() -> trimesh.Geometry:
    """A small tug boat, 34 x 14 x 20 mm: the slicer unites the bodies that overlap."""
    deck = [(-17, -5), (-17, 5), (-10, 7), (6, 7), (13, 4), (17, 0), (13, -4), (6, -7), (-10, -7)]
    keel = [(0.78 * x - 1, 0.72 * y) for x, y in deck]
    body = hull(*[(x, y, 0) for x, y in keel], *[(x, y, 7) for x, y in deck])
    cabin = hull(*[(x, y, 6) for x in (-6, 6) for y in (-5, 5)], *[(x, y, 14) for x in (-5, 5) for y in (-4.4, 4.4)])
    funnel = trimesh.creation.cylinder(2.6, segment=[(-1.5, 0, 13), (-1.5, 0, 20)], sections=32)
    bow = hull(*[(x, y, z) for x, y in ((9, 3.6), (9, -3.6), (16, 0.4), (16, -0.4)) for z in (6, 9.5)])
    return trimesh.util.concatenate([body, cabin, funnel, bow])


def bracket() -> trimesh.Geometry:
    """A shelf bracket, 22 x 16 x 20 mm: two plates and two gussets."""

    def box(x0: float, x1: float, y0: float, y1: float, z0: float, z1: float) -> trimesh.Trimesh:
        return hull(*[(x, y, z) for x in (x0, x1) for y in (y0, y1) for z in (z0, z1)])

    plates = [box(-11, 11, -8, 8, 0, 3), box(8, 11, -8, 8, 0, 20)]
    gussets = [
        hull(*[(x, y, z) for y in (y0, y0 + 2.4) for x, z in ((9, 2), (-9, 2), (-9, 4), (7, 17.5), (9, 17.5))])
        for y0 in (-8, 5.6)
    ]
    return trimesh.util.concatenate([*plates, *gussets])


def slice_job(folder: Path) -> bytes:
    """The G-code of both parts side by side on the bed's centre."""
    files = []
    for name, part, offset_mm in (("tug", tug(), (-19.0, 3.0)), ("bracket", bracket(), (17.0, -2.0))):
        part.apply_translation((BED_CENTRE_MM[0] + offset_mm[0], BED_CENTRE_MM[1] + offset_mm[1], 0))
        files.append(str(folder / f"{name}.stl"))
        part.export(files[-1])
    (folder / "profile.ini").write_text("".join(f"{key} = {value}\n" for key, value in SETTINGS.items()))
    command = ["prusa-slicer", "--export-gcode", "--load", str(folder / "profile.ini"), "--merge", "--dont-arrange"]
    subprocess.run([*command, "--output", str(folder / "job.gcode"), *files], check=True, stdout=subprocess.DEVNULL)
    return (folder / "job.gcode").read_bytes()


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        gcode = slice_job(Path(folder))
    JOB.write_bytes(gzip.compress(gcode, 9, mtime=0))
    print(f"{JOB.name}: {len(gcode)} bytes, {JOB.stat().st_size} packed")


if __name__ == "__main__":
    main()
