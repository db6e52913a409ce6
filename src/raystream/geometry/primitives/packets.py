"""Packets of 256 rays through triangles, height fields, spheres and shapes: for coherent rays.

A packet is loaded once and walks four trees, one after another: what its rays have found in one
shortens their intervals in the next. A sphere is tested against sixteen rays. Height fields are the
leaves of a tree over all of them; in each, groups of the packet descend the field's own tree of
blocks of cells, and the triangles of a row of cells are written as leaf blocks, once for all rays.
All hits go where those of the leaves of triangles do.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from raystream.core.shapes import MOST_HITS
from raystream.geometry.fields.cells import PACKET_BYTES, field_walk, fill_row
from raystream.geometry.primitives.records import (
    SPHERES_PER_BLOCK,
    FieldRecord,
    SphereBlockLanes,
)
from raystream.geometry.shapes.shape import local_t, place_at, shape_of
from raystream.geometry.shapes.shape import own_box as shape_box
from raystream.geometry.spheres.sphere import HIT, ExactRay, intersect, load_exact, own_box, place
from raystream.jit.constants import (
    NULL,
    ONE_U64,
    SHIFT_32,
    SHIFT_64,
    THREE_U64,
    TWO_U64,
    ZERO_U64,
)
from raystream.jit.cpu import device
from raystream.jit.simd import (
    count_trailing_zeros,
    lane,
    lanes_from_bits,
    load,
    mask16,
    mask_bits,
    scratch,
    store,
)
from raystream.jit.views import view
from raystream.kernels.ray import SceneFrame
from raystream.kernels.shapes import CROSSINGS_BYTES, crossings
from raystream.kernels.triangle_lanes import planes_along, slab_interval
from raystream.structures.bvh.layout import TreeAddresses
from raystream.structures.bvh.leaf_kinds import no_prefetch
from raystream.structures.bvh.node_layout import leaf_address, prefetch_child
from raystream.structures.bvh.packets.leaf import TriangleLeaf, entering_groups
from raystream.structures.bvh.packets.load import load_packet
from raystream.structures.bvh.packets.queries import PacketScene
from raystream.structures.bvh.packets.rays import (
    GROUPS,
    Group,
    GroupLanes,
    group_rows,
    t_transform,
    three,
)
from raystream.structures.bvh.walks.packet import TRACE_BYTES, continue_packet, trace_packet

_FOUR, _LANES = np.uint64(4), np.uint64(16)
_FIELD_SHIFT = np.int32(3)
_SPHERES = np.uint64(SPHERES_PER_BLOCK)

#: Sixteen rays in float64, see `sphere.ExactRay`; and the same with a lane index.
_EXACT = {"origin": (3, 16), "direction": (3, 16), "inv_square": (16,), "offset": (16,)}
_Exact = view([(name, "f8", shape) for name, shape in _EXACT.items()])
_ExactLanes = view([(name, "f8", (*shape, 1)) for name, shape in _EXACT.items()])
_EXACT_BYTES = 16 * 8 * 8 * int(GROUPS)

#: Hits of sixteen rays with a sphere.
_Hits = view([(name, kind, 16) for name, kind in HIT])
_HITS_BYTES = 16 * 40


#: The link of a leaf of two blocks, of which the first one is the first of all.
_TWO_BLOCKS = np.int32(~1)


class PrimitiveLeaf(NamedTuple):
    """Leaves of spheres, of shapes, or of height fields; see `walks.packet.trace_packet`.

    Attributes
    ----------
    visit, prefetch : device function
    hits : TriangleLeaf
        Takes the hits, and tests the triangles of cells.
    memory : uint64
        Address of the packet's groups in float64, or of `fields.cells.PACKET_BYTES`.
    frame : SceneFrame
    """

    visit: Any
    prefetch: Any
    hits: TriangleLeaf
    memory: np.uint64
    frame: SceneFrame


# Spheres


@device
def _load_exact(exact, packet, number, source, slow_groups):
    """Load a packet's rays in float64."""
    for g in range(GROUPS):
        first, count = group_rows(source.order, number, g)
        is_slow = (slow_groups >> g) & ONE_U64 == ONE_U64
        lanes, group = _ExactLanes(exact, g), GroupLanes(packet, g)
        for k in range(_LANES if count != ZERO_U64 else ZERO_U64):
            i = first + min(k, count - ONE_U64)
            t_scale, t_offset = t_transform(group, k, is_slow)
            ray = load_exact(source.rays, i, t_offset / t_scale, source.frame)
            for axis in range(THREE_U64):
                lanes.origin[axis, k] = ray.origin[axis]
                lanes.direction[axis, k] = ray.direction[axis]
            lanes.inv_square[k], lanes.offset[k] = ray.inv_square, ray.offset


@device
def _visit_spheres(leaf, packet, child, leaves, box, rays, groups, own):  # noqa: ARG001
    """Test the spheres of a leaf against groups of a packet."""
    block, hits = SphereBlockLanes(leaf_address(leaves, child)), _Hits(scratch(_HITS_BYTES))
    back, frame = (rays.x.back, rays.y.back, rays.z.back), leaf.frame
    to, has_hit = leaf.hits, False
    for k in range(_SPHERES):
        number = block.numbers[k]
        if number < np.int32(0):
            break
        sphere = block.x[k], block.y[k], block.z[k], block.radius[k]
        planes = planes_along(*own_box(sphere, frame), back)
        entering = entering_groups(packet, planes, rays, groups)
        while entering != ZERO_U64:
            g = count_trailing_zeros(entering)
            entering &= entering - ONE_U64
            group, exact = Group(packet, g), _Exact(leaf.memory, g)
            inv, near, far = three(group.inv), three(group.near), three(group.far)
            interval = slab_interval(planes, inv, near, far)
            t_min, t_far = group.t_min, group.t_active
            origin, direction = three(exact.origin), three(exact.direction)
            inv_square, offset = exact.inv_square, exact.offset
            ray = ExactRay(origin, direction, inv_square, offset, frame.center, frame.scale)
            entered, left = intersect(sphere, interval, ray, t_min, t_far, hits)
            for side in range(TWO_U64):
                bits, t, step = entered, hits.near, -hits.half
                if side == ONE_U64:
                    bits, t, step = left, hits.far, hits.half
                if bits == ZERO_U64:
                    continue
                u, v = place(hits.x, hits.y, hits.z, step, ray)
                taken, own_number = lanes_from_bits(mask16, bits), np.int32(number + np.int32(side))
                has_hit |= to.kind.keep_lanes(to, packet, g, taken, t, u, v, own_number)
    return has_hit


# Shapes

#: The crossings of sixteen rays with a shape that have the same place in their order; `exact` is
#: the distance by the user's function.
_ROW = [("t", "f4"), ("u", "f4"), ("v", "f4"), ("exact", "f8")]
_Row = view([*((name, kind, 16) for name, kind in _ROW), ("bits", "u8")])
_RowLanes = view([*((name, kind, (16, 1)) for name, kind in _ROW), ("bits", "u8")])
_ROWS_BYTES, _INTERVAL_BYTES = 328 * MOST_HITS, 128
_INTERVAL_END = np.uint64(64)


@device
def _exact_of(memory, g, k, frame):
    """Ray k of a group in float64."""
    exact = _ExactLanes(memory, g)
    origin, direction = _three_of(exact.origin, k), _three_of(exact.direction, k)
    inv_square, offset = exact.inv_square[k], exact.offset[k]
    return ExactRay(origin, direction, inv_square, offset, frame.center, frame.scale)


@device
def _cross_ray(shape, exact, k, at, t_min, rows, most):
    """Write the crossings of ray k of a group with a shape; returns the rows in use."""
    found, at = scratch(CROSSINGS_BYTES), at + (k << SHIFT_32)
    t_in, t_out = load(np.float32, at), load(np.float32, at + _INTERVAL_END)
    for n in range(crossings(shape, exact.origin, exact.direction, found)):
        row, exact_t = _RowLanes(rows, n), load(np.float64, found + (n << SHIFT_64))
        if n >= most:
            row.bits, most = ZERO_U64, n + ONE_U64
        row.t[k], row.exact[k] = local_t(exact_t, exact, t_in, t_out), exact_t
        if row.t[k] >= t_min:
            row.bits |= ONE_U64 << k
    return most


@device
def _visit_shape(leaf, packet, child, leaves, box, rays, groups, own):  # noqa: ARG001
    """Test the shape of a leaf against groups of a packet, ray by ray."""
    shape, to, frame, has_hit = shape_of(leaves, child), leaf.hits, leaf.frame, False
    planes = planes_along(*shape_box(shape, frame), (rays.x.back, rays.y.back, rays.z.back))
    rows, at = scratch(_ROWS_BYTES), scratch(_INTERVAL_BYTES)
    entering = entering_groups(packet, planes, rays, groups)
    while entering != ZERO_U64:
        g = count_trailing_zeros(entering)
        entering &= entering - ONE_U64
        group, lanes = Group(packet, g), GroupLanes(packet, g)
        t_in, t_out = slab_interval(planes, three(group.inv), three(group.near), three(group.far))
        is_near = (t_in <= group.t_active) & (t_out >= group.t_min)
        bits, most = mask_bits((t_in <= t_out) & is_near), ZERO_U64
        store(at, t_in)
        store(at + _INTERVAL_END, t_out)
        while bits != ZERO_U64:
            k = count_trailing_zeros(bits)
            bits &= bits - ONE_U64
            exact = _exact_of(leaf.memory, g, k, frame)
            most = _cross_ray(shape, exact, k, at, lanes.t_min[k], rows, most)
        for n in range(most):
            # Most second crossings are behind the first ones, where the nearest hits are wanted.
            row, places = _Row(rows, n), _RowLanes(rows, n)
            bits = row.bits & mask_bits(row.t <= group.t_active)
            taken, number = lanes_from_bits(mask16, bits), np.int32(shape.number + np.int32(n))
            if bits == ZERO_U64:
                continue
            while bits != ZERO_U64:
                k = count_trailing_zeros(bits)
                bits &= bits - ONE_U64
                exact = _exact_of(leaf.memory, g, k, frame)
                places.u[k], places.v[k] = place_at(shape, exact, places.exact[k])
            has_hit |= to.kind.keep_lanes(to, packet, g, taken, row.t, row.u, row.v, number)
    return has_hit


@device
def _three_of(rows, k):
    """The three numbers of a lane, one per axis."""
    return rows[ZERO_U64, k], rows[ONE_U64, k], rows[TWO_U64, k]


# Height fields


@device
def _take_all(key, level, query, found):  # noqa: ARG001
    return True


@device
def _enter_nodes(boxes, key, query, found, keys):  # noqa: ARG001
    """Find the nodes that groups enter, and which groups: the nodes' keys are their bits."""
    _, packet, rays, _ = query
    back, entered = (rays.x.back, rays.y.back, rays.z.back), ZERO_U64
    near_x, near_y, near_z, far_x, far_y, far_z = planes_along(*boxes, back)
    for k in range(_FOUR):
        near = lane(near_x, k), lane(near_y, k), lane(near_z, k)
        planes = *near, lane(far_x, k), lane(far_y, k), lane(far_z, k)
        groups = entering_groups(packet, planes, rays, np.uint64(key))
        store(keys + (k << SHIFT_32), np.int32(groups))
        entered |= np.uint64(groups != ZERO_U64) << k
    return entered


@device
def _visit_cells(field, place, key, query, found, blocks):
    """Test the triangles of four cells of a row."""
    leaf, packet, rays, own = query
    back, to = (rays.x.back, rays.y.back, rays.z.back), leaf.hits
    planes = planes_along(*fill_row(field, *place, blocks), back)
    groups = entering_groups(packet, planes, rays, np.uint64(key))
    found |= to.visit(to, packet, _TWO_BLOCKS, blocks, planes, rays, groups, own)
    return found, False


_walk_field = field_walk(_take_all, _enter_nodes, _visit_cells)


@device
def _visit_field(leaf, packet, child, leaves, box, rays, groups, own):  # noqa: ARG001
    """Search a height field with groups of a packet."""
    field = FieldRecord(leaves, np.uint64(np.int32(~child) >> _FIELD_SHIFT))
    query, back = (leaf, packet, rays, own), (rays.x.back, rays.y.back)
    return _walk_field(field, back, np.int32(groups), query, False, leaf.memory)


# Scenes


@device
def _load(packet, number, source, scene, memory):
    slow_groups = load_packet(packet, number, source)
    if scene.sphere_nodes != NULL or scene.shape_nodes != NULL:
        _load_exact(memory, packet, number, source, slow_groups)
    return slow_groups, source.frame


@device
def _trace(packet, scene, frame, memory, leaf):
    most, own = frame.max_coordinate, scratch(TRACE_BYTES)
    if scene.nodes != NULL:
        trace_packet(packet, GROUPS, TreeAddresses(scene.nodes, scene.leaves), most, own, leaf)
        continue_packet(packet, GROUPS)
    if scene.field_nodes != NULL:
        tree = TreeAddresses(scene.field_nodes, scene.fields)
        cells = memory + np.uint64(_EXACT_BYTES)
        fields = PrimitiveLeaf(_visit_field, no_prefetch, leaf, cells, frame)
        trace_packet(packet, GROUPS, tree, most, own, fields)
        continue_packet(packet, GROUPS)
    if scene.sphere_nodes != NULL:
        tree = TreeAddresses(scene.sphere_nodes, scene.sphere_blocks)
        spheres = PrimitiveLeaf(_visit_spheres, prefetch_child, leaf, memory, frame)
        trace_packet(packet, GROUPS, tree, most, own, spheres)
        continue_packet(packet, GROUPS)
    if scene.shape_nodes != NULL:
        tree = TreeAddresses(scene.shape_nodes, scene.shapes)
        shapes = PrimitiveLeaf(_visit_shape, prefetch_child, leaf, memory, frame)
        trace_packet(packet, GROUPS, tree, most, own, shapes)


#: Of the trees of `PrimitiveAddresses`.
PRIMITIVES = PacketScene(_load, _trace, _EXACT_BYTES + PACKET_BYTES)
