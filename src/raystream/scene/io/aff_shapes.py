"""AFF shapes: meshes, polygons, triangles, spheres and cones, tessellated."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.scene.io.aff_words import Words
from raystream.scene.io.partial import IndexCheck
from raystream.scene.io.polygons import cut_polygons, distinct_corners
from raystream.scene.mesh import Mesh

#: Slices of spheres and cones around their axis; spheres have half as many stacks from pole to
#: pole: the silhouette is then within 0.5 % of the radius.
SLICES = 32

Array = NDArray[np.float64]


@dataclass
class MorphingTriangle:
    """BART's ``tpa``: a triangle given at several times.

    Attributes
    ----------
    times : ndarray of shape (K,), float64
    corners : ndarray of shape (K, 3, 6), float64
        Position and normal of each corner at each time.
    """

    times: Array
    corners: Array

    def mesh(self, time: float) -> Mesh:
        """Interpolate linearly; constant before the first and after the last time."""
        flat = self.corners.reshape(len(self.times), -1)
        now = np.array([np.interp(time, self.times, column) for column in flat.T]).reshape(3, 6)
        return Mesh(now[:, :3], [[0, 1, 2]], normals=now[:, 3:])


@dataclass
class Shape:
    """A mesh, and the texture that the file names for it ("" for none)."""

    mesh: Mesh | MorphingTriangle
    texture: str = ""


def merged(shapes: list[Shape]) -> list[Shape]:
    """Merge consecutive shapes with the same texture and the same attributes.

    Files of polygons have one shape per polygon, which is a face; the order of triangles is
    preserved.
    """
    runs = groupby(shapes, key=_likeness)
    return [shape for _, run in runs for shape in _joined(list(run))]


def _likeness(shape: Shape) -> tuple[object, ...]:
    mesh = shape.mesh
    if isinstance(mesh, MorphingTriangle):
        return (shape.texture, None)
    return (shape.texture, mesh.normals is None, mesh.texcoords is None)


def _joined(run: list[Shape]) -> list[Shape]:
    meshes = [shape.mesh for shape in run if isinstance(shape.mesh, Mesh)]
    if len(meshes) < 2:
        return run
    firsts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes[:-1])])
    joined = Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([m.faces + first for m, first in zip(meshes, firsts, strict=True)]),
        normals=_all_of([mesh.normals for mesh in meshes]),
        texcoords=_all_of([mesh.texcoords for mesh in meshes]),
        face_ids=np.repeat(np.arange(len(meshes)), [mesh.triangle_count for mesh in meshes]),
    )
    return [Shape(joined, run[0].texture)]


def _all_of(parts: list[NDArray[np.float32] | None]) -> NDArray[np.float32] | None:
    there = [part for part in parts if part is not None]
    return np.concatenate(there) if len(there) == len(parts) else None


def read_shape(keyword: bytes, words: Words, checks: IndexCheck) -> Shape | None:
    """Read the shape of a keyword; None if the keyword is not a shape.

    Parameters
    ----------
    keyword : bytes
        The word just read.
    words : Words
        The words that follow.
    checks : IndexCheck
        Counts what is wrong with triangles and polygons.

    Raises
    ------
    FileFormatError
        If it is incomplete.
    """
    if keyword == b"m":
        return _mesh(words, checks)
    if keyword in (b"p", b"pp"):
        return _polygon(words, checks, with_normals=keyword == b"pp")
    if keyword in (b"tt", b"ttt", b"ttp"):
        return _textured_triangle(words, with_normals=keyword != b"tt")
    if keyword == b"tpa":
        return _morphing_triangle(words)
    if keyword == b"s":
        x, y, z, radius = words.floats(4)
        return Shape(sphere(np.array([x, y, z]), float(radius)))
    if keyword == b"c":
        ends = words.floats(8).reshape(2, 4)
        return Shape(cone(ends[0, :3], float(ends[0, 3]), ends[1, :3], float(ends[1, 3])))
    return None


def _mesh(words: Words, checks: IndexCheck) -> Shape:
    """Read ``vertices n .. [normals n ..] [texturecoords n name ..] triangles n ..``."""
    tables: list[NDArray[Any]] = []
    kinds: list[str] = []
    texture = ""
    words.expect(b"vertices")
    tables.append(words.floats(3 * words.count(3)).reshape(-1, 3))
    while words.peek() != b"triangles":
        kind = words.word()
        if kind == b"normals" and "normals" not in kinds and "texcoords" not in kinds:
            tables.append(words.floats(3 * words.count(3)).reshape(-1, 3))
            kinds.append("normals")
        elif kind == b"texturecoords" and "texcoords" not in kinds:
            count = words.count(2)
            texture = words.name()
            tables.append(words.floats(2 * count).reshape(-1, 2))
            kinds.append("texcoords")
        else:
            raise words.error("expected normals, texturecoords or triangles in a mesh")
    words.expect(b"triangles")
    count = words.count(3 * len(tables))
    rows = words.integers(count * 3 * len(tables)).reshape(count, len(tables), 3)
    return Shape(_indexed(rows, tables, kinds, checks), texture)


def _indexed(
    rows: NDArray[np.int64], tables: list[NDArray[Any]], kinds: list[str], checks: IndexCheck
) -> Mesh:
    """Combine the tables' indices into one per corner; attribute indices are clamped."""
    good = checks.usable(rows[:, 0], len(tables[0]))
    rows = rows[good]
    for place, table in enumerate(tables[1:], 1):
        rows[:, place] = np.clip(rows[:, place], 0, max(len(table) - 1, 0))
    indices = rows.transpose(0, 2, 1).reshape(-1, len(tables))
    kept, places = distinct_corners(indices)
    attributes: dict[str, Any] = {}
    for place, kind in enumerate(kinds, 1):
        if len(tables[place]):
            attributes[kind] = tables[place][indices[kept, place]]
    attributes["face_ids"] = np.flatnonzero(good)
    return Mesh(tables[0][indices[kept, 0]], places.reshape(-1, 3), **attributes)


def _polygon(words: Words, checks: IndexCheck, *, with_normals: bool) -> Shape:
    width = 6 if with_normals else 3
    count = words.count(width)
    rows = words.floats(count * width).reshape(count, width)
    points = rows[:, :3]
    cut = cut_polygons(np.array([count]), np.array([0]), np.arange(count), points)
    checks.crossed_count += cut.crossed_count
    normals = rows[:, 3:] if with_normals else None
    return Shape(Mesh(points, cut.corners, normals=normals, face_ids=cut.polygon_ids))


def _textured_triangle(words: Words, *, with_normals: bool) -> Shape:
    texture = words.name()
    width = 8 if with_normals else 5
    rows = words.floats(3 * width).reshape(3, width)
    normals = rows[:, 3:6] if with_normals else None
    return Shape(
        Mesh(rows[:, :3], [[0, 1, 2]], normals=normals, texcoords=rows[:, width - 2 :]), texture
    )


def _morphing_triangle(words: Words) -> Shape:
    count = words.count(19)
    if count == 0:
        raise words.error("an animated triangle has no keys")
    rows = words.floats(19 * count).reshape(count, 19)
    return Shape(MorphingTriangle(rows[:, 0], rows[:, 1:].reshape(count, 3, 6)))


def sphere(center: Array, radius: float) -> Mesh:
    """Tessellate a sphere; a negative radius turns it inside out."""
    stacks = SLICES // 2
    polar = np.linspace(0.0, math.pi, stacks + 1)[:, None]
    around = np.linspace(0.0, 2.0 * math.pi, SLICES + 1)[None, :-1]
    ring = np.sin(polar)
    parts = [ring * np.cos(around), np.cos(polar) + 0.0 * around, -ring * np.sin(around)]
    outward = np.stack(parts, axis=-1).reshape(-1, 3)
    faces = _grid_faces(stacks, SLICES)
    # The first row of upper and the last row of lower triangles collapse at the poles.
    upper = faces[:, 0].reshape(-1, 3)[SLICES:]
    lower = faces[:, 1].reshape(-1, 3)[:-SLICES]
    triangles = np.concatenate([upper, lower])
    with np.errstate(all="ignore"):
        vertices = center + abs(radius) * outward
    if radius < 0.0:
        return Mesh(vertices, triangles[:, [0, 2, 1]], normals=-outward)
    return Mesh(vertices, triangles, normals=outward)


def cone(base: Array, base_radius: float, apex: Array, apex_radius: float) -> Mesh:
    """Tessellate a cone or cylinder without caps; a negative radius turns it inside out."""
    inside = base_radius < 0.0 or apex_radius < 0.0
    base_radius, apex_radius = abs(base_radius), abs(apex_radius)
    with np.errstate(all="ignore"):
        axis = apex - base
        length = float(np.linalg.norm(axis))
        axis = axis / length if length > 0.0 else np.array([0.0, 0.0, 1.0])
        side = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
        side /= np.linalg.norm(side)
        angles = np.linspace(0.0, 2.0 * math.pi, SLICES + 1)[:-1, None]
        outward = np.cos(angles) * side + np.sin(angles) * np.cross(axis, side)
        vertices = np.concatenate([base + base_radius * outward, apex + apex_radius * outward])
        slope = (base_radius - apex_radius) / length if length > 0.0 else 0.0
        normals = np.tile(outward + slope * axis, (2, 1))
    faces = _grid_faces(1, SLICES).reshape(-1, 3)[:, [0, 2, 1]]
    kept = np.ones(len(faces), bool)
    kept[: 2 * SLICES : 2] = base_radius > 0.0
    kept[1 : 2 * SLICES : 2] = apex_radius > 0.0
    faces = faces[kept]
    return Mesh(
        vertices,
        faces[:, [0, 2, 1]] if inside else faces,
        normals=-normals if inside else normals,
    )


def _grid_faces(rows: int, columns: int) -> NDArray[np.int64]:
    """Triangulate a grid that wraps around its columns; shape (rows * columns, 2, 3).

    Triangles are counter-clockwise with rows going down and columns to the right. The first of
    a cell has two corners in the upper row, the second two in the lower.
    """
    row, column = np.divmod(np.arange(rows * columns), columns)
    right = (column + 1) % columns
    a, b = row * columns + column, row * columns + right
    c, d = a + columns, b + columns
    return np.stack([np.stack([a, d, b], axis=1), np.stack([a, c, d], axis=1)], axis=1)
