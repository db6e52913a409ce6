"""Packets of 256 rays through triangles, height fields and spheres: the kernel for coherent rays.

A packet is loaded once and walks the trees one after another, as in `structures.bvh.packet`. What
its rays have found in one shortens their intervals in the next.
"""

from __future__ import annotations

import numpy as np

from raystream.jit.constants import NULL, ONE_U64, ZERO_U64
from raystream.jit.cpu import device, device_call
from raystream.jit.intrinsics import no_inline
from raystream.jit.simd import (
    absolute,
    bits_as_float,
    f64x16,
    float_as_bits,
    maximum,
    scratch,
)
from raystream.jit.views import view
from raystream.kernels.ray import MANTISSA_BITS, POWER_EXPONENT
from raystream.kernels.ray_source import load_direction, load_origin
from raystream.primitives.packet_leaves import (
    EXACT_BYTES,
    FIELD_BYTES,
    ExactGroup,
    ExactLanes,
    field_leaf,
    sphere_leaf,
)
from raystream.primitives.sphere import scaled
from raystream.structures.bvh.layout import TreeAddresses
from raystream.structures.bvh.packet import TRACE_BYTES, trace_packet
from raystream.structures.bvh.packet_load import load_directions, load_origins, load_packet
from raystream.structures.bvh.packet_queries import PacketScene
from raystream.structures.bvh.packet_rays import GROUPS, Group, GroupLanes, group_rows

_LANES = np.uint64(16)
_ONE, _NO_OFFSET = np.float64(1.0), np.float64(0.0)

#: The classes of a packet's rays.
_CLASSES = np.dtype([("classes", "i4", (int(GROUPS), 16))])
_Classes = view(_CLASSES)

# Offsets in the memory of a packet.
_CLASSES_AT = np.uint64(int(GROUPS) * EXACT_BYTES)
_FIELD_AT = _CLASSES_AT + np.uint64(_CLASSES.itemsize)
_MEMORY_BYTES = int(_FIELD_AT) + FIELD_BYTES


@device_call
def _load_few(exact, packet, g, first, count, source):
    """Load the rays of a group in float64, one by one, and what advanced their origins."""
    no_inline()
    lanes, group = ExactLanes(exact, g), GroupLanes(packet, g)
    for k in range(_LANES):
        i = first + min(k, count - ONE_U64)
        lanes.ox[k], lanes.oy[k], lanes.oz[k] = load_origin(source, i)
        x, y, z = load_direction(source, i)
        dx, dy, dz = scaled(x, y, z)
        lanes.dx[k], lanes.dy[k], lanes.dz[k] = dx, dy, dz
        lanes.inv_square[k] = _ONE / (dx * dx + dy * dy + dz * dz)
        lanes.offset[k] = group.slow_t_offset[k] / group.slow_t_scale[k]


@device
def _load_exact(exact, packet, number, source, slow_groups):
    """Load a packet's rays in float64; see `sphere.exact_ray`."""
    for g in range(GROUPS):
        first, count = group_rows(source.order, number, g)
        if count == ZERO_U64:
            continue
        if (slow_groups >> g) & ONE_U64 == ONE_U64:
            _load_few(exact, packet, g, first, count, source.rays)
            continue
        rays = ExactGroup(exact, g)
        rays.ox, rays.oy, rays.oz = load_origins(source.rays, first)
        dx, dy, dz = load_directions(source.rays, first)
        exponent = float_as_bits(maximum(maximum(absolute(dx), absolute(dy)), absolute(dz)))
        power = bits_as_float((-(exponent >> MANTISSA_BITS) + POWER_EXPONENT) << MANTISSA_BITS)
        dx, dy, dz = dx * power, dy * power, dz * power
        rays.dx, rays.dy, rays.dz = dx, dy, dz
        rays.inv_square = _ONE / (dx * dx + dy * dy + dz * dz)
        rays.offset = f64x16(_NO_OFFSET)


@device
def _load(packet, number, source, scene, memory):
    slow_groups = load_packet(packet, number, source)
    classes = _Classes(memory + _CLASSES_AT).classes
    for g in range(GROUPS):
        classes[g] = Group(packet, g).direction_class
    if scene.sphere_nodes != NULL:
        _load_exact(memory, packet, number, source, slow_groups)
    return slow_groups, source.frame


@device
def _search_again(packet, memory):
    """Make a packet that has been traced ready for another tree."""
    classes = _Classes(memory + _CLASSES_AT).classes
    for g in range(GROUPS):
        Group(packet, g).direction_class = classes[g]


@device
def _trace(packet, scene, frame, memory, leaf):
    most, own = frame.max_coordinate, scratch(TRACE_BYTES)
    if scene.nodes != NULL:
        trace_packet(packet, GROUPS, TreeAddresses(scene.nodes, scene.leaves), most, own, leaf)
        _search_again(packet, memory)
    if scene.field_nodes != NULL:
        tree = TreeAddresses(scene.field_nodes, scene.fields)
        trace_packet(packet, GROUPS, tree, most, own, field_leaf(leaf, memory + _FIELD_AT))
        _search_again(packet, memory)
    if scene.sphere_nodes != NULL:
        tree = TreeAddresses(scene.sphere_nodes, scene.sphere_blocks)
        trace_packet(packet, GROUPS, tree, most, own, sphere_leaf(leaf, memory, frame))


#: Of the trees of `PrimitiveAddresses`.
PRIMITIVES = PacketScene(_load, _trace, _MEMORY_BYTES)
