"""The folder for files that outlive a run: compiled kernels and downloaded samples."""

from __future__ import annotations

import os
import sys
import warnings
from functools import cache
from pathlib import Path

_OTHERS_MAY_WRITE = 0o022


def cache_folder() -> Path:
    """Folder of all cached files: ``RAYSTREAM_CACHE_DIR`` [default: in the user's cache folder]."""
    chosen = os.environ.get("RAYSTREAM_CACHE_DIR")
    if chosen:
        return Path(chosen)
    if sys.platform == "win32":
        base = os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local"
    elif sys.platform == "darwin":
        base = Path.home() / "Library" / "Caches"
    else:
        base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "raystream"


def kernel_folder() -> Path:
    """Folder of compiled kernels; it may be missing or read-only."""
    return cache_folder() / "kernels"


def is_writable(folder: Path) -> bool:
    """Whether this process can keep files in a folder, which may have to be made first."""
    there = next((one for one in (folder, *folder.parents) if one.exists()), None)
    return there is not None and there.is_dir() and os.access(there, os.W_OK) and is_private(folder)


def is_private(folder: Path) -> bool:
    """Whether no user but this one and the administrator can write in a folder; else warn.

    Files that are run as code are only read from such a folder. One that is missing is private,
    as it is made so. Windows is not asked who can write.
    """
    try:
        status = folder.stat()
    except OSError:
        return True
    if is_own(status):
        return True
    _warn(folder)
    return False


def is_own(status: os.stat_result) -> bool:
    """Whether a file or folder belongs to this user or the administrator, who alone can write it.

    Always on Windows, where this is not checked.
    """
    if sys.platform == "win32":
        return True
    return status.st_uid in (0, os.geteuid()) and not status.st_mode & _OTHERS_MAY_WRITE


@cache  # warn once for each folder: Numba resets the filter that would do so
def _warn(folder: Path) -> None:
    warnings.warn(
        f"{folder}: other users can write there, so compiled kernels are neither read from it nor "
        "kept; delete it, or set RAYSTREAM_CACHE_DIR to a folder of your own",
        RuntimeWarning,
        stacklevel=3,
    )
