"""Columns: one array of hits on the disk, written a block at a time or row after row."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.zarr_queries.blocks import Block

__all__ = ["BlockColumn", "Kind", "RowColumn", "create_array"]


class Kind(NamedTuple):
    """The numbers of a column; `unwritten` is what stands where none were written yet."""

    dtype: str
    unwritten: float


def create_array(
    group: Any, name: str, kind: Kind, shape: tuple[int, ...], chunk: tuple[int, ...]
) -> Any:
    """Create an array in a group; see decision 33 about its compression."""
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


def _chunk_files(array: Any, box: tuple[slice, ...]) -> Iterator[Path]:
    """The files of the chunks that a box lies in."""
    folder = Path(array.store.root, array.path)
    spans = [
        range(part.start // length, -(-part.stop // length))
        for part, length in zip(box, array.chunks, strict=True)
    ]
    for place in itertools.product(*spans):
        yield folder / array.metadata.encode_chunk_key(place)


class BlockColumn:
    """An array in the rays' shape, of which each block is a chunk.

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
        """Write the numbers of a block."""
        self._array[block.box] = values
        self.changed.extend(_chunk_files(self._array, block.box))


class RowColumn:
    """An array of one axis to which numbers are appended, a whole chunk at a time.

    What does not fill a chunk stays in memory until `flush`. A chunk that was flushed is
    written again with what follows: it only ever gets more rows, so that one which was written
    just before the process was killed has the rows of the last record still.

    Parameters
    ----------
    array : zarr.Array
    count : int
        Rows that are there already.
    grows : bool
        Whether the array's length is that of what was appended; else it is as long as it is.
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
        """Append numbers."""
        rows = np.concatenate([self._tail, values.astype(self._tail.dtype, copy=False)])
        whole = len(rows) // self._chunk * self._chunk
        self._write(rows[:whole])
        self._written += whole
        self._tail = rows[whole:].copy()

    def flush(self) -> None:
        """Write what does not fill a chunk yet."""
        self._write(self._tail)

    def _write(self, rows: NDArray[Any]) -> None:
        if not len(rows):  # nothing that was flushed may be cut off
            return
        end = self._written + len(rows)
        if self._grows and self._array.shape[0] != end:
            self._array.resize((end,))
        box = (slice(self._written, end),)
        self._array[box] = rows
        self.changed.extend(_chunk_files(self._array, box))
