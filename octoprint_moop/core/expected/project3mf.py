"""Reads the surfaces in a 3MF file (3MF core specification 1.3, with the production extension's split files).

trimesh's own reader needs lxml and networkx, two packages that a printer's computer would carry for this alone.
"""

from __future__ import annotations

import posixpath
import zipfile
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from ..errors import MeshError

MILLIMETRES = {"micron": 0.001, "millimeter": 1.0, "centimeter": 10.0, "inch": 25.4, "foot": 304.8, "meter": 1000.0}
MOST_BYTES = 1 << 30
DEEPEST = 16
CORE = "{http://schemas.microsoft.com/3dmanufacturing/core/2015/02}"
PRODUCTION = "{http://schemas.microsoft.com/3dmanufacturing/production/2015/06}"
RELATION = "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"


def read_3mf(path: Path) -> np.ndarray:
    """(N, 3, 3) float64: the triangles of everything that stands on the build plate, in millimetres.

    Raises MeshError where the file is no 3MF or refers to what is not there.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            parts = list(_Project(archive).build())
    except zipfile.BadZipFile:
        raise MeshError(f"{path.name}: is not a 3MF file. Export the model again, or as STL.") from None
    except (KeyError, ValueError, IndexError, TypeError, ElementTree.ParseError, NotImplementedError) as error:
        raise MeshError(
            f"{path.name}: is not a complete 3MF file ({error}). Export the model again, or as STL."
        ) from None
    if not parts:
        raise MeshError(f"{path.name}: nothing stands on its build plate.")
    return np.concatenate(parts)


class _Project:
    def __init__(self, archive: zipfile.ZipFile) -> None:
        self._archive = archive
        self._models: dict[str, ElementTree.Element] = {}

    def build(self) -> Iterator[np.ndarray]:
        root = self._root_part()
        model = self._model(root)
        scale = MILLIMETRES[model.get("unit", "millimeter")]
        for item in model.iterfind(f"{CORE}build/{CORE}item"):
            if item.get("printable", "1") != "0":
                yield from (
                    scale * part for part in self._object(_part(item, root), item.attrib["objectid"], _matrix(item), 0)
                )

    def _root_part(self) -> str:
        relations = ElementTree.fromstring(self._read("_rels/.rels"))
        for relation in relations:
            if relation.get("Type") == RELATION:
                return relation.attrib["Target"].lstrip("/")
        raise ValueError("no model is named in it")

    def _read(self, part: str) -> bytes:
        if self._archive.getinfo(part).file_size > MOST_BYTES:
            raise ValueError(f"{part} is larger than {MOST_BYTES >> 20} MiB")
        return self._archive.read(part)

    def _model(self, part: str) -> ElementTree.Element:
        if part not in self._models:
            self._models[part] = ElementTree.fromstring(self._read(part))
        return self._models[part]

    def _object(self, part: str, number: str, matrix: np.ndarray, depth: int) -> Iterator[np.ndarray]:
        if depth > DEEPEST:
            raise ValueError("its objects contain one another")
        for found in self._model(part).iterfind(f"{CORE}resources/{CORE}object"):
            if found.get("id") == number:
                break
        else:
            raise ValueError(f"object {number} is missing")
        if found.get("type", "model") not in ("model", "solidsupport"):
            return
        mesh = found.find(f"{CORE}mesh")
        if mesh is not None:
            yield _triangles(mesh) @ matrix[:3] + matrix[3]
        for component in found.iterfind(f"{CORE}components/{CORE}component"):
            inner = _matrix(component)
            combined = np.vstack([inner[:3] @ matrix[:3], inner[3] @ matrix[:3] + matrix[3]])
            yield from self._object(_part(component, part), component.attrib["objectid"], combined, depth + 1)


def _part(element: ElementTree.Element, own: str) -> str:
    other = element.get(f"{PRODUCTION}path")
    return own if other is None else posixpath.normpath(other.lstrip("/"))


def _matrix(element: ElementTree.Element) -> np.ndarray:
    """(4, 3) float64: a row vector's rotation and, in the last row, its shift."""
    text = element.get("transform")
    if text is None:
        return np.vstack([np.eye(3), np.zeros(3)])
    return np.array([float(number) for number in text.split()]).reshape(4, 3)


def _triangles(mesh: ElementTree.Element) -> np.ndarray:
    vertices = mesh.find(f"{CORE}vertices")
    triangles = mesh.find(f"{CORE}triangles")
    if vertices is None or triangles is None:
        return np.empty((0, 3, 3))
    places = np.array([[float(v.attrib[axis]) for axis in "xyz"] for v in vertices]).reshape(-1, 3)
    corners = np.array([[int(t.attrib[name]) for name in ("v1", "v2", "v3")] for t in triangles]).reshape(-1, 3)
    if len(corners) and corners.min() < 0:
        raise ValueError("a triangle has a negative corner")
    return places[corners]
