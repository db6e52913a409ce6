"""OFF: the Object File Format of Geomview, text only."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.errors import FileFormatError
from raystream.scene.io.colors import byte_colors_to_linear, srgb_to_linear
from raystream.scene.io.files import read_model_bytes
from raystream.scene.io.partial import faces_in_range, warn_partial
from raystream.scene.io.polygons import polygon_triangles
from raystream.scene.io.text import Lines, parse_floats, plain_text, shown
from raystream.scene.mesh import Mesh
from raystream.scene.scene import Scene

_KEYWORD = re.compile(rb"(ST)?(C)?(N)?(4)?(n)?OFF(?=[\s\d])")
_COMMENT = re.compile(rb"#[^\n]*")

#: Numbers of rows one after the other, and their count in each row.
_Table = tuple[NDArray[np.float64], NDArray[np.int64]]


def read_off(path: Path) -> Scene:
    """Read an OFF, COFF, NOFF or CNOFF file into a scene of one mesh.

    Polygons are cut into triangles, in file order; colours of faces are ignored.

    Parameters
    ----------
    path : Path
        An ``.off`` or ``.off.gz`` file.

    Returns
    -------
    Scene
        Vertex colours are interpreted as sRGB, integers as 0 .. 255, and stored as linear.

    Raises
    ------
    FileFormatError
        If the file cannot be read, is not OFF, or is truncated.

    Warns
    -----
    RaystreamWarning
        For triangles that were skipped, and for lines that the header does not declare.
    """
    text = _COMMENT.sub(b"", plain_text(read_model_bytes(path)))
    flags, body = _keyword(path, text)
    lines = Lines(plain_text(body))
    rows = np.flatnonzero(lines.word_counts)
    vertex_count, face_count, rows = _counts(path, lines, rows)
    least = 6 if "normal" in flags else 3
    try:
        points, polygons = _one_per_line(path, lines, rows, (vertex_count, face_count), least)
    except FileFormatError:
        widths = [least + 4, least + 3] if "color" in flags else [least]
        found = _many_per_line(path, lines, rows, (vertex_count, face_count), widths)
        if found is None:
            raise
        points, polygons = found
    vertices, normals, colors = _vertices(*points, flags)
    faces, face_ids = _faces(path, *polygons, vertices)
    good = faces_in_range(path, faces, vertex_count)
    mesh = Mesh(vertices, faces[good], normals=normals, colors=colors, face_ids=face_ids[good])
    return Scene([mesh], name=path.name)


def _keyword(path: Path, text: bytes) -> tuple[frozenset[str], bytes]:
    """Read the optional first word: the attributes of each vertex besides its position."""
    text = text.lstrip()
    match = _KEYWORD.match(text)
    if match is None:
        if text[:1].isdigit():
            return frozenset(), text
        raise FileFormatError(path, "is not an OFF file: it does not begin with 'OFF'")
    texture, color, normal, four, dimension = match.groups()
    if texture or four or dimension:
        raise FileFormatError(path, f"{shown(match.group())} files are not supported")
    body = text[match.end() :]
    if body.lstrip().startswith(b"BINARY"):
        raise FileFormatError(path, "binary OFF files are not supported")
    flags = {name for name, given in (("color", color), ("normal", normal)) if given}
    return frozenset(flags), body


def _counts(
    path: Path, lines: Lines, rows: NDArray[np.int64]
) -> tuple[int, int, NDArray[np.int64]]:
    words = lines.line(int(rows[0])).split() if len(rows) else []
    if len(words) < 2 or not all(word.isdigit() and len(word) < 19 for word in words[:2]):
        raise FileFormatError(path, "the OFF header lacks the numbers of vertices and faces")
    return int(words[0]), int(words[1]), rows[1:]


def _numbers(path: Path, lines: Lines, rows: NDArray[np.int64], least: int) -> _Table:
    """Parse the numbers of lines, and count them line by line."""
    counts = lines.word_counts[rows]
    if len(counts) and int(counts.min()) < least:
        row = int(rows[int(counts.argmin())])
        raise FileFormatError(path, f"expected {least} numbers in {shown(lines.line(row))}")
    selected = np.zeros(len(lines), bool)
    selected[rows] = True
    try:
        return parse_floats(lines.join(selected), int(counts.sum())), counts
    except ValueError:
        raise FileFormatError(path, "a value is not a number") from None


def _one_per_line(
    path: Path, lines: Lines, rows: NDArray[np.int64], counts: tuple[int, int], least: int
) -> tuple[_Table, _Table]:
    """Read vertices and faces, the first numbers of a line each."""
    vertex_count, face_count = counts
    if vertex_count + face_count > len(rows):
        raise FileFormatError(
            path,
            f"is truncated: the header declares {vertex_count:,} vertices and {face_count:,} "
            f"faces, but there are {len(rows):,} lines",
        )
    points = _numbers(path, lines, rows[:vertex_count], least)
    numbers, words = _numbers(path, lines, rows[vertex_count : vertex_count + face_count], 1)
    sizes = numbers[np.cumsum(words) - words]
    if not ((sizes >= 0) & (sizes == np.floor(sizes)) & (sizes < words)).all():
        raise FileFormatError(path, "a face has fewer corners than it declares")
    extra = len(rows) - vertex_count - face_count
    if extra:
        warn_partial(path, f"dropped: {extra:,} lines that the header does not declare")
    return points, (numbers, words)


def _many_per_line(
    path: Path, lines: Lines, rows: NDArray[np.int64], counts: tuple[int, int], widths: list[int]
) -> tuple[_Table, _Table] | None:
    """Read vertices, then faces, in lines of any length.

    None unless the vertices end at the end of a line, and the faces at the end of the file: so a
    truncated file is not taken for one of these.
    """
    vertex_count, face_count = counts
    numbers, words = _numbers(path, lines, rows, 1)
    ends = np.cumsum(words)
    for width in widths:
        begin = width * vertex_count
        if begin > len(numbers) or begin not in ends:
            continue
        polygons, position = [], begin
        while position < len(numbers) and 3 <= numbers[position] < len(numbers) - position:
            polygons.append(1 + int(numbers[position]))
            position += polygons[-1]
        if position == len(numbers) and len(polygons) == face_count:
            points = numbers[:begin], np.full(vertex_count, width)
            return points, (numbers[begin:], np.asarray(polygons, np.int64))
    return None


def _vertices(
    numbers: NDArray[np.float64], counts: NDArray[np.int64], flags: frozenset[str]
) -> tuple[NDArray[np.float64], NDArray[Any] | None, NDArray[np.float32] | None]:
    """Position, normal and colour, where the keyword announces them."""
    starts = (np.cumsum(counts) - counts)[:, None]
    vertices = numbers[starts + np.arange(3)]
    normals, least = None, 3
    if "normal" in flags:
        least = 6
        with np.errstate(over="ignore"):
            normals = numbers[starts + np.arange(3, 6)].astype(np.float32)
    if "color" not in flags or not len(counts) or int(counts.min()) < least + 3:
        return vertices, normals, None
    encoded = numbers[starts + np.arange(least, least + 3)]
    whole = bool((encoded == np.floor(encoded)).all() and encoded.max() > 1.0)
    return vertices, normals, byte_colors_to_linear(encoded) if whole else srgb_to_linear(encoded)


def _faces(
    path: Path,
    numbers: NDArray[np.float64],
    words: NDArray[np.int64],
    vertices: NDArray[Any],
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    starts = np.cumsum(words) - words
    counts = numbers[starts].astype(np.int64)
    whole = (numbers == np.floor(numbers)) & (np.abs(numbers) < 2.0**40)
    indices = np.where(whole, numbers, -1.0).astype(np.int64)
    corners, face_ids = polygon_triangles(path, counts, starts + 1, indices, vertices)
    return indices[corners], face_ids
