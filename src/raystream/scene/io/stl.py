"""STL: stereolithography files, text and binary."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.errors import FileFormatError
from raystream.scene.io.files import read_model_bytes
from raystream.scene.io.text import BYTE_ORDER_MARK, parse_floats, plain_text
from raystream.scene.mesh import Mesh
from raystream.scene.scene import Scene

_HEADER_BYTES = 84
_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])

#: A solid's name may be any words, such as "vertex".
_NAMES = re.compile(rb"^ *(end)?solid\b[^\n]*?(?=facet +normal|$)", re.MULTILINE)


def read_stl(path: Path) -> Scene:
    """Read an STL file into a scene of one mesh.

    Corners are not welded: every triangle has its own three vertices. Facet normals are
    ignored: they follow from the corners.

    Parameters
    ----------
    path : Path
        An ``.stl`` or ``.stl.gz`` file.

    Returns
    -------
    Scene

    Raises
    ------
    FileFormatError
        If the file cannot be read, is not STL, or is truncated.
    """
    content = read_model_bytes(path)
    corners = (
        _binary_corners(path, content) if _is_binary(content) else _text_corners(path, content)
    )
    faces = np.arange(len(corners) * 3, dtype=np.int64).reshape(-1, 3)
    return Scene([Mesh(corners.reshape(-1, 3), faces)], name=path.name)


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
    if count == 0 and len(content) >= _HEADER_BYTES + _FACET.itemsize:
        raise FileFormatError(path, "is damaged: data after a declared count of no triangles")
    facets = np.frombuffer(content, _FACET, count, _HEADER_BYTES)
    return facets["corners"].astype(np.float32)


def _text_corners(path: Path, content: bytes) -> NDArray[Any]:
    text = plain_text(content).lower()
    words = _NAMES.sub(b"", text).split()
    places = [i for i, word in enumerate(words) if word == b"vertex"]
    if not places and b"endsolid" not in text:
        raise FileFormatError(path, "is truncated: it ends before its first triangle")
    if len(places) % 3:
        raise FileFormatError(path, f"is truncated: {len(places):,} corners, not a multiple of 3")
    if places and places[-1] + 3 >= len(words):
        raise FileFormatError(path, "is truncated: the last corner has no position")
    numbers = b" ".join([b" ".join(words[i + 1 : i + 4]) for i in places])
    try:
        corners = parse_floats(numbers, 3 * len(places)).reshape(-1, 3, 3)
    except ValueError:
        raise FileFormatError(path, "a corner's position is not three numbers") from None
    with np.errstate(over="ignore"):
        return corners.astype(np.float32)
