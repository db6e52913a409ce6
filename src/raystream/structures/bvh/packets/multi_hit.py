"""Multi-hit by packets: all hits, in growing buffers, sorted or in the order of discovery."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.memory import check_memory
from raystream.jit.constants import BYTES_64, NULL, ONE_U64, ZERO_U64
from raystream.jit.cpu import device
from raystream.jit.simd import load, store
from raystream.kernels.growing_buffers import GrowingBuffers
from raystream.kernels.hit_filter import HitFilter
from raystream.kernels.hits import HitArrays, HitBatch
from raystream.kernels.ray import world_t
from raystream.structures.batch_kernels import Batch, BatchKernel, Calls, CallSize
from raystream.structures.bvh.leaf_kinds import CountsLanes, collecting_leaf
from raystream.structures.bvh.packets.filters import packet_filter
from raystream.structures.bvh.packets.hits import (
    COLLECTOR_BYTES,
    ENDS_BYTES,
    Buffers,
    Collector,
    Ends,
    has_room,
    sort_by_ray,
)
from raystream.structures.bvh.packets.queries import PacketAnswer, PacketScene, packet_kernel
from raystream.structures.bvh.packets.rays import (
    GROUPS,
    PACKET_RAYS,
    GroupLanes,
    PacketSource,
    group_places,
    group_rows,
    t_transform,
)

if TYPE_CHECKING:
    from raystream.structures.base import Structure

_LANES, _RAYS = np.uint64(16), np.uint64(PACKET_RAYS)
_LANE = np.uint64(4)

#: Where the ends of a packet's rows are, behind its collector.
_ENDS_AT = np.uint64(-(-COLLECTOR_BYTES // 64) * 64)

#: Most packets per call: 16,384 rays. With half as many, programs take 10 to 20 % longer, and with
#: twice as many no less.
PACKETS_PER_CALL = 64

#: The same for counting, which has no work between two calls.
COUNTED_PER_CALL = 32

#: Initial capacity of a buffer, in hits.
FIRST_CAPACITY = 1 << 16


class PacketBuffers(NamedTuple):
    """Buffers of one call.

    Attributes
    ----------
    found : HitArrays
        Hits in the order of discovery.
    found_rays : ndarray of shape (capacity,), int32
        Their rays.
    rows : HitArrays
        Sorted hits.
    ray_ids, splits : ndarray, int64
        The rays in the order of `rows`, and the ends of their rows.
    capacity : int
    addresses : ndarray, uint64
        All of these, the capacity, and what is in use: `packets.hits.Buffers`.
    """

    found: HitArrays
    found_rays: NDArray[np.int32]
    rows: HitArrays
    ray_ids: NDArray[np.int64]
    splits: NDArray[np.int64]
    capacity: int
    addresses: NDArray[np.uint64]

    @classmethod
    def of(cls, capacity: int, kind: type[np.floating[Any]] = np.float32) -> PacketBuffers:
        """Buffers for a number of hits whose t, u and v are of type `kind`."""
        hit_bytes = 2 * (3 * np.dtype(kind).itemsize + 4) + 4
        remedy = "give max_hits, or fewer rays at a time"
        check_memory(
            capacity * hit_bytes, f"multi_hit: a buffer of {capacity:,} hits would", remedy
        )
        rays = PACKETS_PER_CALL * PACKET_RAYS
        found, rows = HitArrays.empty(capacity, kind), HitArrays.empty(capacity, kind)
        found_rays = np.empty(capacity, np.int32)
        ids, splits = np.empty(rays, np.int64), np.zeros(rays + 1, np.int64)
        addresses = [array.ctypes.data for array in (*found, found_rays, *rows, ids, splits)]
        record = np.array([*addresses, capacity, 0, 0], np.uint64)
        return cls(found, found_rays, rows, ids, splits, capacity, record)

    def found_hits(self, count: int) -> HitBatch:
        """The hits in the order of discovery."""
        return HitBatch(self.found.part(slice(count)), None, self.found_rays[:count], 0)

    def sorted_hits(self, ray_count: int) -> HitBatch:
        """The sorted hits."""
        return HitBatch(self.rows, self.splits[: ray_count + 1], self.ray_ids[:ray_count], 0)


class RowsWanted(NamedTuple):
    """What is wanted by `ROWS`.

    Attributes
    ----------
    surfaces : bool
        See `packets.leaf.Kind`.
    counts : uint64
        Address of the number of hits of each ray, int64; 0 if hits are collected.
    sorts : bool
        Whether to sort these.
    buffers : uint64
        Address of `PacketBuffers.addresses`.
    filter : HitFilter or None
    """

    surfaces: bool
    counts: np.uint64
    sorts: bool
    buffers: np.uint64
    filter: HitFilter | None


@device
def start_rows(number, slow_groups, source, wanted, state):
    """Begin to collect or count a packet's hits; see `PacketAnswer.begin`."""
    hits = Collector(state)
    hits.is_counting = np.uint64(wanted.counts != NULL)
    if wanted.counts == NULL:
        buffers, sorts = Buffers(wanted.buffers), wanted.sorts
        hits.buffers, hits.capacity = wanted.buffers, buffers.capacity
        hits.count = ZERO_U64 if sorts else buffers.used
        _number_rays(hits, number, source.order, not sorts and slow_groups == ZERO_U64)
    return hits


@device
def _begin_rows(packet, number, slow_groups, source, wanted, state):
    hits = start_rows(number, slow_groups, source, wanted, state)
    mine = packet_filter(wanted.filter, group_places(source.order, number), slow_groups)
    return collecting_leaf(wanted.surfaces, mine, hits)


@device
def store_rows(packet, number, slow_groups, source, scene, wanted, state):
    """Sort and convert a packet's hits; see `PacketAnswer.finish`."""
    hits, buffers, order = Collector(state), Buffers(wanted.buffers), source.order
    if wanted.counts != NULL:
        _store_counts(packet, number, order, wanted.counts)
        return True
    used, count, sorts = buffers.used, hits.count, wanted.sorts
    if not has_room(hits) or (sorts and used + count > buffers.capacity):
        return False
    if sorts:
        buffers.used = sort_by_ray(buffers, count, state + _ENDS_AT, _RAYS, used, True)
        _finish_rows(packet, number, order, slow_groups, state, used, buffers)
        return True
    if slow_groups != ZERO_U64:
        _finish_found(packet, number, order, slow_groups, state, used, buffers)
    buffers.used = count
    return True


@device
def _store_counts(packet, number, order, counts):
    for g in range(GROUPS):
        first, count = group_rows(order, number, g)
        found = CountsLanes(packet, g).count
        for lane in range(count):
            store(counts + (first + lane) * BYTES_64, np.int64(found[lane]))


#: All hits, or their numbers, for a `RowsWanted`, until those of a packet do not fit into buffers.
ROWS = PacketAnswer(_begin_rows, store_rows, int(_ENDS_AT) + ENDS_BYTES)


@device
def row_transform(packet, g, lane, slow_groups, state):
    """What `tell_row` takes of a ray."""
    return t_transform(GroupLanes(packet, g), lane, (slow_groups >> g) & ONE_U64 == ONE_U64)


@device
def tell_row(t, row, transform):
    """Convert the t of a row to world direction lengths."""
    at, (t_scale, t_offset) = t + row * _LANE, transform
    store(at, world_t(load(np.float32, at), t_scale, t_offset))


@device
def _finish_rows(packet, number, order, slow_groups, state, row, buffers):
    """Convert a sorted packet's distances; write its rays and the ends of their rows."""
    ends = Ends(state + _ENDS_AT)
    t, ids, splits = buffers.rows.t, buffers.ray_ids, buffers.splits
    ray_count = buffers.ray_count
    for g in range(GROUPS):
        first, count = group_rows(order, number, g)
        for lane in range(count):
            transform = row_transform(packet, g, lane, slow_groups, state)
            row_end = ends.ends[g * _LANES + lane]
            while row != row_end:
                tell_row(t, row, transform)
                row += ONE_U64
            store(ids + ray_count * BYTES_64, np.int64(first + lane))
            ray_count += ONE_U64
            store(splits + ray_count * BYTES_64, np.int64(row_end))
    buffers.ray_count = ray_count


@device
def _number_rays(hits, number, order, is_final):
    """Set the indices that hits are collected with: rays in the batch or in the packet."""
    hits.in_world = ONE_U64 if is_final else ZERO_U64
    for g in range(GROUPS):
        first = g * _LANES
        if is_final:
            first, _ = group_rows(order, number, g)
        hits.first_rays[g] = np.int32(first)


@device
def _finish_found(packet, number, order, slow_groups, state, begin, buffers):
    """Convert distances and ray indices of a packet with rays that took the slow path."""
    t, rays = buffers.found.t, buffers.found.ray
    for row in range(begin, Collector(state).count):
        ray = np.uint64(load(np.int32, rays + row * _LANE))
        g, lane = ray // _LANES, ray % _LANES
        tell_row(t, row, row_transform(packet, g, lane, slow_groups, state))
        first, _ = group_rows(order, number, g)
        store(rays + row * _LANE, np.int32(first + lane))


# Kernels of batches


#: ``source_of(structure, batch)`` is what a kernel loads packets from.
SourceOf = Callable[[Any, Batch], Any]


def plain_source(structure: Structure, batch: Batch) -> PacketSource:
    """The rays as packets in the scene's frame."""
    return batch.packets(structure.frame)


def deliver_all(
    trace: Callable[..., int],
    source_of: SourceOf,
    structure: Structure,
    batch: Batch,
    by_ray: bool = False,
) -> Calls:
    """Deliver all hits of packets to the sink's visitor, in parts; see `BatchKernel.bind`.

    They are sorted if the query says so, or if the kernel has them `by_ray` only.
    """
    query, visitor, source = batch.query, batch.sink.visitor, source_of(structure, batch)
    assert visitor is not None
    # Unsorted hits have 32-bit ray indices.
    sorts = by_ray or query.is_ordered or len(batch.rays) >= 2**31
    scene = structure.view

    def fill(begin: int, end: int, buffers: PacketBuffers, *memory: int) -> int:
        in_use = buffers.addresses[-2:]
        in_use[:] = 0
        at = np.uint64(buffers.addresses.ctypes.data)
        wanted = RowsWanted(query.surfaces, NULL, sorts, at, query.on_hit)
        reached = trace(begin, end, scene, source, wanted, *memory)
        used, ray_count = in_use.tolist()
        if used:
            visitor(buffers.sorted_hits(ray_count) if sorts else buffers.found_hits(used))
        return int(reached)

    buffers_of = partial(PacketBuffers.of, kind=np.dtype(structure.precision).type)
    return GrowingBuffers(buffers_of, fill, FIRST_CAPACITY), ()


def count_all(
    trace: Callable[..., object], source_of: SourceOf, structure: Structure, batch: Batch
) -> Calls:
    """Count the hits of packets; see `BatchKernel.bind`."""
    counts = np.uint64(batch.sink.counts.ctypes.data)
    wanted = RowsWanted(batch.query.surfaces, counts, False, NULL, batch.query.on_hit)
    return trace, (structure.view, source_of(structure, batch), wanted)


def all_hits_kernels(
    scenes: PacketScene, answer: PacketAnswer = ROWS, source_of: SourceOf = plain_source
) -> tuple[BatchKernel, BatchKernel]:
    """The kernels that deliver all hits of packets to a visitor, and that count them."""
    trace = packet_kernel(scenes, answer)
    visited, counted = partial(deliver_all, trace, source_of), partial(count_all, trace, source_of)
    return (
        BatchKernel(visited, CallSize(8, PACKETS_PER_CALL, joins_chunks=False), is_tiled=True),
        BatchKernel(counted, CallSize(8, COUNTED_PER_CALL), is_tiled=True),
    )
