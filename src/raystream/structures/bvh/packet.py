"""Packets of 256 rays: the kernel for rays that go nearly the same way.

The bounds of a packet's origins and reciprocal directions form an interval ray: one test of
eight boxes against it rejects the children that no ray of the packet can enter. Those left
are tested exactly, 16 rays at a time, up to the first group that enters and down to the last
one; these go on the stack with the child, and bound the work below ("ranged traversal"). At a
leaf, 16 rays are tested against one triangle at a time.

The rays of a pass share an octant and the largest axis of their directions; a packet of
several kinds takes a pass for each.

References
----------
Overbeck, Ramamoorthi and Mark, "Large Ray Packets for Real-time Whitted Ray Tracing", IEEE
Symposium on Interactive Ray Tracing 2008 (ranged traversal); Boulos, Wald and Shirley,
"Geometric and Arithmetic Culling Methods for Entire Ray Packets", 2006 (interval test).
"""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device, kernel
from raystream.jit.simd import (
    f32x16,
    first_bit,
    float_as_bits,
    i32x16,
    lane_bits,
    load,
    maximum,
    minimum,
    reduce_max,
    reduce_min,
    scratch,
    select,
    store,
)
from raystream.kernels.leaf_block import AXIS
from raystream.structures.bvh.layout import STACK_SIZE
from raystream.structures.bvh.packet_bounds import enters, packet_bounds
from raystream.structures.bvh.packet_leaf import ANY, FIRST, group_range, visit_leaf
from raystream.structures.bvh.packet_load import load_packet
from raystream.structures.bvh.packet_rays import (
    CLASS,
    GROUP,
    GROUPS,
    LIVE_T,
    NO_CLASS,
    PACKET_BYTES,
    T_MIN,
    T,
)
from raystream.structures.bvh.packet_store import store_packet
from raystream.structures.bvh.wide import CHILDREN, LANE, NODE

__all__ = ["TRACE_BYTES", "trace_packet", "trace_packets"]

_ZERO = np.float32(0.0)
_INF = np.float32(np.inf)
_U0 = np.uint64(0)
_U1 = np.uint64(1)
_U2 = np.uint64(2)
_NO_LIMIT = np.int32(2**31 - 1)

# A stack entry: the child, its key, the first and the last group that enter it, and the
# address of its lane in its parent, where its box is.
_ENTRY = np.uint64(24)
_KEY = np.uint64(4)
_GROUPS = np.uint64(8)
_BOX = np.uint64(16)

# Of the groups: bits of the first one, and where the last one's begin.
_FIRST_BITS = np.uint64(255)
_LAST = np.uint64(8)

# The memory that tracing a packet needs: distances of a node's children, planes of a block's
# triangles, the stack with an entry below its bottom.
_PLANES = np.uint64(64)
_STACK = np.uint64(64 + 128 + 24)
TRACE_BYTES = 64 + 128 + 24 * (STACK_SIZE + 9)


@device
def _farthest(packet):
    """The farthest t that any live ray of the packet still looks at; -inf when none is."""
    t = load(f32x16, packet + LIVE_T)
    for g in range(_U1, GROUPS):
        t = maximum(load(f32x16, packet + g * GROUP + LIVE_T), t)
    return reduce_max(t)


@device
def _push(stack, top, child, key, groups, box):
    """Put a child on the stack, under those of its node that are nearer; returns the top."""
    at = top
    while load(np.int32, at - _ENTRY + _KEY) < key and at != stack:
        below = at - _ENTRY
        store(at, load(np.int64, below))
        store(at + _GROUPS, load(np.uint64, below + _GROUPS))
        store(at + _BOX, load(np.uint64, below + _BOX))
        at = below
    store(at, child)
    store(at + _KEY, key)
    store(at + _GROUPS, groups)
    store(at + _BOX, box)
    return top + _ENTRY


@device
def _trace_kind(packet, kind, nodes, leaves, extreme, memory, goal, hits):
    """Trace the rays of one kind: the pass of a packet."""
    x, y, z = packet_bounds(packet, kind, extreme)
    distances, planes, stack = memory, memory + _PLANES, memory + _STACK
    kz = np.uint64(kind & np.int32(3))
    kx = kz + _U1 if kz < _U2 else _U0
    ky = kx + _U1 if kx < _U2 else _U0
    axes = (kx * AXIS, ky * AXIS, kz * AXIS)
    t_min_low = f32x16(_INF)
    for g in range(GROUPS):
        rays = packet + g * GROUP
        mine = load(i32x16, rays + CLASS) == kind
        store(rays + LIVE_T, select(mine, load(f32x16, rays + T), f32x16(-_INF)))
        t_min_low = select(mine, minimum(load(f32x16, rays + T_MIN), t_min_low), t_min_low)
    t_min = reduce_min(t_min_low)
    farthest = _farthest(packet)
    limit = float_as_bits(farthest) if farthest >= _ZERO else _NO_LIMIT

    top = stack
    child, first, last, box = np.int32(0), _U0, GROUPS - _U1, _U0
    while True:
        if child >= np.int32(0):
            node = nodes + np.uint64(child) * NODE
            t_in, entered = enters(node, x, y, z, t_min, farthest)
            bits = lane_bits(entered)
            if bits != _U0:
                store(distances, maximum(t_in, _ZERO))
                base = top
                while bits != _U0:
                    at = first_bit(bits) * LANE
                    bits &= bits - _U1
                    begin, end = group_range(packet, node + at, x, y, z, t_min, first, last)
                    if begin <= end:
                        top = _push(
                            base,
                            top,
                            load(np.int32, node + CHILDREN + at),
                            load(np.int32, distances + at),
                            begin | (end << _LAST),
                            node + at,
                        )
        elif visit_leaf(
            packet, child, leaves, box, x, y, z, t_min, first, last, axes, planes, goal, hits
        ):
            farthest = _farthest(packet)
            if farthest == -_INF:
                break
            limit = float_as_bits(farthest) if farthest >= _ZERO else _NO_LIMIT
        # The nearest child that some ray may still need.
        while top != stack:
            top -= _ENTRY
            if load(np.int32, top + _KEY) <= limit:
                break
            if top == stack:
                top = _U0
                break
        else:
            break
        if top == _U0:
            break
        child = load(np.int32, top)
        groups = load(np.uint64, top + _GROUPS)
        first, last = groups & _FIRST_BITS, groups >> _LAST
        box = load(np.uint64, top + _BOX)

    for g in range(GROUPS):
        rays = packet + g * GROUP
        mine = load(i32x16, rays + CLASS) == kind
        store(rays + T, select(mine, load(f32x16, rays + LIVE_T), load(f32x16, rays + T)))
        store(rays + CLASS, select(mine, i32x16(NO_CLASS), load(i32x16, rays + CLASS)))


@device
def _next_kind(packet):
    """The kind of the first ray that has not been traced, or NO_CLASS."""
    for g in range(GROUPS):
        kinds = load(i32x16, packet + g * GROUP + CLASS)
        bits = lane_bits(kinds != NO_CLASS)
        if bits != _U0:
            return load(np.int32, packet + g * GROUP + CLASS + first_bit(bits) * LANE)
    return NO_CLASS


@device
def trace_packet(packet, nodes, leaves, extreme, memory, goal, hits):
    """Trace a packet that was loaded.

    Parameters
    ----------
    packet : uint64
        Address, see `packet_rays`.
    nodes, leaves : uint64
    extreme : float32
    memory : uint64
        Address of `TRACE_BYTES` bytes.
    goal : uint64
        `FIRST`, `ANY`, `COUNT` or `ALL` hits, see `packet_leaf`.
    hits : uint64
        Address of the collected hits, if all of them are wanted.
    """
    kind = _next_kind(packet)
    while kind != NO_CLASS:
        _trace_kind(packet, kind, nodes, leaves, extreme, memory, goal, hits)
        kind = _next_kind(packet)


@kernel
def trace_packets(begin, end, nodes, leaves, frame, source, order, wants_any, out):
    """Trace packets begin to end.

    Parameters
    ----------
    begin, end : int
    nodes, leaves : int
        Addresses of the tree, see `layout.BvhArrays`; it must not be empty.
    frame : SceneFrame
    source : RaySource
    order : PacketOrder
    wants_any : bool
        Find whether there is a hit, else the nearest one.
    out : ResultAddresses
    """
    packet = scratch(PACKET_BYTES)
    memory = scratch(TRACE_BYTES)
    goal = ANY if wants_any else FIRST
    for number in range(np.uint64(begin), np.uint64(end)):
        long_groups = load_packet(packet, number, order, source, frame, out.status)
        trace_packet(packet, nodes, leaves, frame.extreme, memory, goal, _U0)
        store_packet(packet, number, order, long_groups, wants_any, out)
