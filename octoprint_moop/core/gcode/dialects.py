"""What slicers say in their comments: layers, features, widths and heights, objects, and what they used.

One table for all dialects; `gcode.py` moves the machine, this file only reads what is said. Comments arrive without
their semicolon. Known here: Cura, PrusaSlicer, SuperSlicer, OrcaSlicer, Bambu Studio, Slic3r, ideaMaker, Simplify3D,
KISSlicer, IceSL, Kiri:Moto and MatterSlice.
"""

from __future__ import annotations

import re
from functools import lru_cache
from typing import NamedTuple, Union

from ..toolpath import Role


class Layer(NamedTuple):
    """A new layer begins. `dialect` names the kind of comment: files may hold several kinds, of which one counts."""

    dialect: str


class Feature(NamedTuple):
    """What follows is for this purpose; `custom` is the user's own G-code, for which no stated width holds."""

    role: Role
    custom: bool = False


class Width(NamedTuple):
    mm: float


class Height(NamedTuple):
    mm: float


class Label(NamedTuple):
    """What follows belongs to the object `name`, or to none. `system` is the kind of label, see LABEL_SYSTEMS."""

    system: str
    name: str | None


class Slicer(NamedTuple):
    name: str


class Declared(NamedTuple):
    """A setting with which the file was sliced, see DECLARATIONS; or the filament that it needs, in mm."""

    setting: str
    values: tuple[float, ...]


Meaning = Union[Layer, Feature, Width, Height, Label, Slicer, Declared]

# Where a file holds several kinds of object labels, the first of these that labels any bead names the objects.
# Those that the firmware understands come first, except bare M486 numbers: comments have names for the same objects.
LABEL_SYSTEMS = ("exclude_object", "m486_named", "at_object", "comment", "printing", "mesh", "label_id", "m486")

_LAYERS = (
    ("layer_change", re.compile(r"\s*LAYER_CHANGE\b")),  # PrusaSlicer, SuperSlicer, OrcaSlicer
    ("layer_n", re.compile(r"\s*LAYER:\s*-?\d+\s*$")),  # Cura, ideaMaker, MatterSlice
    ("change_layer", re.compile(r"\s*CHANGE_LAYER\b")),  # Bambu Studio
    ("layer_z", re.compile(r"\s*layer \d+, Z ?=")),  # Simplify3D
    ("begin_layer", re.compile(r"\s*BEGIN_LAYER_OBJECT\b")),  # KISSlicer
    ("tag", re.compile(r"\s*<layer>")),  # IceSL
    ("dashes", re.compile(r";\s*--- layer \d+")),  # Kiri:Moto
)
_LAYER_HINT = re.compile("layer", re.IGNORECASE)

_ROLES = {
    Role.OUTER: "external perimeter|wall-outer|outer wall|outer perimeter|overhang perimeter|overhang wall"
    "|perimeter path|thin wall|external single extrusion",
    Role.INNER: "perimeter|internal perimeter|wall-inner|inner wall|inner perimeter|loop path"
    "|internal single extrusion",
    Role.INFILL: "internal infill|solid infill|internal solid infill|sparse infill|fill|solid-fill|infill|gap fill"
    "|gap infill|sparse infill path|stacked sparse infill path",
    Role.SURFACE: "top solid infill|top surface|bottom surface|bridge infill|internal bridge infill|bridge"
    "|internal bridge|ironing|skin|solid layer|solid path|travel/ironing path|crown path",
    Role.SUPPORT: "support|support material|support material interface|support interface|support-interface"
    "|support transition|dense support|support (may stack) path|support interface path",
    Role.BRIM: "skirt|brim|skirt/brim|raft|raft path",
    Role.TOWER: "wipe tower|prime tower|prime-tower|prime pillar|prime pillar path|purge path|ooze shield|custom",
}
ROLE_BY_NAME = {name: role for role, names in _ROLES.items() for name in names.split("|")}
_BARE = (  # Simplify3D 4.0 says the feature's name and nothing else
    "outer perimeter|inner perimeter|external single extrusion|internal single extrusion|infill|solid layer|gap fill"
    "|skirt|support|dense support|raft|bridge|prime pillar|ooze shield"
)
_BARE_FEATURES = frozenset(_BARE.split("|"))
_FEATURE = re.compile(r"\s*(?:TYPE:|FEATURE:|feature )\s*(.+?)\s*$")
_PATH = re.compile(r"\s*'([^']+ Path)'")  # KISSlicer

_NUMBER = r"([-+]?\d*\.?\d+)"
_WIDTH = re.compile(r"\s*(?:LINE_)?WIDTH:\s*" + _NUMBER)
_HEIGHT = re.compile(r"\s*(?:LAYER_)?HEIGHT:\s*" + _NUMBER)
_TOOL = re.compile(r"\s*tool H" + _NUMBER + r" W" + _NUMBER)  # Simplify3D
_THICKNESS = re.compile(r".*\bz_thickness=" + _NUMBER)  # KISSlicer

_PRINTING = re.compile(r"\s*(?:INIT )?(stop )?printing object,? (?!unique label)(.+?)\s*$")
_LABEL_ID = re.compile(r"\s*(start|stop) printing object, unique label id: (\S+)")
_OBJECT_ID = re.compile(r"\s*OBJECT_ID: (\S+)")

_SLICER = re.compile(
    r"(?:.*\b(?:generated|sliced)\s+(?:by|with)\s+|\s*(?=KISSlicer|BambuStudio)|\s*<(?=IceSL))"
    r"(\S.*?)(?:\s+(?:on\s+\d|\(|- ).*|[,>].*)?$",
    re.IGNORECASE,
)
_SLICER_HINT = re.compile(r"generated|sliced|KISSlicer|BambuStudio|IceSL", re.IGNORECASE)

_DECLARED = re.compile(r"\s*([A-Za-z][\w #]*?)\s*[=:,]\s*" + _NUMBER)
# "filament used [mm] = 12.3, 4.5", "Filament used: 1.2m", "filament used = 12.3mm (0.1cm3)",
# "Filament length: 12.3 mm", "Material#1 Used: 12.3", "Ext #1  =   12.3 mm", "--- filament used: 12.3 mm"
_FILAMENT = re.compile(
    r"[-\s]*(?:(?:total )?filament (?:used|length)(?: \[mm\])?|Material#1 Used|\s*Ext #1)\s*[:=]\s*"
    r"((?:[\d.]+(?:mm)?,\s*)*[\d.]+)\s*(mm?\b)?(?!\d*\s*cm)",
    re.IGNORECASE,
)
DECLARATIONS = {  # words of the settings that slicers append: what they mean here
    "filament_diameter": "filament_mm", "filamentdiameters": "filament_mm", "filament_diameter_mm_0": "filament_mm",
    "filament diameter #1": "filament_mm", "filamentdiameter": "filament_mm", "fiber_dia_mm": "filament_mm",
    "layer_height": "layer_height_mm", "layerheight": "layer_height_mm", "layer height": "layer_height_mm",
    "z_layer_height_mm": "layer_height_mm", "sliceheight": "layer_height_mm", "layerthickness": "layer_height_mm",
    "use_volumetric_e": "volumetric_e", "filament compensation #1": "compensation_percent",
}  # fmt: skip


@lru_cache(maxsize=4096)
def meaning(comment: str) -> tuple[Meaning, ...]:
    """What a comment (the text after the semicolon) says; empty where it says nothing that matters."""
    text = comment[:200].rstrip()
    if text.startswith("WIDTH:"):
        found = _WIDTH.match(text)
        return (Width(float(found.group(1))),) if found else ()
    if _LAYER_HINT.search(text):
        for dialect, pattern in _LAYERS:
            if pattern.match(text):
                thickness = _THICKNESS.match(text)
                said: tuple[Meaning, ...] = (Layer(dialect),)
                return (*said, Height(float(thickness.group(1)))) if thickness else said
    found = _WIDTH.match(text)
    if found:
        return (Width(float(found.group(1))),)
    found = _HEIGHT.match(text)
    if found:
        return (Height(float(found.group(1))),)
    found = _FEATURE.match(text) or _PATH.match(text)
    name = found.group(1).lower() if found else text.strip().lower()
    if found or name in _BARE_FEATURES:
        return (Feature(ROLE_BY_NAME.get(name, Role.OUTER), name == "custom"),)
    found = _TOOL.match(text)
    if found:
        return (Height(float(found.group(1))), Width(float(found.group(2))))
    return _label(text) or _about_the_file(text)


def _label(text: str) -> tuple[Meaning, ...]:
    if text.startswith("MESH:"):  # Cura; what belongs to no mesh is called NONMESH
        name = text[5:].strip()
        return (Label("mesh", None if name == "NONMESH" else name),)
    if text.startswith("PRINTING:"):  # ideaMaker
        name = text[9:].strip()
        return (Label("printing", None if name == "NON-OBJECT" else name),)
    found = _LABEL_ID.match(text)
    if found:
        return (Label("label_id", f"object {found.group(2)}" if found.group(1) == "start" else None),)
    found = _OBJECT_ID.match(text)
    if found:
        return (Label("label_id", f"object {found.group(1)}"),)
    found = _PRINTING.match(text)
    if found:
        return (Label("comment", None if found.group(1) else found.group(2)),)
    return ()


def _about_the_file(text: str) -> tuple[Meaning, ...]:
    found = _FILAMENT.match(text)
    if found:
        scale = {"m": 1000.0, "": 1.0, "mm": 1.0}.get(found.group(2) or "")
        if scale is not None:
            return (Declared("filament_used_mm", tuple(scale * float(n) for n in re.findall(_NUMBER, found.group(1)))),)
    found = _DECLARED.match(text)
    if found:
        setting = DECLARATIONS.get(found.group(1).lower())
        if setting:
            return (Declared(setting, (float(found.group(2)),)),)
    if _SLICER_HINT.search(text):
        found = _SLICER.match(text)
        if found:
            return (Slicer(found.group(1).strip()),)
    return ()


def outside_parentheses(code: str) -> str:
    """Code without its comments in parentheses; one that is not closed stays."""
    if "(" not in code:
        return code
    kept: list[str] = []
    rest = code
    while True:
        before, opened, after = rest.partition("(")
        _, closed, behind = after.partition(")")
        if not (opened and closed):
            return " ".join([*kept, rest])
        kept.append(before)
        rest = behind
