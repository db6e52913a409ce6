"""Kernels that set up rays before the passes, finish their hits after them, and compact them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.core.rays import RayStatus
from raystream.cuda.multipass.kernels.ray_states import row_of
from raystream.jit.constants import INF_F32, NULL, ONE_U64, SHIFT_32, SHIFT_64, ZERO_F32
from raystream.jit.cpu import device, kernel
from raystream.jit.cuda import RangeKernel
from raystream.jit.simd import load, store
from raystream.kernels.ray import world_t
from raystream.kernels.ray_source import load_ray
from raystream.machines.records import RayState

__all__ = [
    "BEGIN",
    "CHUNK",
    "COUNT_KEPT",
    "FINISH",
    "FINISH_MANY",
    "KEEP",
    "RayStreamAddresses",
    "Wanted",
]

_MISS = np.int32(-1)
_VALID = np.uint8(RayStatus.VALID)
_STARTING = np.uint8(RayState.STARTING)
_DONE = np.uint8(RayState.DONE)

#: Rays per thread of a compaction.
CHUNK = np.uint64(256)


class Wanted(NamedTuple):
    """Number of hits that rays want.

    Attributes
    ----------
    splits : uint64
        Address of int64 numbers: ray i wants rows splits[i] to splits[i + 1]; 0 if all rays want
        the same number.
    limit : uint64
        That number; ray i's first row is then i.
    """

    splits: np.uint64
    limit: np.uint64


class RayStreamAddresses(NamedTuple):
    """Addresses of ray streams, and their capacity in records; see `machines.records`.

    Attributes
    ----------
    rows : uint64
        Numbers of the active rays, uint32; 0 if all are active.
    capacity : uint64
    ray, wanted, found, state : uint64
    world : uint64
        Scale and offset from local t to the caller's, two columns of float64.
    """

    rows: np.uint64
    capacity: np.uint64
    ray: np.uint64
    wanted: np.uint64
    found: np.uint64
    state: np.uint64
    world: np.uint64


@device
def _rows_of(wanted, i):
    """First row and number of the hits that ray i wants."""
    if wanted.splits == NULL:
        return i, wanted.limit
    first = np.uint64(load(np.int64, wanted.splits + (i << SHIFT_64)))
    return first, np.uint64(load(np.int64, wanted.splits + ((i + ONE_U64) << SHIFT_64))) - first


@kernel
def _begin(i, source, frame, streams, wish, status):
    """Convert a caller's ray to records of `machines.records`; see `cuda.soa`."""
    rows, capacity, ray, wanted, found, state, world = streams
    row = row_of(rows, i)
    given = load_ray(source, row, frame)
    if given.status != _VALID:
        store(status + row, given.status)
    word = capacity << SHIFT_32
    at = ray + (row << SHIFT_32)
    store(at, given.ox)
    store(at + word, given.oy)
    store(at + word * np.uint64(2), given.oz)
    store(at + word * np.uint64(3), given.dx)
    store(at + word * np.uint64(4), given.dy)
    store(at + word * np.uint64(5), given.dz)
    store(at + word * np.uint64(6), given.t_min)
    store(at + word * np.uint64(7), given.t_max)
    first, count = _rows_of(wish, row)
    at = wanted + (row << SHIFT_64)
    store(at, first)
    store(at + (capacity << SHIFT_64), count)
    store(wanted + (capacity << np.uint64(4)) + (row << SHIFT_32), np.uint32(row))
    store(found + (row << SHIFT_32), np.uint32(0))
    store(found + word + (row << SHIFT_32), ZERO_F32)
    store(state + row, _STARTING)
    # A hit's t is the local ray's: these convert it to the caller's.
    store(world + (row << SHIFT_64), given.t_scale)
    store(world + (capacity << SHIFT_64) + (row << SHIFT_64), given.t_offset)


@device
def _to_world(at, streams, row):
    """Convert the t at an address to the caller's."""
    world = streams.world + (row << SHIFT_64)
    factor = load(np.float64, world)
    offset = load(np.float64, world + (streams.capacity << SHIFT_64))
    store(at, world_t(load(np.float32, at), factor, offset))


@kernel
def _finish(i, streams, hits):
    """Write a miss, or convert the hit's t to the caller's."""
    at = i << SHIFT_32
    if load(np.uint32, streams.found + at) == np.uint32(0):
        store(hits.t + at, INF_F32)
        store(hits.u + at, ZERO_F32)
        store(hits.v + at, ZERO_F32)
        store(hits.prim_id + at, _MISS)
    else:
        _to_world(hits.t + at, streams, i)


@kernel
def _finish_many(i, streams, wish, hits):
    """Convert the t of a ray's hits to the caller's."""
    first, most = _rows_of(wish, i)
    count = min(np.uint64(load(np.uint32, streams.found + (i << SHIFT_32))), most)
    for k in range(first, first + count):
        _to_world(hits.t + (k << SHIFT_32), streams, i)


@device
def _is_kept(rows, state, k):
    return load(np.uint8, state + row_of(rows, k)) != _DONE


@kernel
def _count_kept(i, rows, length, state, sums):
    """Count the rays of a chunk that have not ended."""
    count = np.uint32(0)
    for k in range(i * CHUNK, min((i + ONE_U64) * CHUNK, length)):
        if _is_kept(rows, state, k):
            count = np.uint32(count + np.uint32(1))
    store(sums + (i << SHIFT_32), count)


@kernel
def _keep(i, rows, length, state, sums, kept):
    """List the rays of a chunk that have not ended, in order."""
    to = np.uint64(load(np.uint32, sums + (i << SHIFT_32)))
    for k in range(i * CHUNK, min((i + ONE_U64) * CHUNK, length)):
        if _is_kept(rows, state, k):
            store(kept + (to << SHIFT_32), np.uint32(row_of(rows, k)))
            to += ONE_U64


#: Over rays: their records, and the final hits.
BEGIN, FINISH, FINISH_MANY = RangeKernel(_begin), RangeKernel(_finish), RangeKernel(_finish_many)

#: Over chunks of rays, with a `jit.cuda.scan` between the two.
COUNT_KEPT, KEEP = RangeKernel(_count_kept), RangeKernel(_keep)
