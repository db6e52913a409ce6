"""Durable files: on disk even if the machine fails the next moment."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterable, Iterator
from pathlib import Path

from raystream.core.atomic_write import atomic_write


def synchronize(files: Iterable[Path]) -> None:
    """Wait until files, and their directory entries, are on disk.

    Missing files are skipped: Zarr does not write chunks that hold only the fill value.
    """
    folders = set()
    for file in files:
        with contextlib.suppress(FileNotFoundError):
            _synchronize(file)
            folders.add(file.parent)
    for folder in folders:
        with contextlib.suppress(PermissionError):  # Windows cannot open folders
            _synchronize(folder)


def _synchronize(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def write_durably(path: Path, text: str) -> None:
    """Write or replace a file atomically and durably."""
    with atomic_write(path) as temporary, temporary.open("w", encoding="utf-8") as stream:
        stream.write(text)
        stream.flush()
        os.fsync(stream.fileno())
    synchronize([path])


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[bool]:
    """Lock a folder against other processes until the block or the process ends.

    Yields
    ------
    bool
        Whether the lock was acquired. Always True if the system has no such locks.
    """
    try:
        import fcntl
    except ImportError:
        yield True
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            yield False
            return
        except OSError:  # a file system without locks
            pass
        yield True
    finally:
        os.close(handle)
