"""Atomic writes: a file appears, or is replaced, only when it is complete."""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Iterator
from os import PathLike
from pathlib import Path


@contextlib.contextmanager
def atomic_write(path: str | PathLike[str]) -> Iterator[Path]:
    """Open a temporary file in the same folder, which replaces `path` at the end of the block.

    If the block raises, the temporary file is removed, and an existing file stays as it was.

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
        If the folder is missing or not writable; the error names `path`.
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
        # mkstemp's files are private: use the old file's permissions, or those of new files.
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


# Read once, at import: it can only be read by setting it, which affects other threads.
_UMASK = _umask()
