"""Corners of OBJ faces: resolved indices, triangulated polygons, shared vertices."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.errors import FileFormatError
from raystream.scene.io.partial import faces_in_range, warn_partial
from raystream.scene.io.polygons import distinct_corners, polygon_triangles
from raystream.scene.io.text import Lines, parse_integers, shown

_SLASH = ord("/")

#: Instead of an index: not written, or out of range.
_ABSENT, _MISSING = -1, -2


@dataclass
class Corners:
    """The usable triangles of a file, in file order, or sorted by part.

    Attributes
    ----------
    vertex_count : int
        Vertices in the file.
    indices : ndarray of shape (F, 3, 3), int64
        For each corner: indices of vertex, texture coordinate (-1: none) and normal.
    lines : ndarray of shape (F,), int64
        The line of each triangle, non-decreasing in file order.
    face_ids : ndarray of shape (F,), int64
        The face of each triangle, numbered over the file, or within its part.
    face_lines : ndarray of shape (P,), int64
        The line of each face, those without triangles among them.
    texcoords, normals : ndarray of shape (T, 2) and (N, 3), float32
        `normals` also has face normals of triangles without normals in the file.
    has_texcoords, has_normals : bool
        Whether any corner has one.
    """

    vertex_count: int
    indices: NDArray[np.int64]
    lines: NDArray[np.int64]
    face_ids: NDArray[np.int64]
    face_lines: NDArray[np.int64]
    texcoords: NDArray[np.float32]
    normals: NDArray[np.float32]
    has_texcoords: bool
    has_normals: bool

    def reordered(self, order: NDArray[np.int64]) -> Corners:
        """The same triangles in another order."""
        return replace(
            self,
            indices=self.indices[order],
            lines=self.lines[order],
            face_ids=self.face_ids[order],
        )

    def numbered_within(self, part_of_face: NDArray[np.int64]) -> Corners:
        """The same triangles, with faces numbered within their parts, in file order."""
        order = np.argsort(part_of_face, kind="stable")
        begins = np.flatnonzero(np.diff(part_of_face[order], prepend=-2))
        counts = np.diff(begins, append=len(order))
        numbers = np.empty_like(order)
        numbers[order] = np.arange(len(order)) - np.repeat(begins, counts)
        return replace(self, face_ids=numbers[self.face_ids])

    def texcoords_of(self, rows: NDArray[np.int64]) -> NDArray[np.float32]:
        """Look up texture coordinates; (0, 0) for corners without."""
        return np.where(rows[:, None] >= 0, self.texcoords[rows], np.float32(0.0))

    def shared(
        self, cuts: NDArray[np.int64]
    ) -> tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.int64]]:
        """Find the distinct corners of each part.

        Parameters
        ----------
        cuts : ndarray of shape (P + 1,), int64
            First triangle of each part, none of which is empty, and the end.

        Returns
        -------
        used : ndarray of shape (V, 3), int64
            Vertex, texture coordinate and normal of each vertex of the meshes: of one part after
            the other, sorted by vertex.
        faces : ndarray of shape (F, 3), int32
            Within the part.
        starts : ndarray of shape (P + 1,), int64
            First vertex of each part, and the end.
        """
        count = self.vertex_count
        if len(cuts) == 2 and not self.has_texcoords and not self.has_normals:
            used = np.zeros((count, 3), np.int64)
            used[:, 0] = np.arange(count)
            return used, self.indices[:, :, 0].astype(np.int32), np.array([0, count])
        # The vertices that a part may use are numbered after those of the parts before.
        keys = self.indices[:, :, 0].reshape(-1)
        low = np.minimum.reduceat(keys, 3 * cuts[:-1])
        high = np.maximum.reduceat(keys, 3 * cuts[:-1])
        shifts = np.cumsum(high - low + 1) - high - 1
        triangle_counts = np.diff(cuts)
        keys = keys + np.repeat(shifts, 3 * triangle_counts)
        indices = self.indices.reshape(-1, 3)
        width = 3 if self.has_normals else 2 if self.has_texcoords else 1
        rows, places = distinct_corners(indices[:, :width], keys)
        starts = np.searchsorted(keys[rows], low + shifts)
        faces = places.reshape(-1, 3) - np.repeat(starts, triangle_counts)[:, None]
        return indices[rows], faces.astype(np.int32), np.append(starts, len(rows))


def read_corners(
    path: Path,
    lines: Lines,
    is_face: NDArray[np.bool_],
    seen: list[NDArray[np.int64]],
    tables: tuple[NDArray[Any], NDArray[np.float32], NDArray[np.float32]],
) -> Corners:
    """Read the ``f`` lines.

    Parameters
    ----------
    path : Path
        The file, for messages.
    lines : Lines
        All lines.
    is_face : ndarray of shape (L,), bool
        Which lines are faces.
    seen : list of 3 ndarrays of shape (L,), int64
        Numbers of v, vt and vn lines up to each line, for relative indices.
    tables : tuple of 3 ndarrays
        Vertices, texture coordinates, normals.

    Returns
    -------
    Corners

    Raises
    ------
    FileFormatError
        If an index is not a number, or no triangle is usable.
    """
    vertices, texcoords, normals = tables
    face_lines = np.flatnonzero(is_face)
    counts = lines.word_counts[face_lines] - 1
    corners = _corner_indices(path, lines, is_face, counts)
    line_of_corner = np.repeat(face_lines, counts)
    for column, (rows, table) in enumerate(zip(seen, tables, strict=True)):
        corners[:, column] = _resolved(corners[:, column], rows[line_of_corner], len(table))

    too_few = int(np.count_nonzero(counts < 3))
    if too_few:
        warn_partial(path, f"skipped {too_few:,} faces with fewer than three corners")
    begins = np.cumsum(counts) - counts
    fans, face_ids = polygon_triangles(path, counts, begins, corners[:, 0], vertices)
    triangles = corners[fans]
    good = faces_in_range(path, triangles[:, :, 0], len(vertices))
    triangles, face_ids = triangles[good], face_ids[good]
    _forget_missing(path, triangles)

    has_normals = bool((triangles[:, :, 2] >= 0).any())
    if has_normals:
        normals = _with_face_normals(triangles, vertices, normals)
    has_texcoords = bool((triangles[:, :, 1] >= 0).any())
    return Corners(
        len(vertices),
        triangles,
        face_lines[face_ids],
        face_ids,
        face_lines,
        texcoords,
        normals,
        has_texcoords,
        has_normals,
    )


def _corner_indices(
    path: Path, lines: Lines, is_face: NDArray[np.bool_], counts: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Parse ``v``, ``v/vt``, ``v//vn`` and ``v/vt/vn``; shape (C, 3), as written, 0: none."""
    text = lines.join(is_face)
    if text.count(b"f") != len(counts):  # an f elsewhere than at the start of a line
        raise _bad_face(path, lines, is_face)
    if b"fo" in text:
        text = text.replace(b"fo", b"f ")
    text = text.replace(b"f", b" ")
    if b"//" in text:
        text = text.replace(b"//", b"/0/")
    if b"/ " in text or b"/\n" in text:
        text = text.replace(b"/ ", b" ").replace(b"/\n", b"\n")
    letters = np.frombuffer(text, np.uint8)
    filled = letters > 32
    begins = filled.copy()
    begins[1:] &= ~filled[:-1]
    slashes = np.flatnonzero(letters == _SLASH)
    slashes_before = np.searchsorted(slashes, np.flatnonzero(begins))
    widths = np.diff(slashes_before, append=len(slashes)) + 1
    try:
        if len(widths) != int(counts.sum()) or (len(widths) and int(widths.max()) > 3):
            raise ValueError("too many parts")
        numbers = parse_integers(text.replace(b"/", b" "), int(widths.sum()))
    except ValueError:
        raise _bad_face(path, lines, is_face) from None
    offsets = np.cumsum(widths) - widths
    corners = np.zeros((len(widths), 3), np.int64)
    corners[:, 0] = numbers[offsets]
    for column in (1, 2):
        there = widths > column
        corners[there, column] = numbers[offsets[there] + column]
    return corners


def _bad_face(path: Path, lines: Lines, is_face: NDArray[np.bool_]) -> FileFormatError:
    for index in np.flatnonzero(is_face).tolist():
        line = lines.line(index)
        for word in line.split()[1:]:
            parts = word.split(b"/")
            number = [part.removeprefix(b"-").removeprefix(b"+").isdigit() for part in parts]
            empty = [part == b"" for part in parts]
            if len(parts) > 3 or not all(n or e for n, e in zip(number, empty, strict=True)):
                return FileFormatError(path, f"cannot read the face {shown(line)}")
            if not number[0]:
                return FileFormatError(path, f"a corner has no vertex in {shown(line)}")
    return FileFormatError(path, "cannot read its faces")


def _resolved(
    written: NDArray[np.int64], seen: NDArray[np.int64], table_length: int
) -> NDArray[np.int64]:
    """Convert indices from 1, or relative to the line, to indices from 0.

    `_ABSENT` if not written, `_MISSING` if out of range.
    """
    limit = table_length + 1
    bounded = np.clip(written, -limit, limit)  # prevents overflow
    rows = np.where(bounded > 0, bounded - 1, bounded + seen)
    bad = (rows < 0) | (rows >= table_length)
    return np.where(bounded == 0, _ABSENT, np.where(bad, _MISSING, rows))


def _forget_missing(path: Path, triangles: NDArray[np.int64]) -> None:
    """Remove references to texture coordinates and normals that do not exist."""
    bad = triangles[:, :, 1:] == _MISSING
    count = int(np.count_nonzero(bad))
    if count:
        warn_partial(
            path,
            f"{count:,} corners refer to texture coordinates or normals that do not exist",
        )
        triangles[:, :, 1:][bad] = _ABSENT


def _with_face_normals(
    triangles: NDArray[np.int64], vertices: NDArray[Any], normals: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Give triangles that lack a normal their face normal, appended to the table."""
    lacking = np.flatnonzero((triangles[:, :, 2] < 0).any(axis=1))
    if len(lacking) == 0:
        return normals
    points = vertices[triangles[lacking, :, 0]]
    with np.errstate(all="ignore"):
        made = np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0])
        made /= np.linalg.norm(made, axis=1)[:, None]
    own = len(normals) + np.arange(len(lacking))
    part = triangles[lacking, :, 2]
    triangles[lacking, :, 2] = np.where(part < 0, own[:, None], part)
    return np.concatenate([normals, np.nan_to_num(made).astype(np.float32)])
