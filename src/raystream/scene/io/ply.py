"""PLY: the Stanford polygon format, text and binary."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.errors import FileFormatError
from raystream.scene.io.colors import byte_colors_to_linear, srgb_to_linear
from raystream.scene.io.files import read_model_bytes
from raystream.scene.io.partial import faces_in_range
from raystream.scene.io.ply_layout import Element, read_header
from raystream.scene.io.ply_values import Values, read_values
from raystream.scene.io.polygons import polygon_triangles
from raystream.scene.io.text import BYTE_ORDER_MARK
from raystream.scene.mesh import Mesh
from raystream.scene.scene import Scene

_INDEX_NAMES = ("vertex_indices", "vertex_index")
_TEXCOORD_NAMES = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"), ("texture_s", "texture_t"))


def read_ply(path: Path) -> Scene:
    """Read a PLY file into a scene of one mesh.

    Polygons are cut into triangles, in file order; triangle strips follow the faces, each triangle
    a face. Vertex properties x y z, nx ny nz, red green blue, and s t or u v are read.

    Parameters
    ----------
    path : Path
        A ``.ply`` or ``.ply.gz`` file.

    Returns
    -------
    Scene
        Vertex colours are interpreted as sRGB and stored as linear.

    Raises
    ------
    FileFormatError
        If the file cannot be read, is not PLY, or is truncated.

    Warns
    -----
    RaystreamWarning
        For triangles that were skipped.
    """
    content = read_model_bytes(path).removeprefix(BYTE_ORDER_MARK)
    encoding, elements, start = read_header(path, content)
    found = read_values(path, content, encoding, elements, start)
    vertex = found.get("vertex", Values())
    if not all(axis in vertex.scalars for axis in "xyz"):
        raise FileFormatError(path, "has no vertices with x, y and z")
    vertices = _stacked(vertex, ("x", "y", "z"))
    if vertices.dtype.kind != "f" or vertices.dtype.itemsize > 4:
        vertices = _narrowed(vertices, elements)
    faces, face_ids = _faces(path, found, vertices)
    good = faces_in_range(path, faces, len(vertices))
    mesh = Mesh(
        vertices,
        faces[good],
        face_ids=face_ids[good],
        normals=_optional(vertex, ("nx", "ny", "nz")),
        colors=_colors(vertex, elements),
        texcoords=next(
            (_optional(vertex, names) for names in _TEXCOORD_NAMES if names[0] in vertex.scalars),
            None,
        ),
    )
    return Scene([mesh], name=path.name)


def _stacked(vertex: Values, names: tuple[str, ...]) -> NDArray[Any]:
    return np.stack([vertex.scalars[name] for name in names], axis=1)


def _optional(vertex: Values, names: tuple[str, ...]) -> NDArray[np.float32] | None:
    if not all(name in vertex.scalars for name in names):
        return None
    with np.errstate(over="ignore", invalid="ignore"):
        return _stacked(vertex, names).astype(np.float32)


def _type_of(elements: list[Element], name: str) -> str:
    """Return the value type of a vertex property, from the header."""
    for element in elements:
        if element.name == "vertex":
            for prop in element.properties:
                if prop.name == name:
                    return prop.value_type
    return ""


def _narrowed(vertices: NDArray[Any], elements: list[Element]) -> NDArray[Any]:
    """Convert text, parsed as float64, to float32 if the header says so."""
    if all(_type_of(elements, axis) == "f4" for axis in "xyz"):
        with np.errstate(over="ignore"):
            return vertices.astype(np.float32)
    return vertices.astype(np.float64)


def _colors(vertex: Values, elements: list[Element]) -> NDArray[np.float32] | None:
    for names in (
        ("red", "green", "blue"),
        ("r", "g", "b"),
        ("diffuse_red", "diffuse_green", "diffuse_blue"),
    ):
        if all(name in vertex.scalars for name in names):
            colors = _stacked(vertex, names)
            kind = _type_of(elements, names[0])
            if kind in ("f4", "f8"):
                return srgb_to_linear(colors)
            scale = 257.0 if kind == "u2" else 1.0
            return byte_colors_to_linear(colors / scale if scale != 1.0 else colors)
    return None


def _indices(values: NDArray[Any]) -> NDArray[np.int64]:
    """Convert numbers to indices; invalid ones become -2."""
    if values.dtype.kind == "f":
        whole = (values == np.floor(values)) & (np.abs(values) < 2.0**40)
        return np.where(whole, values, -2.0).astype(np.int64)
    return values.astype(np.int64)


def _faces(
    path: Path, found: dict[str, Values], vertices: NDArray[Any]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The triangles of polygons, then those of strips, and the face of each."""
    polygons, face_ids, face_count = _polygons(path, found, vertices)
    strips = _strips(found)
    more = np.arange(face_count, face_count + len(strips))
    return np.concatenate([polygons, strips]), np.concatenate([face_ids, more])


def _polygons(
    path: Path, found: dict[str, Values], vertices: NDArray[Any]
) -> tuple[NDArray[np.int64], NDArray[np.int64], int]:
    """The triangles of polygons, the polygon of each, and the number of polygons."""
    lists = found.get("face", Values()).lists
    for name in _INDEX_NAMES:
        if name in lists:
            counts, values = lists[name]
            starts, indices = np.cumsum(counts) - counts, _indices(values)
            corners, face_ids = polygon_triangles(path, counts, starts, indices, vertices)
            return indices[corners], face_ids, len(counts)
    if lists:
        raise FileFormatError(path, f"its faces have no list {_INDEX_NAMES[0]}")
    return np.empty((0, 3), np.int64), np.empty(0, np.int64), 0


def _strips(found: dict[str, Values]) -> NDArray[np.int64]:
    """Cut triangle strips, separated by -1, into triangles; every other one is flipped."""
    lists = found.get("tristrips", Values()).lists
    for name in _INDEX_NAMES:
        if name in lists:
            counts, values = lists[name]
            indices = _indices(values)
            rows = np.repeat(np.arange(len(counts)), counts)
            return _strip_triangles(indices, rows)
    return np.empty((0, 3), np.int64)


def _strip_triangles(indices: NDArray[np.int64], rows: NDArray[np.int64]) -> NDArray[np.int64]:
    if len(indices) < 3:
        return np.empty((0, 3), np.int64)
    breaks = indices == -1
    fresh = np.concatenate([[True], (rows[1:] != rows[:-1]) | breaks[:-1]])
    strip = np.cumsum(fresh)
    first = np.maximum.accumulate(np.where(fresh, np.arange(len(indices)), 0))
    place = np.arange(len(indices)) - first
    whole = (strip[2:] == strip[:-2]) & ~(breaks[2:] | breaks[1:-1] | breaks[:-2])
    triangles = np.stack([indices[:-2], indices[1:-1], indices[2:]], axis=1)
    odd = place[:-2] % 2 == 1
    triangles[odd] = triangles[odd][:, [1, 0, 2]]
    return triangles[whole]
