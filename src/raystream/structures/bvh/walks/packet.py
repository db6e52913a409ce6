"""Packets of 256 rays: the walk for coherent rays.

The bounds of a packet's origins and reciprocal directions form an interval ray: one test of
eight boxes against it culls the children that no ray of the packet can enter. The others are
tested exactly, 16 rays at a time, by the groups that entered their node; those that enter a child
are pushed with it, as bits. In a leaf, 16 rays are tested against one triangle at a time.

The rays of a pass share a direction class: the octant and the largest axis of the direction. A
packet takes a pass per class.

References
----------
Overbeck, Ramamoorthi and Mark, "Large Ray Packets for Real-time Whitted Ray Tracing", IEEE
Symposium on Interactive Ray Tracing 2008 (active rays per node); Boulos, Wald and Shirley,
"Geometric and Arithmetic Culling Methods for Entire Ray Packets", 2006 (interval test).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.jit.constants import INF_F32, ONE_U64, TWO_U64, ZERO_F32, ZERO_U64
from raystream.jit.cpu import device
from raystream.jit.simd import (
    count_trailing_zeros,
    f32x16,
    float_as_bits,
    fma,
    mask_bits,
    maximum,
    minimum,
    reduce_max,
    reduce_min,
    select,
)
from raystream.jit.views import address_of, view
from raystream.kernels.ray import PAD
from raystream.structures.bvh.layout import STACK_SIZE
from raystream.structures.bvh.node_layout import NODE, Node, NodeLanes
from raystream.structures.bvh.packets.leaf import LEAF_SCRATCH, box_planes, entering_groups
from raystream.structures.bvh.packets.rays import NO_CLASS, Group, GroupLanes

_TWO = np.float32(2.0)
_NO_LIMIT = np.int32(2**31 - 1)

#: Minus a direction class: of rays that have been traced.
_TRACED = np.int32(-2)

#: A stack entry: a child, its key, bits of the groups that enter it, and the lane and node of its
#: box.
_ENTRY = np.dtype(
    [
        ("child", "i4"),
        ("key", "i4"),
        ("groups", "u4"),
        ("lane", "u4"),
        ("node", "u8"),
    ]
)
_Entry = view(_ENTRY)
_EntryWords = view([("words", "u8", 3)])

#: Scratch of `trace_packet`: keys of a node's children, the scratch of a leaf; behind it
#: the stack.
_MEMORY = np.dtype([("keys", "i4", 8), ("leaf", LEAF_SCRATCH)])
_Memory = view(_MEMORY)
_Keys = view([("keys", "i4", (8, 1))])
_MEMORY_BYTES = np.uint64(_MEMORY.itemsize)
TRACE_BYTES = _MEMORY.itemsize + _ENTRY.itemsize * (STACK_SIZE + 8)


class AxisBounds(NamedTuple):
    """The interval ray of a pass along an axis.

    Attributes
    ----------
    near, far : uint64
        The rows of a node's planes that the rays enter and leave by.
    low, high : float32
        Of the reciprocal directions.
    near_low, near_high, far_low, far_high : float32
        The slab constants for `low` and `high`.
    back : bool
        Whether directions are negative.
    """

    near: np.uint64
    far: np.uint64
    low: np.float32
    high: np.float32
    near_low: np.float32
    near_high: np.float32
    far_low: np.float32
    far_high: np.float32
    back: bool


class RayClass(NamedTuple):
    """The rays of a pass: those of a packet with one direction class.

    Attributes
    ----------
    x, y, z : AxisBounds
    kx, ky, kz : uint64
        Axes of their frames; see `kernels.ray.Ray`.
    t_min : float32
        Minimum of all rays.
    """

    x: AxisBounds
    y: AxisBounds
    z: AxisBounds
    kx: np.uint64
    ky: np.uint64
    kz: np.uint64
    t_min: np.float32


@device
def _extremes(packet, count, direction_class, axis):
    """Bounds of the rays of a class along an axis."""
    least_inv, most_inv = f32x16(INF_F32), f32x16(-INF_F32)
    least_o, most_o = f32x16(INF_F32), f32x16(-INF_F32)
    for g in range(count):
        group = Group(packet, g)
        mine = group.direction_class == direction_class
        inv, o = group.inv[axis], group.origin[axis]
        least_inv = select(mine, minimum(inv, least_inv), least_inv)
        most_inv = select(mine, maximum(inv, most_inv), most_inv)
        least_o = select(mine, minimum(o, least_o), least_o)
        most_o = select(mine, maximum(o, most_o), most_o)
    low, high = reduce_min(least_inv), reduce_max(most_inv)
    origin_low, origin_high = reduce_min(least_o), reduce_max(most_o)
    return low, high, origin_low, origin_high


@device
def _slab_bounds(axis, low, high, origin_low, origin_high, pad):
    """Constants of the interval ray; twice the rays' padding covers its own rounding."""
    near = axis << ONE_U64
    back = high < ZERO_F32
    if back:
        near |= ONE_U64
        from_near, from_far = origin_low - pad, origin_high + pad
    else:
        from_near, from_far = origin_high + pad, origin_low - pad
    return AxisBounds(
        near,
        near ^ ONE_U64,
        low,
        high,
        -(from_near * low),
        -(from_near * high),
        -(from_far * low),
        -(from_far * high),
        back,
    )


@device
def _near_of(node, b):
    planes = node.planes[b.near]
    return minimum(fma(planes, b.low, b.near_low), fma(planes, b.high, b.near_high))


@device
def _far_of(node, b):
    planes = node.planes[b.far]
    return maximum(fma(planes, b.low, b.far_low), fma(planes, b.high, b.far_high))


@device
def _ray_class(packet, count, direction_class, max_coordinate):
    """Begin the pass of a class: activate its rays; returns their `RayClass`."""
    lx, hx, olx, ohx = _extremes(packet, count, direction_class, ZERO_U64)
    ly, hy, oly, ohy = _extremes(packet, count, direction_class, ONE_U64)
    lz, hz, olz, ohz = _extremes(packet, count, direction_class, TWO_U64)
    reach = max(abs(olx), abs(ohx), abs(oly), abs(ohy), abs(olz), abs(ohz))
    pad = _TWO * PAD * (max_coordinate + reach)
    kz = np.uint64(direction_class & np.int32(3))
    kx = kz + ONE_U64 if kz < TWO_U64 else ZERO_U64
    ky = kx + ONE_U64 if kx < TWO_U64 else ZERO_U64
    t_min = f32x16(INF_F32)
    for g in range(count):
        group = Group(packet, g)
        mine = group.direction_class == direction_class
        group.t_active = select(mine, group.t, f32x16(-INF_F32))
        t_min = select(mine, minimum(group.t_min, t_min), t_min)
    return RayClass(
        _slab_bounds(ZERO_U64, lx, hx, olx, ohx, pad),
        _slab_bounds(ONE_U64, ly, hy, oly, ohy, pad),
        _slab_bounds(TWO_U64, lz, hz, olz, ohz, pad),
        kx,
        ky,
        kz,
        reduce_min(t_min),
    )


@device
def _enters(node, rays, t_max):
    """Test a node's eight boxes against the interval ray.

    Returns
    -------
    t_in : f32x8
        Lower bounds of the distances at which the boxes are entered.
    mask : mask8
        The boxes that some ray may enter between its t_min and `t_max`.
    """
    x, y, z = rays.x, rays.y, rays.z
    t_in = maximum(maximum(_near_of(node, x), _near_of(node, y)), _near_of(node, z))
    t_out = minimum(minimum(_far_of(node, x), _far_of(node, y)), _far_of(node, z))
    return t_in, maximum(t_in, rays.t_min) <= minimum(t_out, t_max)


@device
def _farthest(packet, count):
    """The farthest t that an active ray of the packet searches; -inf if none is active."""
    t = Group(packet, ZERO_U64).t_active
    for g in range(ONE_U64, count):
        t = maximum(Group(packet, g).t_active, t)
    return reduce_max(t)


@device
def _push(stack, base, top, child, key, groups, node, lane):
    """Push a child below the nearer ones of its node; returns the stack's height."""
    at = top
    while at != base and _Entry(stack, at - ONE_U64).key < key:
        _EntryWords(stack, at).words = _EntryWords(stack, at - ONE_U64).words
        at -= ONE_U64
    entry = _Entry(stack, at)
    entry.child, entry.key = child, key
    entry.groups, entry.node, entry.lane = np.uint32(groups), node, np.uint32(lane)
    return top + ONE_U64


@device
def _next_class(packet, count):
    """The class of the first ray that has not been traced, or NO_CLASS."""
    for g in range(count):
        bits = mask_bits(Group(packet, g).direction_class > NO_CLASS)
        if bits != ZERO_U64:
            return GroupLanes(packet, g).direction_class[count_trailing_zeros(bits)]
    return NO_CLASS


@device
def continue_packet(packet, count):
    """Make a packet that has been traced ready for another tree."""
    for g in range(count):
        group = Group(packet, g)
        known = group.direction_class
        group.direction_class = select(known < NO_CLASS, _TRACED - known, known)


def packet_walk():
    """Make the function that traces a packet: one for each level of trees, as none calls itself.

    Returns
    -------
    device function
        ``trace_packet(packet, count, tree, max_coordinate, memory, leaf)``, see there.
    """

    @device
    def visit_node(packet, node, rays, farthest, groups, tree, memory, top, leaf):
        """Push a node's children that a ray enters; returns the stack's height."""
        t_in, entered = _enters(Node(node), rays, farthest)
        bits = mask_bits(entered)
        if bits != ZERO_U64:
            memory.keys = float_as_bits(maximum(t_in, ZERO_F32))
            keys, children = _Keys(address_of(memory)).keys, NodeLanes(node).children
            stack, base = address_of(memory) + _MEMORY_BYTES, top
            while bits != ZERO_U64:
                lane = count_trailing_zeros(bits)
                bits &= bits - ONE_U64
                leaf.prefetch(children[lane], tree.nodes, tree.leaves)
                planes = box_planes(node, lane, rays)
                entering = entering_groups(packet, planes, rays, groups)
                if entering != ZERO_U64:
                    top = _push(stack, base, top, children[lane], keys[lane], entering, node, lane)
        return top

    @device
    def trace_class(packet, count, direction_class, tree, max_coordinate, memory, leaf):
        """Trace the rays of one class: a pass of a packet."""
        rays = _ray_class(packet, count, direction_class, max_coordinate)
        farthest = _farthest(packet, count)
        limit = float_as_bits(farthest) if farthest >= ZERO_F32 else _NO_LIMIT

        stack, memory = memory + _MEMORY_BYTES, _Memory(memory)
        top, child, node, lane = ZERO_U64, np.int32(0), ZERO_U64, ZERO_U64
        groups = (ONE_U64 << count) - ONE_U64
        while True:
            if child >= np.int32(0):
                node = tree.nodes + np.uint64(child) * NODE
                top = visit_node(packet, node, rays, farthest, groups, tree, memory, top, leaf)
            else:
                box, own = box_planes(node, lane, rays), memory.leaf
                if leaf.visit(leaf, packet, child, tree.leaves, box, rays, groups, own):
                    farthest = _farthest(packet, count)
                    if farthest == -INF_F32:
                        break
                    limit = float_as_bits(farthest) if farthest >= ZERO_F32 else _NO_LIMIT
            # Pop the nearest child within the search interval.
            while top != ZERO_U64 and _Entry(stack, top - ONE_U64).key > limit:
                top -= ONE_U64
            if top == ZERO_U64:
                break
            top -= ONE_U64
            entry = _Entry(stack, top)
            child, groups = entry.child, np.uint64(entry.groups)
            node, lane = entry.node, np.uint64(entry.lane)

        for g in range(count):
            group = Group(packet, g)
            known = group.direction_class
            mine = known == direction_class
            group.t = select(mine, group.t_active, group.t)
            group.direction_class = select(mine, _TRACED - known, known)

    @device
    def trace_packet(packet, count, tree, max_coordinate, memory, leaf):
        """Trace a loaded packet.

        Parameters
        ----------
        packet : uint64
            Address, see `packets.rays`.
        count : uint64
            Its groups, at least 1.
        tree : NamedTuple
            With addresses of ``nodes`` and ``leaves``.
        max_coordinate : float32
        memory : uint64
            Address of `TRACE_BYTES` bytes.
        leaf : NamedTuple
            What leaves are, and what becomes of their hits. It has two device functions:
            ``visit(leaf, packet, child, leaves, box, rays, groups, own)``, for which see
            `packets.leaf.visit_leaf`, tests a leaf and returns whether a ray's search is shorter
            now; ``prefetch(child, nodes, leaves)`` is `node_layout.prefetch_child` for trees that
            do not fit into the cache, else `leaf_kinds.no_prefetch`.
        """
        direction_class = _next_class(packet, count)
        while direction_class != NO_CLASS:
            trace_class(packet, count, direction_class, tree, max_coordinate, memory, leaf)
            direction_class = _next_class(packet, count)

    return trace_packet


trace_packet = packet_walk()
