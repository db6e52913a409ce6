"""All hits of packets, however many: buffers that grow, and rows in the order of the batch."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.memory import check_memory
from raystream.jit.cpu import kernel
from raystream.jit.simd import load, scratch, store
from raystream.jit.threads import Progress, parallel_for
from raystream.kernels.collect import HitArrays
from raystream.kernels.local_ray import SceneFrame, world_t
from raystream.kernels.ray_source import RaySource
from raystream.structures.bvh.packet import TRACE_BYTES, trace_packet
from raystream.structures.bvh.packet_hits import (
    ADDRESSES,
    CAPACITY,
    COLLECTOR_BYTES,
    COUNT_AT,
    ENDS_BYTES,
    LANES_AT,
    has_room,
    sort_packet,
)
from raystream.structures.bvh.packet_leaf import ALL, COUNT, SURFACES
from raystream.structures.bvh.packet_load import load_packet
from raystream.structures.bvh.packet_rays import (
    FACTOR,
    GROUP,
    GROUPS,
    LONG_FACTOR,
    LONG_OFFSET,
    PACKET_BYTES,
    PRIM,
    PacketOrder,
    group_rows,
)

__all__ = ["Part", "Rows", "collect_all", "count_all", "place_all"]

_U0 = np.uint64(0)
_U1 = np.uint64(1)
_LANES = np.uint64(16)
_LANE = np.uint64(4)
_WORD = np.uint64(8)

#: Packets that one call gets: 8,192 rays.
PACKETS_PER_CALL = 32

#: Hits that a buffer holds at first.
_FIRST_CAPACITY = 1 << 16


class _Buffers(NamedTuple):
    """Memory of one call: hits as they are found, and sorted rows."""

    found: NDArray[np.float32]
    rows: HitArrays

    @classmethod
    def of(cls, capacity: int) -> _Buffers:
        remedy = "give max_hits, or fewer rays at a time"
        check_memory(capacity * 36, f"multi_hit: a buffer of {capacity:,} hits would", remedy)
        return cls(np.empty((5, capacity), np.float32), HitArrays.empty(capacity))

    def addresses(self) -> NDArray[np.uint64]:
        arrays = (*self.found, *self.rows)
        return np.array([array.ctypes.data for array in arrays], np.uint64)


class Part(NamedTuple):
    """Rows of the packets first to end."""

    first: int
    end: int
    rows: HitArrays


#: What `collect_all` found: parts in any order.
Rows = list[Part]


def collect_all(
    addresses: tuple[np.uint64, np.uint64],
    frame: SceneFrame,
    source: RaySource,
    order: PacketOrder,
    packet_count: int,
    surfaces: bool,
    lists_twice: bool,
    status: NDArray[np.uint8],
    progress: Progress | None,
) -> tuple[NDArray[np.int64], Rows]:
    """Find all hits of the rays of a batch.

    Returns
    -------
    counts : ndarray of shape (N,), int64
        Hits of each ray.
    parts : list
        For `place_all`.
    """
    counts = np.zeros(int(order.ray_count), np.int64)
    written = np.uint64(counts.ctypes.data), np.uint64(status.ctypes.data)
    goal = ALL + SURFACES if surfaces else ALL
    parts: Rows = []
    spare: list[_Buffers] = []  # one for each thread that is between two calls

    def body(begin: int, end: int) -> None:
        capacity = _FIRST_CAPACITY
        while begin < end or begin == end == 0:
            try:
                buffers = spare.pop()
            except IndexError:
                buffers = _Buffers.of(capacity)
            capacity = max(capacity, len(buffers.rows.t))
            if len(buffers.rows.t) < capacity:
                buffers = _Buffers.of(capacity)
            reached, used, needed = _collect_packets(
                begin,
                end,
                *addresses,
                frame,
                source,
                order,
                goal,
                lists_twice,
                buffers.addresses(),
                capacity,
                *written,
            )
            if used:
                t, u, v, prim_id = buffers.rows.part(slice(int(used)))
                rows = HitArrays(t.copy(), u.copy(), v.copy(), prim_id.copy())
                parts.append(Part(begin, reached, rows))
            if begin == end:
                return
            if reached == begin:
                capacity = needed + needed // 4
            else:
                spare.append(buffers)
            begin = reached

    parallel_for(body, packet_count, PACKETS_PER_CALL, progress)
    return counts, parts


def place_all(parts: Rows, order: PacketOrder, splits: NDArray[np.int64], out: HitArrays) -> None:
    """Copy the rows of `collect_all` to those of their rays."""

    def body(begin: int, end: int) -> None:
        if begin == end:  # compile
            _place_packets(0, 0, order, HitArrays.empty(0), splits, out)
        for part in parts[begin:end]:
            _place_packets(part.first, part.end, order, part.rows, splits, out)

    parallel_for(body, len(parts), 1)


def count_all(
    addresses: tuple[np.uint64, np.uint64],
    frame: SceneFrame,
    source: RaySource,
    order: PacketOrder,
    packet_count: int,
    surfaces: bool,
    status: NDArray[np.uint8],
    progress: Progress | None,
) -> NDArray[np.int64]:
    """Count the hits of the rays of a batch, of a tree without triangles listed twice."""
    counts = np.zeros(int(order.ray_count), np.int64)
    written = np.uint64(counts.ctypes.data), np.uint64(status.ctypes.data)
    goal = COUNT + SURFACES if surfaces else COUNT
    nowhere = np.zeros(9, np.uint64)

    def body(begin: int, end: int) -> None:
        _collect_packets(
            begin, end, *addresses, frame, source, order, goal, False, nowhere, 0, *written
        )

    parallel_for(body, packet_count, PACKETS_PER_CALL, progress)
    return counts


@kernel
def _collect_packets(
    begin,
    end,
    nodes,
    leaves,
    frame,
    source,
    order,
    goal,
    lists_twice,
    buffers,
    capacity,
    counts,
    status,
):
    """Collect or count the hits of packets begin to end, as far as the buffers reach.

    Returns
    -------
    reached, used, needed : int
        The first packet that was not traced to its end, rows in use, and the hits of that
        packet.
    """
    packet = scratch(PACKET_BYTES)
    memory = scratch(TRACE_BYTES)
    hits = scratch(COLLECTOR_BYTES)
    ends = scratch(ENDS_BYTES)
    room = np.uint64(capacity)
    for k in range(np.uint64(9)):
        store(hits + ADDRESSES + k * _WORD, buffers[k])
    for k in range(_LANES):
        store(hits + LANES_AT + k * _LANE, np.int32(k))
    store(hits + CAPACITY, room)
    used = _U0
    keeps = goal & _U1 == _U1
    for number in range(np.uint64(begin), np.uint64(end)):
        long_groups = load_packet(packet, number, order, source, frame, status)
        store(hits + COUNT_AT, _U0)
        if not keeps:
            for g in range(GROUPS):
                for lane in range(_LANES):
                    store(packet + g * GROUP + PRIM + lane * _LANE, np.int32(0))
        trace_packet(packet, nodes, leaves, frame.extreme, memory, goal, hits)
        if keeps:
            count = load(np.uint64, hits + COUNT_AT)
            if not has_room(hits) or used + count > room:
                return np.int64(number), np.int64(used), np.int64(count + _LANES)
            row = used
            used = sort_packet(hits, ends, used, lists_twice)
        for g in range(GROUPS):
            first, count = group_rows(order, number, g)
            group = packet + g * GROUP
            for lane in range(count):
                to = counts + (first + lane) * _WORD
                if not keeps:
                    store(to, np.int64(load(np.int32, group + PRIM + lane * _LANE)))
                    continue
                row_end = load(np.uint64, ends + (g * _LANES + lane) * _WORD)
                store(to, np.int64(row_end - row))
                factor = np.float64(load(np.float32, group + FACTOR + lane * _LANE))
                offset = np.float64(0.0)
                if (long_groups >> g) & _U1 == _U1:
                    factor = load(np.float64, group + LONG_FACTOR + lane * _WORD)
                    offset = load(np.float64, group + LONG_FACTOR + LONG_OFFSET + lane * _WORD)
                t = buffers[5]
                while row != row_end:
                    at = t + row * _LANE
                    store(at, world_t(load(np.float32, at), factor, offset))
                    row += _U1
    return np.int64(end), np.int64(used), np.int64(0)


@kernel
def _place_packets(begin, end, order, rows, splits, out):
    """Copy the rows of packets begin to end to those of their rays."""
    row = _U0
    for number in range(np.uint64(begin), np.uint64(end)):
        for g in range(GROUPS):
            first, count = group_rows(order, number, g)
            for ray in range(first, first + count):
                for to in range(np.uint64(splits[ray]), np.uint64(splits[ray + _U1])):
                    out.t[to] = rows.t[row]
                    out.u[to] = rows.u[row]
                    out.v[to] = rows.v[row]
                    out.prim_id[to] = rows.prim_id[row]
                    row += _U1
