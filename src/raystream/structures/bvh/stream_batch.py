"""Trace a batch by streams: sort the rays, trace them, and restore the order of the results."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from raystream.jit.cpu import kernel
from raystream.jit.simd import f32x16, load, load_records, store, store_nontemporal
from raystream.jit.threads import Progress, parallel_for, part_of, thread_count
from raystream.kernels.hit_filter import HitFilter
from raystream.kernels.ray import SceneFrame
from raystream.kernels.ray_source import RaySource, ResultAddresses
from raystream.structures.bvh.layout import TreeAddresses
from raystream.structures.bvh.stream import trace_streams
from raystream.structures.bvh.stream_order import (
    COUNT_BYTES,
    SORTED_CHUNK,
    SortedRays,
    count_keys,
    place_keys,
    place_rays,
)

__all__ = ["SORTED_RAYS", "sorted_bytes", "trace_sorted"]

#: Most rays that are sorted together. Four times as many share more nodes, but their numbers and
#: results leave the cache: 0.9 to 1 times as fast; a quarter of them, the same.
SORTED_RAYS = 1 << 18

#: Sorted rays per call: whole streams, but few enough that the threads finish together and Ctrl-C
#: is noticed.
_LEAST_TRACED = 1024
_MOST_TRACED = 8192

_U0 = np.uint64(0)
_U1 = np.uint64(1)
_LANE = np.uint64(4)
_LANES = np.uint64(16)
_ROW = np.uint64(16)
_LINE_BITS = np.uint64(63)


def trace_sorted(
    tree: TreeAddresses,
    frame: SceneFrame,
    begin: int,
    end: int,
    source: RaySource,
    wants_any: bool,
    filter_: HitFilter | None,
    results: ResultAddresses,
    progress: Progress | None,
) -> None:
    """Find the nearest hit of each ray, or whether there is one, by streams.

    Parameters
    ----------
    tree : TreeAddresses
        Not empty.
    frame : SceneFrame
    begin, end : int
        The rays of the batch to trace.
    source : RaySource
        Packed.
    wants_any : bool
    filter_ : HitFilter, optional
    results : ResultAddresses
    progress : callable, optional
        Called with (rays done, rays).
    """
    count = end - begin
    # Parts of equal size: the last one must not be too small to share nodes.
    part_count = max(-(-count // SORTED_RAYS), 1)
    size = min(-(-count // (part_count * 16)) * 16, SORTED_RAYS)
    memory = _Memory(size, wants_any)
    share = -(-size // (8 * thread_count()))
    chunk = max(_LEAST_TRACED, min(share // _LEAST_TRACED * _LEAST_TRACED, _MOST_TRACED))
    for first in range(begin, end, max(size, 1)):
        part = min(size, end - first)
        sorted_rays = memory.sort(first, part, frame, source)

        def trace(low: int, high: int, rays: SortedRays = sorted_rays) -> None:
            trace_streams(low, high, tree, frame, source, rays, wants_any, filter_, results)

        report = part_of(progress, first - begin, count)
        parallel_for(trace, part, chunk, report, joins_chunks=True)
        if not wants_any:
            _write_all(sorted_rays, part, results)


def sorted_bytes(ray_count: int, wants_any: bool) -> int:
    """Most bytes that rays which are sorted take; see `_Memory`."""
    count = min(ray_count, SORTED_RAYS) + int(_LANES)
    chunks = (-(-count // SORTED_CHUNK)) * COUNT_BYTES
    return (6 if wants_any else 22) * count + chunks + 5 * 64 + 64


class _Memory:
    """Memory for sorted rays: 6 to 22 bytes per ray."""

    def __init__(self, count: int, wants_any: bool) -> None:
        padded = count + int(_LANES)
        chunk_count = -(-count // SORTED_CHUNK)
        self._arrays: list[NDArray[np.uint8]] = []
        self._rows = _U0 if wants_any else self._piece(padded * int(_ROW))
        self._numbers = self._piece(padded * 4)
        self._keys = self._piece(padded * 2)
        self._counts = self._piece(chunk_count * COUNT_BYTES)
        self._octant_ends = self._piece(64)

    def _piece(self, byte_count: int) -> np.uint64:
        """Address of a new array of bytes, a multiple of 64."""
        array = np.empty(byte_count + 64, np.uint8)
        self._arrays.append(array)
        start = array.ctypes.data
        return np.uint64(start + -start % 64)

    def sort(self, first: int, count: int, frame: SceneFrame, source: RaySource) -> SortedRays:
        """Sort `count` rays from `first` on."""
        keys, counts, numbers = self._keys, self._counts, self._numbers

        def count_some(begin: int, end: int) -> None:
            count_keys(begin, end, first, count, source, frame, keys, counts)

        def place_some(begin: int, end: int) -> None:
            place_rays(begin, end, count, keys, counts, numbers)

        chunk_count = -(-count // SORTED_CHUNK)
        parallel_for(count_some, chunk_count, 1, joins_chunks=True)
        place_keys(chunk_count, counts, self._octant_ends)
        parallel_for(place_some, chunk_count, 1, joins_chunks=True)
        return SortedRays(
            np.uint64(first), np.uint64(count), numbers, self._octant_ends, self._rows
        )


def _write_all(rays: SortedRays, count: int, results: ResultAddresses) -> None:
    def write(begin: int, end: int) -> None:
        write_rows(begin, end, rays, results)

    parallel_for(write, count, SORTED_CHUNK, joins_chunks=True)


@kernel
def write_rows(begin, end, rays, out):
    """Write the results of rays begin to end from their rows.

    Parameters
    ----------
    begin, end : int
    rays : SortedRays
    out : ResultAddresses
    """
    at, last = np.uint64(begin), np.uint64(end)
    while at < last:
        row = rays.rows + at * _ROW
        to = (rays.first + at) * _LANE
        if at + _LANES <= last and (out.t | out.u | out.v | out.prim_id | to) & _LINE_BITS == _U0:
            t, u, v, prim_id = load_records(f32x16, 4, row)
            store_nontemporal(out.t + to, t)
            store_nontemporal(out.u + to, u)
            store_nontemporal(out.v + to, v)
            store_nontemporal(out.prim_id + to, prim_id)
            at += _LANES
            continue
        store(out.t + to, load(np.float32, row))
        store(out.u + to, load(np.float32, row + np.uint64(4)))
        store(out.v + to, load(np.float32, row + np.uint64(8)))
        store(out.prim_id + to, load(np.int32, row + np.uint64(12)))
        at += _U1
