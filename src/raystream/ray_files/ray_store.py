"""RayStore: rays in a Zarr store, read a block at a time."""

from __future__ import annotations

import contextlib
import math
import os
from collections.abc import Iterable, Iterator
from os import PathLike, fspath
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.errors import FileFormatError, RaystreamError
from raystream.ray_files.blocks import Block, Blocks, divide
from raystream.ray_files.columns import chunk_files
from raystream.ray_files.open_store import open_arrays

#: Arrays of a ray store; the first two are required.
RAY_ARRAYS = ("origins", "directions", "t_min", "t_max")

#: More rays than a machine could trace in a lifetime indicate a damaged shape.
MAX_RAYS = 2**42

#: Maximum bytes per chunk: chunks are decoded whole, several at a time.
MAX_CHUNK_BYTES = 2**28

#: Maximum chunks per read; each takes some kilobytes beside its values.
MAX_CHUNKS = 4096

_KINDS = "iuf"


class RayStore:
    """Rays in a Zarr store, v2 or v3.

    Parameters
    ----------
    path : str or path
        A folder, or a ``.zip`` file.

    Attributes
    ----------
    shape : tuple of int
        The leading shape of the rays.
    arrays : dict of str to zarr.Array

    Raises
    ------
    FileFormatError
        If it is not a Zarr store, or its arrays are not rays.
    """

    def __init__(self, path: str | PathLike[str]) -> None:
        self.path = fspath(path)
        self.arrays = open_arrays(self.path)
        for name in self.arrays:
            if name not in RAY_ARRAYS:
                raise self._fault(f"holds {name!r}; expected {', '.join(RAY_ARRAYS)}")
        for name in RAY_ARRAYS[:2]:
            if name not in self.arrays:
                raise self._fault(f"array {name!r} is missing")
        for name, array in self.arrays.items():
            self._check(name, array)
        self.shape = self._leading_shape()
        if math.prod(self.shape) > MAX_RAYS:
            raise self._fault(f"claims {math.prod(self.shape):,} rays; at most {MAX_RAYS:,}")

    def _fault(self, reason: str) -> FileFormatError:
        return FileFormatError(self.path, reason)

    def _check(self, name: str, array: Any) -> None:
        if array.dtype.kind not in _KINDS:
            raise self._fault(f"array {name!r} has dtype {array.dtype}; expected numbers")
        if name in RAY_ARRAYS[:2] and (array.ndim == 0 or array.shape[-1] != 3):
            raise self._fault(f"array {name!r}: expected shape (..., 3), got {array.shape}")
        if array.size and 0 in array.chunks:
            raise self._fault(f"array {name!r} has chunks of length 0")
        byte_count = math.prod(array.chunks) * array.dtype.itemsize
        if byte_count > MAX_CHUNK_BYTES:
            raise self._fault(
                f"array {name!r} has chunks of {byte_count / 1e6:,.0f} MB; the limit is "
                f"{MAX_CHUNK_BYTES / 1e6:,.0f} MB; store it in smaller chunks"
            )

    def _leading_shape(self) -> tuple[int, ...]:
        shapes = {name: array.shape for name, array in self.arrays.items()}
        vectors = [shapes.pop(name) for name in RAY_ARRAYS[:2]]
        try:
            shape = np.broadcast_shapes(*vectors)[:-1]
        except ValueError:
            raise self._fault(
                f"origins and directions: shapes {vectors[0]} and {vectors[1]} do not broadcast "
                "against each other"
            ) from None
        for name, own in shapes.items():
            if not _broadcasts(own, shape):
                raise self._fault(
                    f"array {name!r}: shape {own} does not broadcast to the rays' shape {shape}"
                )
        return shape

    def divide(self, limit: int) -> Blocks:
        """Divide the rays into blocks of about `limit`, or fewer if chunks are tiny."""
        chunk = [1] * len(self.shape)
        for name, array in self.arrays.items():
            own = _leading(name, array.chunks)
            if _leading(name, array.shape) == self.shape:
                chunk = [max(pair) for pair in zip(chunk, own, strict=True)]
                limit = min(limit, MAX_CHUNKS * max(math.prod(own), 1))
        return divide(self.shape, chunk, limit)

    def read(self, block: Block) -> dict[str, NDArray[Any]]:
        """Read the rays of a block.

        Parameters
        ----------
        block : Block

        Returns
        -------
        dict of str to ndarray
            Ray arguments of a query, by name; they broadcast to the block's shape. Missing
            chunks read as the array's fill value.

        Raises
        ------
        FileFormatError
            If a chunk is damaged, or cannot be read.
        """
        rays = {}
        for name, array in self.arrays.items():
            own = _leading(name, array.shape)
            box = block.box[len(block.box) - len(own) :]
            index = tuple(
                slice(0, 1) if length == 1 else part for length, part in zip(own, box, strict=True)
            )
            if name in RAY_ARRAYS[:2]:
                index = (*index, slice(0, 3))
            with self._reading(name):
                if _is_packed_by_blosc(array) and os.path.isdir(self.path):
                    _check_lengths(chunk_files(array, index))
                rays[name] = np.asarray(array[index])
        return rays

    @contextlib.contextmanager
    def _reading(self, name: str) -> Iterator[None]:
        try:
            yield
        except (RaystreamError, MemoryError):
            raise
        except Exception as error:  # each codec raises its own errors
            reason = str(error).partition("\n")[0] or type(error).__name__
            raise self._fault(f"array {name!r} cannot be read ({reason:.200})") from error


def _leading(name: str, lengths: tuple[int, ...]) -> tuple[int, ...]:
    return lengths[:-1] if name in RAY_ARRAYS[:2] else lengths


def _is_packed_by_blosc(array: Any) -> bool:
    codecs = array.compressors  # those of Zarr v2 and v3 have classes of their own
    return array.shards is None and bool(codecs) and "Blosc" in type(codecs[-1]).__name__


def _check_lengths(files: Iterable[Path]) -> None:
    """Reject a truncated chunk: Blosc reads past its end, and reports no error."""
    for file in files:
        with contextlib.suppress(FileNotFoundError), file.open("rb") as stream:
            header = stream.read(16)
            length = os.fstat(stream.fileno()).st_size
            if len(header) < 16 or int.from_bytes(header[12:], "little") != length:
                raise ValueError(f"chunk {file.name} is not complete")


def _broadcasts(own: tuple[int, ...], shape: tuple[int, ...]) -> bool:
    try:
        return np.broadcast_shapes(own, shape) == shape
    except ValueError:
        return False
