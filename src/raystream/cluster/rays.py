"""Rays in Dask arrays: inputs of a cluster's queries, validated as by `Tracer`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import dask.array as da
import numpy as np
from numpy.typing import NDArray

from raystream.core.array_checks import leading_shape
from raystream.core.rays import as_real_array

#: Rays per chunk made from NumPy arrays.
CHUNK_RAYS = 1 << 20


class LazyRays(NamedTuple):
    """Rays of leading shape S, chunk by chunk.

    Attributes
    ----------
    origins, directions : dask.array.Array
        They broadcast to S + (3,), with 3 in one chunk.
    t_min, t_max : dask.array.Array or float
        Arrays have a last axis of 1, and broadcast likewise.
    shape : tuple of int
        S.
    chunks : tuple of tuple of int
        Chunks of S.
    """

    origins: da.Array
    directions: da.Array
    t_min: da.Array | float
    t_max: da.Array | float
    shape: tuple[int, ...]
    chunks: tuple[tuple[int, ...], ...]

    @classmethod
    def of(cls, origins: Any, directions: Any, t_min: Any, t_max: Any) -> LazyRays:
        """Make rays from Dask arrays, or from any array that `Tracer` accepts.

        Raises
        ------
        ValueError, TypeError
            As `Tracer`; or if the size of a chunk is unknown.
        """
        named = (("origins", origins), ("directions", directions))
        vectors = [_vectors(name, _checked(name, values)) for name, values in named]
        shape = (*leading_shape(np.broadcast_shapes, *vectors), 3)
        chunks = _chunks_of(vectors, shape)
        o, d = (_chunked(array, shape, chunks) for array in vectors)
        limits = [
            _limit(name, values, shape, chunks)
            for name, values in (("t_min", t_min), ("t_max", t_max))
        ]
        return cls(o, d, limits[0], limits[1], shape[:-1], chunks[:-1])

    def flat(self) -> LazyRays:
        """Flatten to one axis of N rays in C order, so that chunks hold contiguous rays."""
        if len(self.shape) == 1:
            return self
        first = self.chunks[0] if self.shape else (1,)
        rest = math.prod(self.shape[1:])
        whole = (*self.shape, 3)
        count = math.prod(self.shape)
        o, d = (_rows(array, whole, first) for array in (self.origins, self.directions))
        limits = [
            limit if isinstance(limit, float) else _rows(limit, (*self.shape, 1), first)
            for limit in (self.t_min, self.t_max)
        ]
        chunks = (tuple(length * rest for length in first),)
        return LazyRays(o, d, limits[0], limits[1], (count,), chunks)


def _checked(name: str, values: Any) -> da.Array | NDArray[Any]:
    """Check that values are real numbers; Dask arrays are not computed."""
    if not isinstance(values, da.Array):
        return as_real_array(name, values)
    if values.dtype.kind not in "fiu":
        raise TypeError(f"{name}: expected real numbers, got dtype {values.dtype}")
    if any(math.isnan(length) for length in values.shape):
        raise ValueError(f"{name}: chunk sizes are unknown; call compute_chunk_sizes() on it first")
    return values


def _vectors(name: str, array: da.Array | NDArray[Any]) -> da.Array | NDArray[Any]:
    if array.ndim == 1 and array.size == 0:
        array = array.reshape(0, 3)
    if array.ndim == 0 or array.shape[-1] != 3:
        raise ValueError(f"{name}: expected shape (..., 3), got {array.shape}")
    return array


def _chunks_of(
    vectors: Sequence[da.Array | NDArray[Any]], shape: tuple[int, ...]
) -> tuple[tuple[int, ...], ...]:
    """Choose chunks: the finer of two Dask arrays', or automatic for NumPy arrays."""
    lazy = [array for array in vectors if isinstance(array, da.Array)]
    if not lazy:
        limit = CHUNK_RAYS * 3 * 8
        auto = ("auto",) * (len(shape) - 1)
        return da.core.normalize_chunks((*auto, 3), shape, limit=limit, dtype=np.float64)
    indices = [tuple(range(len(shape) - a.ndim, len(shape))) for a in lazy]
    pairs = [item for pair in zip(lazy, indices, strict=True) for item in pair]
    found, _ = da.core.unify_chunks(*pairs)
    chunks = [found.get(axis, (length,)) for axis, length in enumerate(shape)]
    # A broadcast axis of length 1 has no chunks of its own.
    for axis, length in enumerate(shape):
        if sum(chunks[axis]) != length:
            chunks[axis] = (length,)
    return (*chunks[:-1], (3,))


def _chunked(
    array: da.Array | NDArray[Any], shape: tuple[int, ...], chunks: tuple[tuple[int, ...], ...]
) -> da.Array:
    """Rechunk an array, except for axes of length 1."""
    own = chunks[len(shape) - array.ndim :]
    wanted = tuple(
        c if length == sum(c) else (length,) for c, length in zip(own, array.shape, strict=True)
    )
    if isinstance(array, da.Array):
        return array.rechunk(wanted)
    return da.from_array(array, chunks=wanted)


def _limit(
    name: str, values: Any, shape: tuple[int, ...], chunks: tuple[tuple[int, ...], ...]
) -> da.Array | float:
    array = _checked(name, values)
    if array.ndim == 0 and not isinstance(array, da.Array):
        return float(array)
    try:
        fits = np.broadcast_shapes(array.shape, shape[:-1]) == shape[:-1]
    except ValueError:
        fits = False
    if not fits:
        raise ValueError(
            f"{name}: shape {array.shape} does not broadcast to the rays' shape {shape[:-1]}"
        )
    return _chunked(array[..., None], (*shape[:-1], 1), (*chunks[:-1], (1,)))


def _rows(array: da.Array, whole: tuple[int, ...], first: tuple[int, ...]) -> da.Array:
    """Broadcast to the whole shape, as rows; a single vector for all rays stays single.

    Parameters
    ----------
    array : dask.array.Array
    whole : tuple of int
        S, followed by the width.
    first : tuple of int
        Chunks of the first axis of S.
    """
    width, rest = whole[-1], math.prod(whole[1:-1])
    if array.size == width:
        return array.reshape(1, width)
    array = da.broadcast_to(array, whole)
    array = array.rechunk((first, *((length,) for length in whole[1:])))
    lengths = tuple(length * rest for length in first)
    return array.reshape(sum(lengths), width).rechunk((lengths, (width,)))
