"""Multi-hit by packets: all hits, in growing buffers, sorted or in the order of discovery."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.memory import check_memory
from raystream.jit.constants import BYTES_64, ONE_U64, ZERO_U64
from raystream.jit.cpu import device, kernel
from raystream.jit.simd import address, i32x16, load, scratch, store
from raystream.kernels.growing_buffers import GrowingBuffers
from raystream.kernels.hits import HitArrays, HitBatch
from raystream.kernels.ray import world_t
from raystream.structures.batch_kernels import Batch, Calls
from raystream.structures.bvh.packet import TRACE_BYTES, trace_packet
from raystream.structures.bvh.packet_hits import (
    BUFFERS,
    COLLECTOR_BYTES,
    ENDS_BYTES,
    Buffers,
    Collector,
    Ends,
    has_room,
    sort_packet,
)
from raystream.structures.bvh.packet_leaf import ALL, COUNT, SURFACES
from raystream.structures.bvh.packet_load import load_packet
from raystream.structures.bvh.packet_rays import (
    GROUPS,
    PACKET_BYTES,
    PACKET_RAYS,
    Group,
    GroupLanes,
    group_rows,
    t_transform,
)

if TYPE_CHECKING:
    from raystream.structures.base import Structure

_LANES = np.uint64(16)
_LANE = np.uint64(4)

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
    found : ndarray of shape (5, capacity), float32
        Hits in the order of discovery: t, u, v, and as int32 prim_id and ray.
    rows : HitArrays
        Sorted hits.
    ray_ids, splits : ndarray, int64
        The rays in the order of `rows`, and the ends of their rows.
    capacity : int
    addresses : ndarray, uint64
        All of these, and the capacity: `packet_hits.BUFFERS`.
    """

    found: NDArray[np.float32]
    rows: HitArrays
    ray_ids: NDArray[np.int64]
    splits: NDArray[np.int64]
    capacity: int
    addresses: NDArray[np.uint64]

    @classmethod
    def of(cls, capacity: int) -> PacketBuffers:
        """Buffers for a number of hits."""
        remedy = "give max_hits, or fewer rays at a time"
        check_memory(capacity * 36, f"multi_hit: a buffer of {capacity:,} hits would", remedy)
        rays = PACKETS_PER_CALL * PACKET_RAYS
        found, rows = np.empty((5, capacity), np.float32), HitArrays.empty(capacity)
        ids, splits = np.empty(rays, np.int64), np.zeros(rays + 1, np.int64)
        addresses = [array.ctypes.data for array in (*found, *rows, ids, splits)]
        return cls(found, rows, ids, splits, capacity, np.array([*addresses, capacity], np.uint64))

    def found_hits(self, count: int) -> HitBatch:
        """The hits in the order of discovery."""
        t, u, v, prim_bits, ray_bits = self.found[:, :count]
        hits = HitArrays(t, u, v, prim_bits.view(np.int32))
        return HitBatch(hits, None, ray_bits.view(np.int32), 0)

    def sorted_hits(self, ray_count: int) -> HitBatch:
        """The sorted hits."""
        return HitBatch(self.rows, self.splits[: ray_count + 1], self.ray_ids[:ray_count], 0)


def visit_all(structure: Structure, batch: Batch) -> Calls:
    """Deliver all hits of packets to the sink's visitor, in parts; see `BatchKernel`."""
    query, visitor, source = batch.query, batch.sink.visitor, batch.packets(structure.frame)
    assert visitor is not None
    goal = ALL + SURFACES if query.surfaces else ALL
    # Unsorted hits have 32-bit ray indices.
    sorts = query.is_ordered or len(batch.rays) >= 2**31
    tree, nowhere = structure.arrays, ZERO_U64

    def fill(begin: int, end: int, buffers: PacketBuffers) -> int:
        reached, used, ray_count = _collect_packets(
            begin, end, tree, source, goal, sorts, buffers.addresses, nowhere
        )
        if used:
            visitor(buffers.sorted_hits(ray_count) if sorts else buffers.found_hits(used))
        return int(reached)

    return GrowingBuffers(PacketBuffers.of, fill, FIRST_CAPACITY), ()


def count_all(structure: Structure, batch: Batch) -> Calls:
    """Count the hits of packets; see `BatchKernel`."""
    source, at = batch.packets(structure.frame), np.uint64(batch.sink.counts.ctypes.data)
    goal = COUNT + SURFACES if batch.query.surfaces else COUNT
    nowhere = np.zeros(BUFFERS.itemsize // 8, np.uint64)
    return _collect_packets, (structure.arrays, source, goal, False, nowhere, at)


@kernel
def _collect_packets(begin, end, tree, source, goal, sorts, buffers, counts):
    """Collect or count the hits of packets begin to end, until a packet's hits do not fit.

    Returns
    -------
    reached, used, ray_count : int
        The first unfinished packet; hits in the buffers, and rays if they are sorted.
    """
    packet = scratch(PACKET_BYTES)
    memory = scratch(TRACE_BYTES)
    hits = Collector(scratch(COLLECTOR_BYTES))
    ends = Ends(scratch(ENDS_BYTES))
    written, order = Buffers(address(buffers)), source.order
    room, used, ray_count = written.capacity, ZERO_U64, ZERO_U64
    hits.buffers, hits.capacity = address(buffers), room
    keeps = goal & ONE_U64 == ONE_U64
    for number in range(np.uint64(begin), np.uint64(end)):
        slow_groups = load_packet(packet, number, source)
        hits.count = ZERO_U64 if sorts else used
        is_final = not sorts and slow_groups == ZERO_U64
        _number_rays(hits, number, order, is_final)
        if not keeps:
            _clear_counts(packet)
        most = source.frame.max_coordinate
        trace_packet(packet, GROUPS, tree, most, memory, goal, hits, None)
        if not keeps:
            _store_counts(packet, number, order, counts)
            continue
        count = hits.count
        if not has_room(hits) or (sorts and used + count > room):
            return np.int64(number), np.int64(used), np.int64(ray_count)
        if sorts:
            row = used
            used = sort_packet(hits, ends, used)
            ray_count = _finish_rows(
                packet, number, order, slow_groups, ends, row, written, ray_count
            )
        else:
            if not is_final:
                _finish_found(packet, number, order, slow_groups, used, count, written)
            used = count
    return np.int64(end), np.int64(used), np.int64(ray_count)


@device
def _clear_counts(packet):
    for g in range(GROUPS):
        Group(packet, g).prim_id = i32x16(np.int32(0))


@device
def _store_counts(packet, number, order, counts):
    for g in range(GROUPS):
        first, count = group_rows(order, number, g)
        found = GroupLanes(packet, g).prim_id
        for lane in range(count):
            store(counts + (first + lane) * BYTES_64, np.int64(found[lane]))


@device
def _finish_rows(packet, number, order, slow_groups, ends, row, buffers, ray_count):
    """Convert a sorted packet's distances; write its rays and the ends of their rows."""
    t, ids, splits = buffers.rows.t, buffers.ray_ids, buffers.splits
    for g in range(GROUPS):
        first, count = group_rows(order, number, g)
        lanes, is_slow = GroupLanes(packet, g), (slow_groups >> g) & ONE_U64 == ONE_U64
        for lane in range(count):
            t_scale, t_offset = t_transform(lanes, lane, is_slow)
            row_end = ends.ends[g * _LANES + lane]
            while row != row_end:
                at = t + row * _LANE
                store(at, world_t(load(np.float32, at), t_scale, t_offset))
                row += ONE_U64
            store(ids + ray_count * BYTES_64, np.int64(first + lane))
            ray_count += ONE_U64
            store(splits + ray_count * BYTES_64, np.int64(row_end))
    return ray_count


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
def _finish_found(packet, number, order, slow_groups, begin, end, buffers):
    """Convert distances and ray indices of a packet with rays that took the slow path."""
    t, rays = buffers.found.t, buffers.found.ray
    for row in range(begin, end):
        ray = np.uint64(load(np.int32, rays + row * _LANE))
        g, lane = ray // _LANES, ray % _LANES
        is_slow = (slow_groups >> g) & ONE_U64 == ONE_U64
        t_scale, t_offset = t_transform(GroupLanes(packet, g), lane, is_slow)
        at = t + row * _LANE
        store(at, world_t(load(np.float32, at), t_scale, t_offset))
        first, _ = group_rows(order, number, g)
        store(rays + row * _LANE, np.int32(first + lane))
