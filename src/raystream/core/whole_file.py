"""Writing a file as a whole: it appears, or is replaced, only when all of it is there."""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Iterator
from os import PathLike
from pathlib import Path

__all__ = ["replacing"]


@contextlib.contextmanager
def replacing(path: str | PathLike[str]) -> Iterator[Path]:
    """Give a temporary file in the same folder, which takes the place of `path` at the end.

    If the block raises, the temporary file is removed and an old file is kept.

    Parameters
    ----------
    path : str or path

    Yields
    ------
    Path
        An empty file to write to, with the same suffix.

    Raises
    ------
    OSError
        If the folder is missing or cannot be written; it names `path`.
    """
    target = Path(path)
    try:
        handle, name = tempfile.mkstemp(
            suffix=target.suffix, prefix=".raystream-", dir=target.parent
        )
    except OSError as error:
        raise type(error)(error.errno, error.strerror, str(target)) from None
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        # mkstemp lets nobody else read; a new file gets what the user's other files have.
        temporary.chmod(target.stat().st_mode & 0o777 if target.exists() else 0o666 & ~_UMASK)
        temporary.replace(target)
    except BaseException:
        with contextlib.suppress(OSError):
            temporary.unlink()
        raise


def _umask() -> int:
    mask = os.umask(0o022)
    os.umask(mask)
    return mask


# Read once, at import: it can only be read by setting it, which other threads would notice.
_UMASK = _umask()
