"""Software tag: raystream's name in the images and videos that it writes."""

from __future__ import annotations

from os import PathLike
from pathlib import Path

#: As a PNG's text "Software", and the like in other formats.
SOFTWARE = "raystream"

_NAME = SOFTWARE.encode()

#: The bytes of the tag, by suffix. Other formats have it as a comment.
_TAGS = {
    ".png": b"Software\0" + _NAME,
    ".exr": b"software\0string\0" + len(_NAME).to_bytes(4, "little") + _NAME,
    ".hdr": b"\nSOFTWARE=" + _NAME + b"\n",
}

#: Bytes at a file's beginning and end that may hold the tag.
_SEARCHED = 1 << 16


def is_tagged(path: str | PathLike[str]) -> bool:
    """Whether a file was written by raystream, according to its tag.

    Raises
    ------
    OSError
        If it cannot be read.
    """
    source = Path(path)
    tag = _TAGS.get(source.suffix.lower(), _NAME)
    with source.open("rb") as file:
        head = file.read(_SEARCHED)
        file.seek(max(source.stat().st_size - _SEARCHED, 0))
        return tag in head or tag in file.read(_SEARCHED)
