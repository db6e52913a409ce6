"""An array in a file that is filled part by part, and resumes after an interruption."""

from __future__ import annotations

import contextlib
import math
import os
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from raystream.core.errors import FileFormatError
from raystream.ray_files.durable import locked
from raystream.ray_files.journal import (
    Journal,
    QueryProgress,
    check_same_query,
    journal_path,
    read_journal,
    write_journal,
)

#: Seconds between two records of the progress: what an interruption may lose.
_INTERVAL = 2.0


class ResumableOutput(ABC):
    """An output that is being filled, and the journal of its progress."""

    def __init__(self, path: Path, identity: dict[str, Any], done: int) -> None:
        self._path, self._identity = path, identity
        self._recorded, self._time = done, time.monotonic()

    @abstractmethod
    def synchronize(self) -> None:
        """Wait until everything written is on disk."""

    def record(self, rays: int, rows: int = 0, *, at_once: bool = False) -> None:
        """Note that the results of this many rays are written; at most every 2 seconds."""
        if rays == self._recorded:
            return
        if not at_once and time.monotonic() - self._time < _INTERVAL:
            return
        self.synchronize()
        write_journal(journal_path(self._path), self._identity, QueryProgress(rays=rays, rows=rows))
        self._recorded, self._time = rays, time.monotonic()


class ResumableArray(ResumableOutput):
    """A ``.npy`` file that is mapped to memory, and the journal of its progress.

    Attributes
    ----------
    array : ndarray
        The file's content; changes are written to it.
    done : int
        Rays whose results were in the file when it was opened.
    """

    def __init__(self, path: Path, identity: dict[str, Any], array: Any, done: int) -> None:
        super().__init__(path, identity, done)
        self.array: NDArray[Any] = array
        self.done = done

    def synchronize(self) -> None:
        """Wait until everything written is on disk."""
        self.array.flush()  # type: ignore[attr-defined]


@contextlib.contextmanager
def resumable_array(
    path: Path, shape: tuple[int, ...], dtype: DTypeLike, identity: dict[str, Any]
) -> Iterator[ResumableArray]:
    """Open a ``.npy`` file to fill, new or interrupted.

    Parameters
    ----------
    path : Path
        Its name ends in ``.npy``.
    shape, dtype
        Of the array.
    identity : dict
        Describes the query in JSON types; a file resumes only if it is the same.

    Yields
    ------
    ResumableArray

    Raises
    ------
    FileFormatError
        If the file exists and belongs to another query or has no journal, or another process
        writes it.
    OSError
        If it cannot be written, or the disk is full.
    """
    journal = journal_path(path)
    if not path.exists():
        # The journal first: it marks the file as replaceable.
        write_journal(journal, identity, QueryProgress())
        path.touch()
    elif not journal.exists():
        raise FileFormatError(
            path, f"exists, but not its journal {journal.name}; choose another output"
        )
    with continued(path, identity) as found:
        if found.done.rays == 0:
            _create(path, shape, dtype)
        array = _mapped(path, shape, dtype)
        yield ResumableArray(path, identity, array, found.done.rays)


@contextlib.contextmanager
def continued(path: Path, identity: dict[str, Any]) -> Iterator[Journal]:
    """Lock an output that a journal describes; checks that it is of this query.

    Raises
    ------
    FileFormatError
        If it belongs to another query, or another process writes it.
    """
    with locked(path) as is_locked:
        if not is_locked:
            raise FileFormatError(path, "is being written by another process")
        found = read_journal(journal_path(path))
        words = {"scene_digest": "the scene", "points_digest": "the points"}
        check_same_query(path, found.identity, identity, words)
        yield found


def _create(path: Path, shape: tuple[int, ...], dtype: DTypeLike) -> None:
    """Write zeros; space on the disk is reserved, as writing to a map cannot report its lack."""
    array: Any = np.lib.format.open_memmap(path, mode="w+", dtype=dtype, shape=shape)
    del array
    if hasattr(os, "posix_fallocate"):
        with path.open("r+b") as stream:
            os.posix_fallocate(stream.fileno(), 0, path.stat().st_size)


def _mapped(path: Path, shape: tuple[int, ...], dtype: DTypeLike) -> Any:
    """Map a file whose header and length are as they must be; mapping would extend it."""
    try:
        with path.open("rb") as stream:
            np.lib.format.read_magic(stream)
            found, _, kind = np.lib.format.read_array_header_1_0(stream)
            length = stream.tell() + math.prod(shape) * kind.itemsize
    except (ValueError, EOFError):
        found, kind, length = (), None, -1
    if found != shape or kind != dtype or length != path.stat().st_size:
        raise FileFormatError(path, "is damaged; delete it to start over")
    return np.lib.format.open_memmap(path, mode="r+")
