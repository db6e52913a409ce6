"""HitStore: the hits of a query in a Zarr store, written a block at a time."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.errors import FileFormatError, RaystreamError
from raystream.core.hits import MultiHits
from raystream.ray_files.blocks import Block, Blocks
from raystream.ray_files.columns import BlockColumn, ColumnType, RowColumn, create_array
from raystream.ray_files.durable import synchronize

#: Distinct from a miss, which is -1.
_NOT_TRACED = -2

_HITS = {
    "t": ColumnType("float32", np.nan),
    "u": ColumnType("float32", np.nan),
    "v": ColumnType("float32", np.nan),
    "prim_id": ColumnType("int32", _NOT_TRACED),
    "mesh_id": ColumnType("int32", _NOT_TRACED),
}
_STATUS = {"status": ColumnType("uint8", 255)}

#: Columns of each query: arrays of the rays' shape, and arrays of rows.
COLUMNS: dict[str, dict[str, ColumnType]] = {
    "first_hit": {**_HITS, **_STATUS},
    "any_hit": {"hit": ColumnType("bool", False)},
    "count_hits": {"count": ColumnType("int64", -1)},
    "multi_hit": _STATUS,
}
_SPLITS = "ray_splits"
ROWS: dict[str, dict[str, ColumnType]] = {"multi_hit": {_SPLITS: ColumnType("int64", -1), **_HITS}}

#: Of queries that report triangles: where a scene says what the file's faces are, which a saved
#: structure alone does not; and in a scene with instances.
_FACE = {"face_id": ColumnType("int32", _NOT_TRACED)}
_INSTANCE = {"instance_id": ColumnType("int32", _NOT_TRACED)}


class Columns(NamedTuple):
    """The columns of a query's hits.

    Attributes
    ----------
    of_rays : dict of str to ColumnType
        Arrays of the rays' shape.
    of_rows : dict of str to ColumnType
        Arrays of rows.
    """

    of_rays: dict[str, ColumnType]
    of_rows: dict[str, ColumnType]

    @classmethod
    def of(cls, query: str, triangles: Any) -> Columns:
        """The columns of a query of a tracer's triangles."""
        of_rays, of_rows = COLUMNS[query], ROWS.get(query, {})
        known = {} if triangles.attributes is None else _FACE
        if triangles.number_type is np.float64:
            known = {**known, **{name: ColumnType("float64", np.nan) for name in ("t", "u", "v")}}
        if triangles.instances is not None:
            known = {**known, **_INSTANCE}
        if query == "first_hit":
            of_rays = {**of_rays, **known}
        if query == "multi_hit":
            of_rows = {**of_rows, **known}
        return cls(of_rays, of_rows)


#: Rows per chunk. An incomplete chunk is written after each block, so it must be cheap.
CHUNK_ROWS = 2**18

_KEY = "raystream"
_FORMAT = "raystream hits"


class HitStore:
    """A store of hits open for writing.

    Parameters
    ----------
    path : Path
        A store made by `create`.
    columns : Columns
    blocks : Blocks
    rays_done : int
    row_count : int
        Hits of ``multi_hit`` already written.

    Raises
    ------
    FileFormatError
        If the store is damaged, or does not match.
    """

    def __init__(
        self, path: Path, columns: Columns, blocks: Blocks, rays_done: int, row_count: int
    ) -> None:
        self.path = path
        self._row_count = row_count
        try:
            self._blocks = {
                name: BlockColumn(self._array(name, kind, blocks.shape, blocks.lengths))
                for name, kind in columns.of_rays.items()
            }
            self._rows = {
                name: RowColumn(
                    self._array(name, kind, _row_shape(name, blocks), (CHUNK_ROWS,)),
                    rays_done if name == _SPLITS else row_count,
                    grows=name != _SPLITS,
                )
                for name, kind in columns.of_rows.items()
            }
        except (RaystreamError, MemoryError):
            raise
        except Exception as error:  # a damaged array can raise anything in Zarr
            reason = str(error).partition("\n")[0] or type(error).__name__
            raise FileFormatError(path, f"cannot be resumed: {reason:.200}") from error

    def _array(
        self, name: str, kind: ColumnType, shape: tuple[int, ...] | None, chunk: tuple[int, ...]
    ) -> Any:
        import zarr

        array = zarr.open_array(zarr.storage.LocalStore(self.path), path=name, mode="r+")
        is_same = array.dtype == np.dtype(kind.dtype) and array.chunks == chunk
        if not is_same or shape not in (None, array.shape):
            raise FileFormatError(self.path, f"array {name!r} does not match the query")
        return array

    @staticmethod
    def create(path: Path, columns: Columns, blocks: Blocks, identity: dict[str, Any]) -> None:
        """Create an empty store in an empty folder.

        Parameters
        ----------
        path : Path
        columns : Columns
        blocks : Blocks
        identity : dict
            Identity of the query; saved as an attribute.
        """
        import zarr

        attributes = {"format": _FORMAT, "is_complete": False, "identity": identity}
        group = zarr.create_group(zarr.storage.LocalStore(path), attributes={_KEY: attributes})
        for name, kind in columns.of_rays.items():
            create_array(group, name, kind, blocks.shape, blocks.lengths)
        for name, kind in columns.of_rows.items():
            create_array(group, name, kind, _row_shape(name, blocks) or (0,), (CHUNK_ROWS,))
        synchronize(path.rglob("zarr.json"))

    def write_block(self, block: Block, arrays: dict[str, NDArray[Any]]) -> None:
        """Write arrays of the rays' shape."""
        for name, column in self._blocks.items():
            column.write(block, arrays[name].reshape(block.shape))

    def append(self, hits: MultiHits) -> None:
        """Append the hits of the next rays."""
        for name, column in self._rows.items():
            if name == _SPLITS:
                column.append(hits.ray_splits[:-1] + self._row_count)
            else:
                column.append(getattr(hits, name))
        self._row_count += len(hits.t)

    def synchronize(self) -> None:
        """Wait until everything written is on disk."""
        for row_column in self._rows.values():
            row_column.flush()
        columns: list[BlockColumn | RowColumn] = [*self._blocks.values(), *self._rows.values()]
        for column in columns:
            synchronize(column.changed)
            column.changed.clear()
        synchronize(self.path / name / "zarr.json" for name in self._rows)

    def complete(self, figures: dict[str, int]) -> None:
        """Write the final row split, and mark the store as complete."""
        if _SPLITS in self._rows:
            self._rows[_SPLITS].append(np.array([self._row_count], np.int64))
            self.synchronize()
        for file in self.path.rglob("*.partial"):  # left by a killed process
            file.unlink()
        import zarr

        attributes = {**store_attributes(self.path), "is_complete": True, "counts": figures}
        group = zarr.open_group(
            zarr.storage.LocalStore(self.path), mode="r+", use_consolidated=False
        )
        group.update_attributes({_KEY: attributes})
        synchronize([self.path / "zarr.json"])


def _row_shape(name: str, blocks: Blocks) -> tuple[int, ...] | None:
    """Return the shape of an array of rows; None if it is not known in advance."""
    return (blocks.ray_count + 1,) if name == _SPLITS else None


def store_attributes(path: Path) -> dict[str, Any]:
    """Read the attributes of a store: ``identity``, and whether it ``is_complete``.

    Returns
    -------
    dict
        Empty if the folder is not a store of hits.

    Raises
    ------
    FileFormatError
        If it cannot be read.
    """
    file = path / "zarr.json"
    try:
        found = json.loads(file.read_bytes())["attributes"][_KEY]
    except (ValueError, KeyError, TypeError, RecursionError, FileNotFoundError):
        return {}
    except OSError as error:
        raise FileFormatError(path, f"cannot be read ({error.strerror})") from None
    return found if isinstance(found, dict) and found.get("format") == _FORMAT else {}


def is_replaceable(path: Path) -> bool:
    """Whether a folder holds only files that `HitStore` writes, judging by names."""
    tables = (*COLUMNS.values(), *ROWS.values(), _FACE, _INSTANCE)
    known = {name for columns in tables for name in columns}
    with os.scandir(path) as entries:
        return all(
            entry.name == "zarr.json"
            or (entry.name in known and entry.is_dir(follow_symlinks=False))
            or entry.name.endswith(".partial")
            for entry in entries
        )


def remove_store(path: Path) -> None:
    """Empty a folder of hits; its metadata first, so that no part passes for the whole."""
    with contextlib.suppress(FileNotFoundError):
        (path / "zarr.json").unlink()
    with os.scandir(path) as entries:
        for entry in list(entries):
            if entry.is_dir(follow_symlinks=False):
                shutil.rmtree(entry.path)
            else:
                os.unlink(entry.path)
