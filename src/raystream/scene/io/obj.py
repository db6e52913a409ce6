"""OBJ: Wavefront's text format, parsed with array operations; materials are in `mtl`."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from raystream.core.errors import FileFormatError
from raystream.scene.io.colors import srgb_to_linear
from raystream.scene.io.files import find_sibling, read_model_bytes
from raystream.scene.io.mtl import read_mtl
from raystream.scene.io.obj_corners import Corners, read_corners
from raystream.scene.io.partial import warn_partial
from raystream.scene.io.text import Lines, decoded, parse_floats, plain_text, shown
from raystream.scene.material import Material
from raystream.scene.mesh import Mesh
from raystream.scene.scene import Scene

#: A file with more objects becomes one mesh: a mesh costs far more than a triangle.
MAX_OBJECTS = 10_000

_CONTINUED = re.compile(rb"\\ *\n")

#: NaN and infinity as written by older C libraries on Windows: ``-1.#IND``.
_NOT_FINITE = re.compile(rb"-?1\.#(?:IND|INF|QNAN|SNAN)\d*")

#: Statements that distinguish an OBJ file without vertices from another format.
_KNOWN_WORDS = frozenset({b"g", b"o", b"mtllib", b"usemtl"})


def read_obj(path: Path) -> Scene:
    """Read an OBJ file and its MTL files.

    Triangles keep the file's order; polygons are cut into triangles. There is one mesh per ``o``
    object, else one for the whole file; groups are ignored. Vertices with several normals or
    texture coordinates are duplicated. Lines, points, curves and smoothing groups are skipped.

    Parameters
    ----------
    path : Path
        An ``.obj`` or ``.obj.gz`` file.

    Returns
    -------
    Scene
        Vertex colours (``v x y z r g b``) are interpreted as sRGB and stored as linear.

    Raises
    ------
    FileFormatError
        If the file cannot be read or a line is invalid.

    Warns
    -----
    RaystreamWarning
        For triangles, material libraries and textures that were skipped.
    """
    text = plain_text(read_model_bytes(path))
    if b"\\" in text:
        text = _CONTINUED.sub(b" ", text)
    if b".#" in text:
        text = _NOT_FINITE.sub(b"nan", text)
    lines = Lines(_without_comments(text))
    kinds = _line_kinds(lines)
    vertices, colors = _vertex_table(path, lines, kinds == _VERTEX)
    texcoords = _table(path, lines, kinds == _TEXCOORD, 2)
    normals = _table(path, lines, kinds == _NORMAL, 3)
    corners = read_corners(
        path,
        lines,
        kinds == _FACE,
        [np.cumsum(kinds == kind) for kind in (_VERTEX, _TEXCOORD, _NORMAL)],
        (vertices, texcoords, normals),
    )
    sections = _sections(lines, kinds)
    if sections.strange and not len(vertices):
        raise FileFormatError(path, "is not an OBJ file: it has no OBJ statement")
    materials, material_ids = _materials(path, sections, corners)
    meshes = _meshes(corners, vertices, colors, material_ids, sections)
    return Scene(meshes, materials=materials, name=path.name)


_VERTEX, _TEXCOORD, _NORMAL, _FACE, _STATEMENT = 1, 2, 3, 4, 5


def _without_comments(text: bytes) -> bytes:
    """Blank trailing comments; ``#`` inside a word is a letter."""
    letters = np.frombuffer(text, np.uint8)
    marks = np.flatnonzero(letters == ord("#"))
    marks = marks[(marks > 0) & (letters[marks - 1] == 32)]
    if len(marks) == 0:
        return text
    cleaned = bytearray(text)
    for mark in marks.tolist():
        if cleaned[mark] == ord("#"):
            end = text.index(b"\n", mark)
            cleaned[mark:end] = b" " * (end - mark)
    return bytes(cleaned)


def _line_kinds(lines: Lines) -> NDArray[np.int8]:
    """Classify lines by their first word; 0 is ignored."""
    letters = np.frombuffer(lines.text + b"\n\n", np.uint8)
    first, second, third = (letters[lines.starts + i] for i in range(3))
    kinds = np.full(len(lines), _STATEMENT, np.int8)
    kinds[(lines.word_counts == 0) | (first == ord("#"))] = 0
    short, long = second <= 32, third <= 32
    kinds[(first == ord("v")) & short] = _VERTEX
    kinds[(first == ord("v")) & (second == ord("t")) & long] = _TEXCOORD
    kinds[(first == ord("v")) & (second == ord("n")) & long] = _NORMAL
    kinds[((first == ord("f")) & short) | ((first == ord("f")) & (second == ord("o")) & long)] = (
        _FACE
    )
    for letter in b"slp":  # smoothing groups, lines, points
        kinds[(first == letter) & short] = 0
    return kinds


def _rows(
    path: Path, lines: Lines, selected: NDArray[np.bool_], least: int
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
    """Parse the numbers of lines: all numbers, and each line's start and count."""
    counts = lines.word_counts[selected] - 1
    _require_words(path, lines, selected, counts, least)
    text = lines.join(selected)
    for word in (b"vt", b"vn", b"v"):
        if text.startswith(word):
            # Numbers contain no v; an n is blanked only after a v, so "nan" is preserved.
            text = text.replace(word, b" " * len(word))
            break
    try:
        numbers = parse_floats(text, int(counts.sum()))
    except ValueError:
        raise _bad_line(path, lines, selected) from None
    return numbers, np.cumsum(counts) - counts, counts


def _require_words(
    path: Path,
    lines: Lines,
    selected: NDArray[np.bool_],
    counts: NDArray[np.int64],
    least: int,
) -> None:
    if len(counts) and int(counts.min()) < least:
        index = int(np.flatnonzero(selected)[int(counts.argmin())])
        raise FileFormatError(path, f"expected {least} numbers in {shown(lines.line(index))}")


def _bad_line(path: Path, lines: Lines, selected: NDArray[np.bool_]) -> FileFormatError:
    """Find the line with an invalid number, and make the error that quotes it."""
    for index in np.flatnonzero(selected).tolist():
        line = lines.line(index)
        words = line.split()[1:]
        try:
            parse_floats(b" ".join(words), len(words))
        except ValueError:
            return FileFormatError(path, f"cannot read the numbers in {shown(line)}")
    return FileFormatError(path, "cannot read its numbers")


def _table(
    path: Path, lines: Lines, selected: NDArray[np.bool_], width: int
) -> NDArray[np.float32]:
    """Read texture coordinates or normals; the v of a texture coordinate is optional."""
    numbers, begins, counts = _rows(path, lines, selected, min(width, 1 if width == 2 else 3))
    table = np.zeros((len(counts), width), np.float32)
    with np.errstate(over="ignore"):
        for column in range(width):
            there = counts > column
            table[there, column] = numbers[begins[there] + column]
    return table


def _vertex_table(
    path: Path, lines: Lines, selected: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], NDArray[np.float32] | None]:
    numbers, begins, counts = _rows(path, lines, selected, 3)
    vertices = numbers[begins[:, None] + np.arange(3)]
    colored = counts >= 6
    if not colored.any():
        return vertices, None
    colors = np.ones((len(counts), 3), np.float32)
    colors[colored] = srgb_to_linear(numbers[begins[colored][:, None] + np.arange(3, 6)])
    return vertices, colors


@dataclass
class _Sections:
    """First lines of materials and objects; `strange` if there is no OBJ statement."""

    libraries: list[str] = field(default_factory=list)
    material_lines: list[int] = field(default_factory=list)
    material_names: list[str] = field(default_factory=list)
    object_lines: list[int] = field(default_factory=list)
    object_names: list[str] = field(default_factory=list)
    strange: bool = False


def _sections(lines: Lines, kinds: NDArray[np.int8]) -> _Sections:
    sections = _Sections()
    words = set()
    for index in np.flatnonzero(kinds == _STATEMENT).tolist():
        word, _, rest = lines.line(index).partition(b" ")
        words.add(word)
        name = decoded(rest.strip())
        if word == b"usemtl":
            sections.material_lines.append(index)
            sections.material_names.append(name)
        elif word == b"o":
            sections.object_lines.append(index)
            sections.object_names.append(name)
        elif word == b"mtllib":
            sections.libraries.append(name)
    sections.strange = len(words) > 0 and not words & _KNOWN_WORDS
    return sections


def _materials(
    path: Path, sections: _Sections, corners: Corners
) -> tuple[list[Material], NDArray[np.int32]]:
    """Return the materials in order of first use, and each triangle's index."""
    known = _read_libraries(path, sections.libraries)
    names = [*sections.material_names, ""]
    spans = np.searchsorted(np.asarray(sections.material_lines, np.int64), corners.lines) - 1
    places: dict[str, int] = {}
    missing: list[str] = []
    materials: list[Material] = []
    place_of_span = np.zeros(len(names), np.int32)
    for span in np.unique(spans).tolist():  # -1, before the first usemtl, is names' last
        name = names[span]
        if name not in places:
            places[name] = len(materials)
            materials.append(known.get(name, Material(name=name)))
            if name and name not in known:
                missing.append(name)
        place_of_span[span] = places[name]
    if missing and known:
        warn_partial(path, f"undefined materials: {_listed(missing)}")
    return materials, place_of_span[spans]


def _read_libraries(path: Path, names: list[str]) -> dict[str, Material]:
    """Read the libraries; a name may contain spaces, or be several names."""
    known: dict[str, Material] = {}
    missing: list[str] = []
    for name in dict.fromkeys(names):
        whole = find_sibling(path, name)
        found = [(name, whole)] if whole else [(n, find_sibling(path, n)) for n in name.split()]
        if not any(library for _, library in found):
            missing.append(name)
            continue
        for part, library in found:
            if library is None:
                missing.append(part)
                continue
            try:
                known = {**read_mtl(library), **known}
            except FileFormatError as error:
                warn_partial(path, f"material library not used: {error}")
    if missing:
        warn_partial(path, f"material libraries not found: {_listed(missing)}")
    return known


def _listed(names: list[str]) -> str:
    listed = ", ".join(repr(name[:60]) for name in names[:5])
    return f"{listed} and {len(names) - 5} more" if len(names) > 5 else listed


def _meshes(
    corners: Corners,
    vertices: NDArray[np.float64],
    colors: NDArray[np.float32] | None,
    material_ids: NDArray[np.int32],
    sections: _Sections,
) -> list[Mesh]:
    """Split the triangles at ``o`` lines; each mesh gets the vertices that it uses."""
    object_lines = np.asarray(sections.object_lines, np.int64)
    cuts = np.searchsorted(corners.lines, object_lines) if len(object_lines) else object_lines
    names = ["", *sections.object_names]
    if len(np.unique(cuts)) > MAX_OBJECTS:
        cuts, names, object_lines = cuts[:0], [""], object_lines[:0]
    face_ids = corners.face_ids_within(np.searchsorted(object_lines, corners.face_lines))
    edges = [0, *cuts.tolist(), len(corners.lines)]
    meshes = []
    for name, first, stop in zip(names, edges[:-1], edges[1:], strict=True):
        if first == stop:
            continue
        used, faces = corners.shared(first, stop, whole=first == 0 and stop == edges[-1])
        points = used[:, 0]
        meshes.append(
            Mesh(
                vertices[points],
                faces,
                normals=corners.normals[used[:, 2]] if corners.has_normals else None,
                texcoords=corners.texcoords_of(used[:, 1]) if corners.has_texcoords else None,
                colors=None if colors is None else colors[points],
                material_ids=material_ids[first:stop],
                face_ids=face_ids[first:stop],
                name=name,
            )
        )
    return meshes
