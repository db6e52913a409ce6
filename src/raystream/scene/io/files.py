"""Files: bounded reading of model files and of the files that they refer to."""

from __future__ import annotations

import io
import os
import zlib
from pathlib import Path, PureWindowsPath

from raystream.core.errors import FileFormatError

#: Larger files, and archives that unpack to more, are rejected; see `max_file_bytes`.
DEFAULT_MAX_FILE_BYTES = 4 << 30

#: Text models compress to a tenth at best; an archive with a higher ratio than this is meant to
#: exhaust memory. Small archives may unpack to `SMALL_FILE_BYTES` regardless.
MAX_UNPACK_RATIO = 250
SMALL_FILE_BYTES = 64 << 20

_UNPACK_STEP = 16 << 20

#: Reason for rejecting a folder.
FOLDER = "is a folder, not a model file"


def max_file_bytes() -> int:
    """Return the limit on a model file's size: ``RAYSTREAM_MAX_FILE_BYTES``, else 4 GiB."""
    text = os.environ.get("RAYSTREAM_MAX_FILE_BYTES", "")
    return int(text) if text.isdigit() else DEFAULT_MAX_FILE_BYTES


def model_suffix(path: Path) -> str:
    """Return the file extension of the format, in lower case: ``.obj`` for ``A.OBJ.gz``."""
    name = path.name.lower()
    return Path(name.removesuffix(".gz")).suffix


def read_model_bytes(path: Path) -> bytes:
    """Read a whole file, unpacked if its name ends in ``.gz``.

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    bytes
        At least one.

    Raises
    ------
    FileFormatError
        If the file does not exist, is a folder, unreadable, empty, damaged, or larger
        than `max_file_bytes`.
    """
    limit = max_file_bytes()
    try:
        _require_file(path)
        size = path.stat().st_size
        if size > limit:
            raise FileFormatError(path, _too_large(size, limit))
        content = path.read_bytes()
    except OSError as error:
        reason = error.strerror or type(error).__name__
        raise FileFormatError(path, f"cannot be read ({reason.lower()})") from error
    if content and path.name.lower().endswith(".gz"):
        content = _unpack(path, content, limit)
    if not content:
        raise FileFormatError(path, "is empty")
    return content


def _require_file(path: Path) -> None:
    if not path.exists():
        raise FileFormatError(path, "there is no such file")
    if path.is_dir():
        raise FileFormatError(path, FOLDER)
    if not path.is_file():
        raise FileFormatError(path, "is not a regular file")


def find_sibling(model: Path, name: str) -> Path | None:
    """Find a file that a model refers to: a texture, a material library, a buffer.

    Searches the model's folder and its subfolders only, first with exact spelling, then
    ignoring case; absolute paths, and paths that leave the folder, are reduced to their names.

    Parameters
    ----------
    model : Path
        The file that refers to the other one.
    name : str
        As written there; either kind of slash.

    Returns
    -------
    Path or None
        None if there is no such file, and for a URL such as ``http://...``.
    """
    name = name.strip().strip('"')  # some exporters quote names with spaces
    if not name or "\0" in name or "://" in name:
        return None
    windows = PureWindowsPath(name)
    parts = [part for part in windows.parts if part not in (windows.anchor, ".")]
    if not parts:
        return None
    folder = model.parent
    candidates = [parts] if ".." not in parts and not windows.anchor else []
    candidates.append(parts[-1:])
    for candidate in candidates:
        found = _find(folder, candidate)
        if found is not None:
            return found
    return None


def _find(folder: Path, parts: list[str]) -> Path | None:
    """Descend from `folder`, matching each part exactly, else ignoring case."""
    try:
        for part in parts:
            exact = folder / part
            if part == ".." or len(part) > 255:
                return None
            if exact.exists():
                folder = exact
                continue
            wanted = part.casefold()
            alike = sorted(p for p in folder.iterdir() if p.name.casefold() == wanted)
            if not alike:
                return None
            folder = alike[0]
        return folder if folder.is_file() else None
    except (OSError, ValueError):
        return None


def _unpack(path: Path, packed: bytes, limit: int) -> bytes:
    """Unpack all members of a gzip file, refusing more than `limit` bytes."""
    ratio_limit = max(SMALL_FILE_BYTES, MAX_UNPACK_RATIO * len(packed))
    unpacked = io.BytesIO()
    rest = packed
    while rest:
        member = zlib.decompressobj(wbits=31)
        while not member.eof:
            try:
                step = member.decompress(rest, _UNPACK_STEP)
            except zlib.error as error:
                if unpacked.tell() and rest is not packed and not rest.strip(b"\0"):
                    return unpacked.getvalue()  # zero padding after the last member
                raise FileFormatError(path, "is damaged: not valid gzip data") from error
            unpacked.write(step)
            rest = member.unconsumed_tail
            if unpacked.tell() > min(limit, ratio_limit):
                raise FileFormatError(path, _too_large(unpacked.tell(), min(limit, ratio_limit)))
            if not rest and not step and not member.eof:
                raise FileFormatError(path, "is truncated: the gzip data ends early")
        rest = member.unused_data
    return unpacked.getvalue()


def _too_large(size: int, limit: int) -> str:
    return (
        f"is too large: {size:,} bytes or more, the limit is {limit:,} "
        "(set RAYSTREAM_MAX_FILE_BYTES to raise it)"
    )
