"""STL: stereolithography files, text and binary."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.errors import FileFormatError
from raystream.scene.io.files import read_model_bytes
from raystream.scene.io.part_names import MAX_PARTS, number_meshes
from raystream.scene.io.partial import warn_partial
from raystream.scene.io.text import BYTE_ORDER_MARK, decoded, parse_floats, plain_text, shown
from raystream.scene.mesh import Mesh
from raystream.scene.scene import Scene

_HEADER_BYTES = 84
_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])

#: The word of a statement, and the solid's name: any words, such as "vertex".
_STATEMENT = re.compile(rb"solid\b([^\n]*?)(?=facet +normal|$)", re.MULTILINE)

#: A facet of text, word by word; the places of its keywords, and of the corners' numbers.
_LAYOUT = (
    b"facet normal 0 0 0 outer loop vertex 0 0 0 vertex 0 0 0 vertex 0 0 0 endloop endfacet"
).split()
_KEYWORDS = [(place, word) for place, word in enumerate(_LAYOUT) if word != b"0"]
_NUMBERS = [place for place, word in enumerate(_LAYOUT) if word == b"0"][3:]

#: Facets in any other layout: a letter for each word that matters.
_LETTERS = {b"facet": b"f", b"vertex": b"v", b"endfacet": b"e"}
_FACETS = re.compile(rb"(?:fvvve)*+")
_CORNERS = re.compile(rb"f?(v*)")
_SPLIT_ENDS = re.compile(rb"\bend +(?=facet|loop)")


def read_stl(path: Path) -> Scene:
    """Read an STL file into a scene of one mesh for each solid.

    Corners are not welded: every triangle has its own three vertices. Facet normals are
    ignored: they follow from the corners. Solids without facets are left out, if others have some.

    Parameters
    ----------
    path : Path
        An ``.stl`` or ``.stl.gz`` file.

    Returns
    -------
    Scene
        Meshes of text files are named by their solids, and numbered where names repeat; a binary
        file is one mesh without a name.

    Raises
    ------
    FileFormatError
        If the file cannot be read, is not STL, is truncated, or its facets are not triangles.

    Warns
    -----
    RaystreamWarning
        For more than `MAX_PARTS` solids, which become one mesh.
    """
    content = read_model_bytes(path)
    if _is_binary(content):
        parts = [("", _binary_corners(path, content))]
    else:
        solids = _solids(path, plain_text(content))
        parts = [(name, _text_corners(path, name, body)) for name, body in solids]
    parts = [part for part in parts if len(part[1])] or parts[:1]
    if len(parts) > MAX_PARTS:
        warn_partial(path, f"its {len(parts):,} solids are more than {MAX_PARTS:,}: one mesh")
        parts = [("", np.concatenate([corners for _, corners in parts]))]
    meshes = []
    for name, corners in parts:
        faces = np.arange(len(corners) * 3, dtype=np.int64).reshape(-1, 3)
        meshes.append(Mesh(corners.reshape(-1, 3), faces, name=name))
    number_meshes(meshes)
    return Scene(meshes, name=path.name)


def _is_binary(content: bytes) -> bool:
    """Decide by size: some binary files begin with "solid", as text must."""
    if len(content) >= _HEADER_BYTES and len(content) == _declared_bytes(content):
        return True
    head = content[:4096].removeprefix(BYTE_ORDER_MARK).lower()
    return not (head.lstrip().startswith(b"solid") and b"\0" not in head)


def _declared_bytes(content: bytes) -> int:
    return _HEADER_BYTES + _FACET.itemsize * int.from_bytes(content[80:84], "little")


def _binary_corners(path: Path, content: bytes) -> NDArray[Any]:
    if len(content) < _HEADER_BYTES:
        raise FileFormatError(path, "is not an STL file: neither text nor long enough for binary")
    declared = _declared_bytes(content)
    count = (declared - _HEADER_BYTES) // _FACET.itemsize
    if declared > len(content):
        raise FileFormatError(
            path,
            f"is truncated or not STL: {count:,} triangles need {declared:,} bytes, "
            f"but it has {len(content):,}",
        )
    more = (len(content) - declared) // _FACET.itemsize
    if more:
        raise FileFormatError(
            path,
            f"is damaged: data for {more:,} triangles after a declared count of "
            f"{f'{count:,}' if count else 'no'} triangles",
        )
    facets = np.frombuffer(content, _FACET, count, _HEADER_BYTES)
    return facets["corners"].astype(np.float32)


def _solids(path: Path, text: bytes) -> list[tuple[str, bytes]]:
    """The name of each solid, and the words of its facets in lower case."""
    lowered = text.lower()
    solids: list[tuple[str, bytes]] = []
    name, position, is_open = "", 0, False
    for match in _STATEMENT.finditer(lowered):
        body = lowered[position : match.start()].rstrip(b" ")
        is_end = body.endswith(b"end")
        if is_end != is_open:
            raise FileFormatError(
                path,
                f"is damaged: 'solid' and 'endsolid' do not alternate after solid {name!r:.60}",
            )
        if is_end:
            solids.append((name, body[:-3]))
        else:
            _require_blank(path, body)
            name = " ".join(decoded(text[match.start(1) : match.end(1)]).split())
        position, is_open = match.end(), not is_open
    if is_open:
        raise FileFormatError(path, f"is truncated: solid {name!r:.60} has no 'endsolid'")
    _require_blank(path, lowered[position:])
    return solids


def _require_blank(path: Path, text: bytes) -> None:
    if text.strip():
        raise FileFormatError(path, f"is truncated or damaged: {shown(text)} outside of a solid")


def _text_corners(path: Path, name: str, body: bytes) -> NDArray[Any]:
    words = body.split()
    width = len(_LAYOUT)
    count, rest = divmod(len(words), width)
    if not rest and all(words[place::width].count(word) == count for place, word in _KEYWORDS):
        numbers = [b""] * (9 * count)
        for column, place in enumerate(_NUMBERS):
            numbers[column::9] = words[place::width]
    else:
        if b"end " in body:
            words = _SPLIT_ENDS.sub(b"end", body).split()
        marks = [i for i, word in enumerate(words) if word in _LETTERS]
        count = _facet_count(path, name, b"".join([_LETTERS[words[i]] for i in marks]))
        places = [i for i in marks if words[i] == b"vertex"]
        numbers = [b" ".join(words[i + 1 : i + 4]) for i in places]
    try:
        corners = parse_floats(b" ".join(numbers), 9 * count).reshape(-1, 3, 3)
    except ValueError:
        raise FileFormatError(path, "a corner's position is not three numbers") from None
    with np.errstate(over="ignore"):
        return corners.astype(np.float32)


def _facet_count(path: Path, name: str, letters: bytes) -> int:
    """Count facets, and check that each has three corners and an end."""
    facets = _FACETS.match(letters)
    corners = _CORNERS.match(letters, facets.end() if facets else 0)
    assert facets
    assert corners
    count = facets.end() // 5
    if facets.end() < len(letters):
        found = len(corners[1])
        fault = "has no end" if found == 3 else f"has {found} corners, not 3"
        raise FileFormatError(
            path, f"is truncated or damaged: facet {count + 1:,} of solid {name!r:.60} {fault}"
        )
    return count
