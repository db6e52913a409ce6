"""OBJ: Wavefront's text format, parsed with array operations; materials are in `mtl`."""

from __future__ import annotations

import itertools
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.errors import FileFormatError
from raystream.scene.io.colors import srgb_to_linear
from raystream.scene.io.files import find_sibling, read_model_bytes
from raystream.scene.io.mtl import read_mtl
from raystream.scene.io.obj_corners import Corners, read_corners
from raystream.scene.io.part_names import MAX_PARTS, number_repeats, path_name
from raystream.scene.io.partial import listed, warn_partial
from raystream.scene.io.text import Lines, decoded, parse_floats, plain_text, shown
from raystream.scene.material import Material
from raystream.scene.mesh import Mesh
from raystream.scene.scene import Scene

_CONTINUED = re.compile(rb"\\ *\n")

#: NaN and infinity as written by older C libraries on Windows: ``-1.#IND``.
_NOT_FINITE = re.compile(rb"-?1\.#(?:IND|INF|QNAN|SNAN)\d*")

#: Statements that distinguish an OBJ file without vertices from another format.
_KNOWN_WORDS = frozenset({b"g", b"o", b"mtllib", b"usemtl"})


def read_obj(path: Path) -> Scene:
    """Read an OBJ file and its MTL files.

    Polygons are cut into triangles. There is one mesh per object (``o``) and per group (``g``) of
    an object, in the order of their first faces; the triangles of a mesh keep the file's order. A
    group that is opened again within its object continues. A mesh is named ``object``, ``group`` or
    ``object/group``; see `number_repeats`. Vertices with several normals or texture coordinates
    are duplicated. Lines, points, curves and smoothing groups are skipped.

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
        For triangles, material libraries and textures that were skipped, and for groups that are
        too many to be meshes.
    """
    content = read_model_bytes(path)
    _require_whole_corner(path, content)
    text = plain_text(content)
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
    corners, names, cuts, order = _parts(path, sections, corners)
    if order is not None:
        corners, material_ids = corners.reordered(order), material_ids[order]
    meshes = _meshes(corners, vertices, colors, material_ids, (names, cuts))
    return Scene(meshes, materials=materials, name=path.name)


_VERTEX, _TEXCOORD, _NORMAL, _FACE, _STATEMENT = 1, 2, 3, 4, 5


def _require_whole_corner(path: Path, content: bytes) -> None:
    """Find a cut in a face's last corner, which then lacks indices that the others have."""
    last_line = content[max(content.rfind(b"\n"), content.rfind(b"\r")) + 1 :]
    words = last_line.partition(b"#")[0].split()
    filled = [[bool(part) for part in word.split(b"/")] for word in words[1:]]
    if words[:1] == [b"f"] and filled and filled[-1] != filled[0]:
        raise FileFormatError(path, f"is truncated: its last line ends with {shown(words[-1])}")


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
    """First lines of materials and parts; `strange` if there is no OBJ statement.

    A part is the number of its object, 0 before the first one, and the name of its group.
    """

    libraries: list[str] = field(default_factory=list)
    material_lines: list[int] = field(default_factory=list)
    material_names: list[str] = field(default_factory=list)
    part_lines: list[int] = field(default_factory=list)
    parts: list[tuple[int, str]] = field(default_factory=lambda: [(0, "")])
    object_names: list[str] = field(default_factory=lambda: [""])
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
        elif word in (b"o", b"g"):
            group = " ".join(name.split())
            if word == b"o":  # an object begins without a group
                sections.object_names.append(group)
                group = ""
            sections.part_lines.append(index)
            sections.parts.append((len(sections.object_names) - 1, group))
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
        warn_partial(path, f"undefined materials: {listed(missing)}")
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
        warn_partial(path, f"material libraries not found: {listed(missing)}")
    return known


def _parts(
    path: Path, sections: _Sections, corners: Corners
) -> tuple[Corners, list[str], NDArray[np.int64], NDArray[np.int64] | None]:
    """Divide the triangles among parts, by their lines.

    Returns
    -------
    corners : Corners
        With faces numbered within their parts.
    names : list of str
        Of the P parts that have triangles, in the order of their first ones.
    cuts : ndarray of shape (P + 1,), int64
        First triangle of each part, and the end.
    order : ndarray of shape (F,), int64, or None
        Sorts the triangles by part; None if they are sorted.
    """
    part_lines = np.asarray(sections.part_lines, np.int64)
    spans = np.searchsorted(part_lines, corners.lines)
    used = spans[np.flatnonzero(np.diff(spans, prepend=-1))].tolist()
    keys = sections.parts
    count = len({keys[span] for span in used})
    for fewer in ([(number, "") for number, _ in keys], [(0, "")] * len(keys)):
        if len({keys[span] for span in used}) > MAX_PARTS:
            keys = fewer
    numbers = {key: n for n, key in enumerate(dict.fromkeys(keys[span] for span in used))}
    if len(numbers) < count:
        warn_partial(
            path,
            f"its {count:,} objects and groups are more than {MAX_PARTS:,}, and became "
            f"{len(numbers):,} meshes",
        )
    part_of_span = np.array([numbers.get(key, -1) for key in keys], np.int64)
    parts = part_of_span[spans]
    if len(keys) > 1:
        of_face = part_of_span[np.searchsorted(part_lines, corners.face_lines)]
        corners = corners.numbered_within(of_face)
    order = None
    if (parts[1:] < parts[:-1]).any():
        order = np.argsort(parts, kind="stable")
        parts = parts[order]
    names = []
    for number, group in numbers:
        name = sections.object_names[number]
        names.append(name if name == group else path_name(name, group))
    cuts = np.searchsorted(parts, np.arange(len(numbers) + 1))
    return corners, number_repeats(names), cuts, order


def _meshes(
    corners: Corners,
    vertices: NDArray[np.float64],
    colors: NDArray[np.float32] | None,
    material_ids: NDArray[np.int32],
    parts: tuple[list[str], NDArray[np.int64]],
) -> list[Mesh]:
    """Make a mesh of each part, see `_parts`, with the vertices that it uses."""
    names, cuts = parts
    if not names:
        return []
    used, faces, starts = corners.shared(cuts)
    tables: dict[str, Any] = {"vertices": vertices[used[:, 0]]}
    if corners.has_normals:
        tables["normals"] = corners.normals[used[:, 2]]
    if corners.has_texcoords:
        tables["texcoords"] = corners.texcoords_of(used[:, 1])
    if colors is not None:
        tables["colors"] = colors[used[:, 0]]
    return [
        Mesh(
            faces=faces[first:stop],
            material_ids=material_ids[first:stop],
            face_ids=corners.face_ids[first:stop],
            name=name,
            **{attribute: table[begin:end] for attribute, table in tables.items()},
        )
        for name, (first, stop), (begin, end) in zip(
            names,
            itertools.pairwise(cuts.tolist()),
            itertools.pairwise(starts.tolist()),
            strict=True,
        )
    ]
