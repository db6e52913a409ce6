"""Arrays in a Zarr group that are filled part by part, and resume after an interruption."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from numpy.typing import NDArray

from raystream.core.errors import FileFormatError, RaystreamError
from raystream.line_of_sight.resumable_array import ResumableOutput, continued
from raystream.ray_files.blocks import Block
from raystream.ray_files.columns import BlockColumn, ColumnType, RowColumn, create_array
from raystream.ray_files.durable import synchronize
from raystream.ray_files.errors import StoreWriteError, require_zarr
from raystream.ray_files.journal import (
    QueryProgress,
    journal_path,
    write_journal,
)

_KEY = "raystream"


class StoredArray(NamedTuple):
    """An array of a group: its shape, the shape of its chunks, and its dtype; filled with zeros.

    Attributes
    ----------
    grows : bool
        Whether its length is that of the rows written so far.
    """

    shape: tuple[int, ...]
    chunks: tuple[int, ...]
    dtype: str
    grows: bool = False


class MatrixFile:
    """An array that is written by whole chunks, as ``matrix[rows, columns] = values``."""

    def __init__(self, column: BlockColumn) -> None:
        self._column = column

    def __setitem__(self, box: tuple[slice, slice], values: NDArray[Any]) -> None:
        self._column.write(Block(0, 0, box), values)


class ResumableStore(ResumableOutput):
    """A Zarr group that is being filled, and the journal of its progress.

    Attributes
    ----------
    done : QueryProgress
        What was in the group when it was opened.
    """

    def __init__(
        self, path: Path, identity: dict[str, Any], done: QueryProgress, arrays: dict[str, Any]
    ) -> None:
        super().__init__(path, identity, done.rays)
        self.done, self._arrays = done, arrays
        self._columns: list[BlockColumn | RowColumn] = []

    def matrix(self, name: str) -> MatrixFile:
        """An array to be written by whole chunks."""
        column = BlockColumn(self._arrays[name])
        self._columns.append(column)
        return MatrixFile(column)

    def rows(self, name: str, count: int, *, grows: bool) -> RowColumn:
        """An array to be written by appending to its first `count` rows."""
        column = RowColumn(self._arrays[name], count, grows)
        self._columns.append(column)
        return column

    def synchronize(self) -> None:
        """Wait until everything written is on disk."""
        for column in self._columns:
            if isinstance(column, RowColumn):
                column.flush()
            synchronize(column.changed)
            column.changed.clear()
        synchronize(self._path / name / "zarr.json" for name in self._arrays)


@contextlib.contextmanager
def resumable_store(
    path: Path, arrays: Mapping[str, StoredArray], identity: dict[str, Any]
) -> Iterator[ResumableStore]:
    """Open a Zarr group to fill, new or interrupted.

    Parameters
    ----------
    path : Path
        A folder.
    arrays : mapping of str to StoredArray
    identity : dict
        Describes the query in JSON types; a group resumes only if it is the same.

    Yields
    ------
    ResumableStore

    Raises
    ------
    FileFormatError
        If the folder exists and belongs to another query or has no journal, or another process
        writes it.
    StoreWriteError
        If it cannot be written, or the disk is full.
    RaystreamError
        If the package zarr is not installed.
    """
    require_zarr()
    try:
        yield from _opened(path, arrays, identity)
    except (FileFormatError, StoreWriteError):
        raise
    except OSError as error:
        raise StoreWriteError(path, error) from error


def _opened(
    path: Path, arrays: Mapping[str, StoredArray], identity: dict[str, Any]
) -> Iterator[ResumableStore]:
    journal = journal_path(path)
    if path.exists() and not path.is_dir():
        raise FileFormatError(path, "is a file, not a folder for a Zarr group")
    if not journal.exists():
        if path.exists() and any(path.iterdir()):
            raise FileFormatError(
                path, f"exists, but not its journal {journal.name}; choose another output"
            )
        # The journal first: it marks the folder as replaceable.
        write_journal(journal, identity, QueryProgress())
    path.mkdir(exist_ok=True)
    with continued(path, identity) as found:
        if found.done.rays == 0:
            _create(path, arrays, identity)
        opened = {name: _open(path, name, kind) for name, kind in arrays.items()}
        yield ResumableStore(path, identity, found.done, opened)


def _create(path: Path, arrays: Mapping[str, StoredArray], identity: dict[str, Any]) -> None:
    """Create the empty group, in place of one in which nothing was recorded."""
    import zarr

    known = {*arrays, "zarr.json"}
    others = [one.name for one in path.iterdir() if one.name not in known]
    if others:
        raise FileFormatError(path, f"holds other files, such as {others[0]!r}")
    for one in path.iterdir():
        if one.is_dir():
            shutil.rmtree(one)
        else:
            one.unlink()
    kept = {name: identity[name] for name in ("query", "form", "shape")}
    group = zarr.create_group(zarr.storage.LocalStore(path), attributes={_KEY: kept})
    for name, kind in arrays.items():
        shape = (0, *kind.shape[1:]) if kind.grows else kind.shape
        create_array(group, name, ColumnType(kind.dtype, 0), shape, kind.chunks)
    synchronize(path.rglob("zarr.json"))


def _open(path: Path, name: str, kind: StoredArray) -> Any:
    import zarr

    try:
        array = zarr.open_array(zarr.storage.LocalStore(path), path=name, mode="r+")
    except (RaystreamError, MemoryError):
        raise
    except Exception as error:  # a damaged array can raise anything in Zarr
        reason = str(error).partition("\n")[0] or type(error).__name__
        raise FileFormatError(path, f"is damaged ({reason:.200}); delete it to start over") from (
            error
        )
    is_same = array.dtype == kind.dtype and array.chunks == kind.chunks
    if not is_same or not (kind.grows or array.shape == kind.shape):
        raise FileFormatError(path, "is damaged; delete it to start over")
    return array


def open_stored(path: Path, name: str) -> Any:
    """Open an array of a finished group for reading."""
    import zarr

    return zarr.open_array(zarr.storage.LocalStore(path), path=name, mode="r")
