"""SparseVisibility, and how it is written to a Zarr group, band by band of rows."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.jit.threads import Progress
from raystream.line_of_sight.resumable_store import ResumableStore, StoredArray
from raystream.line_of_sight.tiles import Tile, Tiles

#: Rows per chunk: an incomplete one is written with each record of the progress.
_CHUNK_ROWS = 1 << 18


class SparseVisibility(NamedTuple):
    """The pairs of points that see each other, in compressed rows.

    ``scipy.sparse.csr_array((np.ones(len(s.indices), bool), s.indices, s.indptr), s.shape)`` is
    the same.

    Attributes
    ----------
    indptr : ndarray of shape (N + 1,), int32, or int64 if a number needs it
        Point i of `a` sees the points ``indices[indptr[i]:indptr[i + 1]]`` of `b`.
    indices : ndarray of shape (K,), of the same dtype
        Increasing for each i.
    shape : tuple of two int
        (N, M)

    Notes
    -----
    In a Zarr group both are ``zarr.Array``, int64.
    """

    indptr: NDArray[Any]
    indices: NDArray[Any]
    shape: tuple[int, int]

    def dense(self) -> NDArray[np.bool_]:
        """The matrix of shape (N, M), bool."""
        matrix = np.zeros(self.shape, bool)
        rows = np.repeat(np.arange(self.shape[0]), np.diff(np.asarray(self.indptr)))
        matrix[rows, np.asarray(self.indices)] = True
        return matrix


def band_tiles(shape: tuple[int, int], most: int) -> Tiles:
    """Divide pairs into bands of few whole rows; or rows into parts, if one has too many pairs."""
    columns = max(min(most, shape[1]), 1)
    rows = max(min(most // columns, shape[0]), 1)
    return Tiles(shape, (rows, columns), False)


def stored_rows(row_count: int) -> dict[str, StoredArray]:
    """The arrays of a group."""
    return {
        "indptr": StoredArray((row_count + 1,), (_CHUNK_ROWS,), "int64"),
        "indices": StoredArray((0,), (_CHUNK_ROWS,), "int64", grows=True),
    }


def write_rows(
    trace: Callable[[Tile], NDArray[np.bool_]],
    tiles: Tiles,
    store: ResumableStore,
    progress: Progress | None,
) -> None:
    """Trace the tiles that are not done, and append the rows of each band to a group.

    Parameters
    ----------
    trace : callable
        Says which pairs of a tile see each other.
    tiles : Tiles
        Of `band_tiles`.
    store : ResumableStore
        Of `stored_rows`.
    progress : callable, optional
        Called with (rays done, rays).
    """
    row_count, column_count = tiles.shape
    total = tiles.ray_count
    done, found = store.done.rays, store.done.rows
    splits = store.rows("indptr", done // max(column_count, 1), grows=False)
    indices = store.rows("indices", found, grows=True)
    counts: list[NDArray[np.int64]] = []
    keys: list[NDArray[np.int64]] = []
    try:
        for tile in tiles:
            if tile.begin < store.done.rays:
                continue
            i, j = np.nonzero(trace(tile))
            counts.append(np.bincount(i, minlength=tile.rows.stop - tile.rows.start))
            keys.append(i * column_count + (j + tile.columns.start))
            if tile.columns.stop == column_count:
                ends = np.cumsum(np.sum(counts, axis=0))
                band = np.concatenate(keys)
                if len(keys) > 1:
                    band.sort()
                splits.append(np.concatenate([[0], ends[:-1]]) + found)
                indices.append(band % column_count)
                done, found = tile.begin + tile.ray_count, found + len(band)
                counts, keys = [], []
                store.record(done, found)
            if progress:
                progress(tile.begin + tile.ray_count, total)
    finally:
        store.record(done, found, at_once=True)
    if done == total:
        rest = row_count - (done // column_count if column_count else 0)
        splits.append(np.full(rest + 1, found))
        store.synchronize()
