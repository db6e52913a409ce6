"""Columns: one array of hits on disk, written by block or by appending rows."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.ray_files.blocks import Block


class ColumnType(NamedTuple):
    """Dtype and fill value of a column; `unwritten` marks values not written yet."""

    dtype: str
    unwritten: float


def create_array(
    group: Any, name: str, kind: ColumnType, shape: tuple[int, ...], chunk: tuple[int, ...]
) -> Any:
    """Create an array in a group; decision 33 covers its compression."""
    from zarr.codecs import BloscCodec

    return group.create_array(
        name,
        shape=shape,
        chunks=chunk,
        dtype=kind.dtype,
        fill_value=kind.unwritten,
        compressors=BloscCodec(cname="lz4", clevel=1, shuffle="bitshuffle"),
        filters=None,
    )


def chunk_files(array: Any, box: tuple[slice, ...]) -> Iterator[Path]:
    """Iterate over the files of the chunks that a box overlaps."""
    folder = Path(array.store.root, array.path)
    spans = [
        range(part.start // length, -(-part.stop // length))
        for part, length in zip(box, array.chunks, strict=True)
    ]
    for place in itertools.product(*spans):
        yield folder / array.metadata.encode_chunk_key(place)


class BlockColumn:
    """An array of the rays' shape, with one chunk per block.

    Parameters
    ----------
    array : zarr.Array

    Attributes
    ----------
    changed : list of Path
        Files written since the list was last emptied.
    """

    def __init__(self, array: Any) -> None:
        self._array = array
        self.changed: list[Path] = []

    def write(self, block: Block, values: NDArray[Any]) -> None:
        """Write the values of a block."""
        self._array[block.box] = values
        self.changed.extend(chunk_files(self._array, block.box))


class RowColumn:
    """A 1-D array that grows by appending rows, written a whole chunk at a time.

    Rows that do not fill a chunk stay in memory until `flush`. A flushed chunk is rewritten
    with the rows that follow. Chunks only ever gain rows, so one written just before the
    process was killed still holds the rows of the last journal entry.

    Parameters
    ----------
    array : zarr.Array
    count : int
        Rows already written.
    grows : bool
        Whether the array's length follows the appended rows; otherwise its length is fixed.
    """

    def __init__(self, array: Any, count: int, grows: bool) -> None:
        self._array = array
        self._grows = grows
        self._chunk: int = array.chunks[0]
        self._written = count // self._chunk * self._chunk
        self.changed: list[Path] = []
        if grows:
            array.resize((count,))
        self._tail: NDArray[Any] = np.asarray(array[self._written : count])

    def append(self, values: NDArray[Any]) -> None:
        """Append rows."""
        rows = np.concatenate([self._tail, values.astype(self._tail.dtype, copy=False)])
        whole = len(rows) // self._chunk * self._chunk
        self._write(rows[:whole])
        self._written += whole
        self._tail = rows[whole:].copy()

    def flush(self) -> None:
        """Write the rows of the last, incomplete chunk."""
        self._write(self._tail)

    def _write(self, rows: NDArray[Any]) -> None:
        if not len(rows):  # never truncate flushed rows
            return
        end = self._written + len(rows)
        if self._grows and self._array.shape[0] != end:
            self._array.resize((end,))
        box = (slice(self._written, end),)
        self._array[box] = rows
        self.changed.extend(chunk_files(self._array, box))
