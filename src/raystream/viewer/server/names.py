"""Names: what an uploaded file may be called."""

from __future__ import annotations

import re
import unicodedata

from raystream.scene.io.formats import SUFFIXES

__all__ = ["is_upload_id", "model_suffixes", "safe_name"]

#: What a model may consist of besides models: materials, buffers and pictures.
PART_SUFFIXES = (
    ".mtl",
    ".bin",
    ".bmp",
    ".dds",
    ".gif",
    ".hdr",
    ".jpeg",
    ".jpg",
    ".png",
    ".ppm",
    ".tga",
    ".tif",
    ".tiff",
    ".webp",
)

MAX_NAME_BYTES = 200

#: Separators, what some file systems give a meaning of its own, and what stands for bytes that
#: are no text.
_FORBIDDEN = re.compile('[/\\\\:*?"<>|\ufffd]')

#: Devices of Windows, whatever suffix follows.
_RESERVED = re.compile(
    r"(?:con|prn|aux|nul|com\d|lpt\d|conin\$|conout\$)\s*(?:\.|$)", re.IGNORECASE
)

_UPLOAD_ID = re.compile(r"[a-z0-9]{16,32}")


def is_upload_id(text: object) -> bool:
    """Whether this can be the name of an upload: 16 to 32 small letters and digits."""
    return isinstance(text, str) and _UPLOAD_ID.fullmatch(text) is not None


def model_suffixes() -> tuple[str, ...]:
    """The suffixes of files that can be opened, with and without ``.gz``."""
    return (*SUFFIXES, *(f"{suffix}.gz" for suffix in SUFFIXES))


def safe_name(name: object) -> str:
    """Check the name of an uploaded file.

    Parameters
    ----------
    name : object
        As the client gave it.

    Returns
    -------
    str
        One component of a path, composed (NFC) as most models write it.

    Raises
    ------
    ValueError
        If it could mean another place or another thing than a file of a model.
    """
    if not isinstance(name, str) or not name:
        raise ValueError("name: expected text")
    name = unicodedata.normalize("NFC", name)
    try:
        length = len(name.encode())
    except UnicodeEncodeError:
        raise ValueError("name: expected text that can be encoded") from None
    if length > MAX_NAME_BYTES:
        raise ValueError(f"name: expected at most {MAX_NAME_BYTES} bytes, got {length:,}")
    if _FORBIDDEN.search(name) or not name.isprintable():
        raise ValueError("name: expected the name of a file, without folders or signs of a path")
    if name.startswith(".") or name.endswith((".", " ")) or _RESERVED.match(name):
        raise ValueError("name: hidden and reserved names cannot be used")
    suffix = _suffix(name)
    if suffix not in SUFFIXES and suffix not in PART_SUFFIXES:
        known = " ".join((*SUFFIXES, *PART_SUFFIXES))
        raise ValueError(
            f"name: its suffix is none of a model or of its parts: {known}, or with .gz"
        )
    return name


def _suffix(name: str) -> str:
    bare = name.lower().removesuffix(".gz")
    dot = bare.rfind(".")
    return bare[dot:] if dot > 0 else ""
