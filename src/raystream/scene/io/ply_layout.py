"""PLY layout: the header of a PLY file."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

from raystream.core.errors import FileFormatError
from raystream.scene.io.text import shown

_TYPES = {
    "char": "i1",
    "uchar": "u1",
    "short": "i2",
    "ushort": "u2",
    "int": "i4",
    "uint": "u4",
    "float": "f4",
    "double": "f8",
    "int8": "i1",
    "uint8": "u1",
    "int16": "i2",
    "uint16": "u2",
    "int32": "i4",
    "uint32": "u4",
    "int64": "i8",
    "uint64": "u8",
    "float32": "f4",
    "float64": "f8",
}

_MAX_HEADER_BYTES = 1 << 20

_LAST_LINE = re.compile(rb"(?<=[\r\n])[ \t]*end_header[ \t]*(\r\n|\r|\n|\Z)")


@dataclass(frozen=True)
class Property:
    """One column of an element: a scalar, or a list if `count_type` is given."""

    name: str
    value_type: str
    count_type: str = ""


@dataclass
class Element:
    """A kind of record, such as ``vertex``, and its number of records."""

    name: str
    count: int
    properties: list[Property] = field(default_factory=list)


def read_header(path: Path, content: bytes) -> tuple[str, list[Element], int]:
    """Read the header.

    Returns
    -------
    encoding : str
        ``"ascii"``, ``"<"`` or ``">"``: text, or the byte order.
    elements : list of Element
    start : int
        Offset of the values.

    Raises
    ------
    FileFormatError
        If it is not a PLY header.
    """
    if content[:3] != b"ply" or content[3:4] not in (b"\n", b"\r", b" "):
        raise FileFormatError(path, "is not a PLY file: it does not begin with a line 'ply'")
    last = _LAST_LINE.search(content, 0, _MAX_HEADER_BYTES)
    if last is None:
        raise FileFormatError(path, "is truncated: the PLY header has no end_header")
    # All lines of a header end alike, so a line feed after a lone CR is a value.
    only_cr = last[1] == b"\r\n" and b"\n" not in content[: last.start(1)]
    start = last.end() - only_cr
    encoding, elements = "", []
    for line in re.split(rb"[\r\n]", content[3 : last.start()]):
        words = line.decode("latin-1").split()
        if not words or words[0] in ("comment", "obj_info"):
            continue
        try:
            if words[0] == "format":
                encoding = {
                    "ascii": "ascii",
                    "binary_little_endian": "<",
                    "binary_big_endian": ">",
                }[words[1]]
            elif words[0] == "element":
                elements.append(Element(words[1], _element_count(words[2])))
            elif words[0] == "property":
                elements[-1].properties.append(_property(words[1:]))
            elif elements:  # before them, some exporters write bare comments
                raise ValueError(words[0])
        except (KeyError, IndexError, ValueError):
            raise FileFormatError(path, f"cannot read the PLY header line {shown(line)}") from None
    if not encoding:
        raise FileFormatError(path, "the PLY header has no format line")
    return encoding, elements, start


def _element_count(word: str) -> int:
    if not word.isdigit() or len(word) > 18:
        raise ValueError(word)
    return int(word)


def _property(words: list[str]) -> Property:
    if words[0] == "list":
        count_type, value_type, name = _TYPES[words[1]], _TYPES[words[2]], words[3]
        if count_type[0] == "f":
            raise ValueError(words[1])
        return Property(name, value_type, count_type)
    return Property(words[1], _TYPES[words[0]])
