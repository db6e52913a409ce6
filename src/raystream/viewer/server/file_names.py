"""File names: validation of the names of uploaded files."""

from __future__ import annotations

import re
import unicodedata

from raystream.scene.io.formats import SUFFIXES

#: Suffixes of files that accompany models: materials, buffers and textures.
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

#: Separators, characters with a special meaning in some file systems, and the replacement
#: character for undecodable bytes.
_FORBIDDEN = re.compile('[/\\\\:*?"<>|\ufffd]')

#: Windows device names, with any suffix.
_RESERVED = re.compile(
    r"(?:con|prn|aux|nul|com\d|lpt\d|conin\$|conout\$)\s*(?:\.|$)", re.IGNORECASE
)

_UPLOAD_ID = re.compile(r"[a-z0-9]{16,32}")


def is_upload_id(text: object) -> bool:
    """Whether this is a valid upload id: 16 to 32 lower-case letters and digits."""
    return isinstance(text, str) and _UPLOAD_ID.fullmatch(text) is not None


def model_suffixes() -> tuple[str, ...]:
    """Return the suffixes of models, with and without ``.gz``."""
    return (*SUFFIXES, *(f"{suffix}.gz" for suffix in SUFFIXES))


def safe_name(name: object) -> str:
    """Validate the name of an uploaded file.

    Parameters
    ----------
    name : object
        As received from the client.

    Returns
    -------
    str
        A single path component, in NFC like most references in models.

    Raises
    ------
    ValueError
        If it could refer to another folder, or is not a file of a model.
    """
    if not isinstance(name, str) or not name:
        raise ValueError("name: expected a string")
    name = unicodedata.normalize("NFC", name)
    try:
        length = len(name.encode())
    except UnicodeEncodeError:
        raise ValueError("name: expected a string that can be encoded") from None
    if length > MAX_NAME_BYTES:
        raise ValueError(f"name: expected at most {MAX_NAME_BYTES} bytes, got {length:,}")
    if _FORBIDDEN.search(name) or not name.isprintable():
        raise ValueError("name: expected a file name without folders or path characters")
    if name.startswith(".") or name.endswith((".", " ")) or _RESERVED.match(name):
        raise ValueError("name: hidden and reserved names are not allowed")
    suffix = _suffix(name)
    if suffix not in SUFFIXES and suffix not in PART_SUFFIXES:
        known = " ".join((*SUFFIXES, *PART_SUFFIXES))
        raise ValueError(f"name: unsupported file extension; supported: {known}, also with .gz")
    return name


def _suffix(name: str) -> str:
    bare = name.lower().removesuffix(".gz")
    dot = bare.rfind(".")
    return bare[dot:] if dot > 0 else ""
