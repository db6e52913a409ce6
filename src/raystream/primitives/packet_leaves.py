"""Leaves of spheres and of height fields, for packets of rays.

A sphere is tested against sixteen rays. A height field is a leaf of a tree over all of them: groups
of a packet descend its own tree of blocks of cells, and the triangles of a row of cells are written
as leaf blocks, once for all rays. Both give their hits to a leaf of triangles, which says what
becomes of them.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from raystream.jit.constants import ONE_U64, ZERO_U64
from raystream.jit.cpu import device
from raystream.jit.simd import any_lane, lanes_from_bits, mask16, maximum, minimum, scratch
from raystream.jit.views import view
from raystream.kernels.ray import SceneFrame
from raystream.kernels.triangle_lanes import slab_interval
from raystream.primitives.field import ROW_BYTES, fill_row, node_box
from raystream.primitives.levels import BLOCK_CELLS
from raystream.primitives.records import (
    SPHERES_PER_BLOCK,
    FieldRecord,
    LevelRecord,
    SphereBlockLanes,
)
from raystream.primitives.sphere import HIT, ExactRay, intersect, own_box, place
from raystream.structures.bvh.leaf_kinds import no_prefetch
from raystream.structures.bvh.node_layout import leaf_address, prefetch_child
from raystream.structures.bvh.packet_leaf import (
    GroupRange,
    TriangleLeaf,
    group_range,
)
from raystream.structures.bvh.packet_rays import Group, three

_LEAF_SHIFT = np.int32(3)
_TWO, _THREE, _FOUR = np.uint64(2), np.uint64(3), np.uint64(4)

# Spheres

#: Sixteen rays in float64; see `sphere.ExactRay`.
_EXACT = [(name, "f8") for name in ExactRay._fields[:8]]
ExactGroup = view([(name, kind, 16) for name, kind in _EXACT])
ExactLanes = view([(name, kind, (16, 1)) for name, kind in _EXACT])
EXACT_BYTES = 128 * len(_EXACT)

_HITS = np.dtype([(name, kind, 16) for name, kind in HIT])
_Hits = view(_HITS)
_HITS_BYTES = _HITS.itemsize


class _Sphere(NamedTuple):
    x: np.float64
    y: np.float64
    z: np.float64
    radius: np.float64


class SphereLeaf(NamedTuple):
    """Leaves of spheres; see `packet.trace_packet`.

    Attributes
    ----------
    visit, prefetch : device function
    hits : TriangleLeaf
        Takes the hits.
    exact : uint64
        Address of the packet's groups in float64.
    frame : SceneFrame
    """

    visit: Any
    prefetch: Any
    hits: TriangleLeaf
    exact: np.uint64
    frame: SceneFrame


@device
def _exact_rays(leaf, g):
    """The `ExactRay` of a group."""
    rays = ExactGroup(leaf.exact, g)
    return ExactRay(
        rays.ox,
        rays.oy,
        rays.oz,
        rays.dx,
        rays.dy,
        rays.dz,
        rays.inv_square,
        rays.offset,
        leaf.frame.center,
        leaf.frame.scale,
    )


@device
def _visit_spheres(leaf, packet, child, leaves, box, rays, groups, own):  # noqa: ARG001
    block = SphereBlockLanes(leaf_address(leaves, child))
    hits, has_hit = _Hits(scratch(_HITS_BYTES)), False
    back = rays.x.back, rays.y.back, rays.z.back
    for lane in range(np.uint64(SPHERES_PER_BLOCK)):
        number = block.numbers[lane]
        if number < np.int32(0):
            break
        sphere = _Sphere(block.x[lane], block.y[lane], block.z[lane], block.radius[lane])
        planes = own_box(sphere, leaf.frame, back)
        entering = group_range(packet, planes, rays.t_min, groups)
        for g in range(entering.first, entering.last + ONE_U64):
            group = Group(packet, g)
            slabs = three(group.inv), three(group.near), three(group.far)
            interval, t_min, t_far = slab_interval(*planes, *slabs), group.t_min, group.t_active
            if not any_lane(maximum(interval[0], t_min) <= minimum(interval[1], t_far)):
                continue
            exact = _exact_rays(leaf, g)
            entered, left = intersect(sphere, interval, exact, t_min, t_far, hits)
            for side in range(_TWO):
                bits = left if side == ONE_U64 else entered
                if bits == ZERO_U64:
                    continue
                t, step = hits.near, -hits.half
                if side == ONE_U64:
                    t, step = hits.far, hits.half
                u, v = place(hits.x, hits.y, hits.z, step, exact)
                taken, own_number = lanes_from_bits(mask16, bits), np.int32(number + np.int32(side))
                has_hit |= leaf.hits.keep_lanes(leaf.hits, packet, g, taken, t, u, v, own_number)
    return has_hit


@device
def sphere_leaf(hits, exact, frame):
    """Leaves of spheres whose hits go where those of a leaf of triangles do; see `SphereLeaf`."""
    return SphereLeaf(_visit_spheres, prefetch_child, hits, exact, frame)


# Height fields

#: A node on the stack: its level, column and row, and the groups that enter it.
_NODE = np.dtype(
    [("level", "u4"), ("column", "u4"), ("row", "u4"), ("first", "u2"), ("last", "u2")]
)
_Node = view(_NODE)

#: Three nodes of each level remain on the stack, and four of the last: at most 30 levels fit.
_STACK = np.uint64(128 * _NODE.itemsize)
FIELD_BYTES = int(_STACK) + ROW_BYTES

#: The link of a leaf of two blocks, of which the first one is the first of all.
_TWO_BLOCKS = np.int32(~1)


class FieldLeaf(NamedTuple):
    """Height fields as leaves; see `packet.trace_packet`.

    Attributes
    ----------
    visit, prefetch : device function
    hits : TriangleLeaf
        Tests the cells' triangles, and takes the hits.
    memory : uint64
        Address of `FIELD_BYTES`.
    """

    visit: Any
    prefetch: Any
    hits: TriangleLeaf
    memory: np.uint64


@device
def _push(stack, top, level, column, row, groups):
    node = _Node(stack, top)
    node.level, node.column, node.row = np.uint32(level), np.uint32(column), np.uint32(row)
    node.first, node.last = np.uint16(groups.first), np.uint16(groups.last)
    return top + np.uint64(groups.first <= groups.last)


@device
def _visit_field(leaf, packet, child, leaves, box, rays, groups, own):  # noqa: ARG001
    field = FieldRecord(leaves, np.uint64(np.int32(~child) >> _LEAF_SHIFT))
    turn_x = np.uint64(rays.x.back != (field.x_falls != np.int32(0)))
    turn_y = np.uint64(rays.y.back != (field.y_falls != np.int32(0)))
    turn, has_hit = turn_x | (turn_y << ONE_U64), False
    top = _push(leaf.memory, ZERO_U64, field.level_count, ZERO_U64, ZERO_U64, groups)
    while top != ZERO_U64:
        top -= ONE_U64
        node = _Node(leaf.memory, top)
        number, column, row = np.uint64(node.level), np.uint64(node.column), np.uint64(node.row)
        groups = GroupRange(np.uint64(node.first), np.uint64(node.last))
        if number == ZERO_U64:
            place = row * np.uint64(BLOCK_CELLS), column * np.uint64(BLOCK_CELLS)
            has_hit |= _visit_cells(leaf, packet, field, place, turn_y, rays, groups, own)
            continue
        number -= ONE_U64
        level = LevelRecord(field.levels, number)
        for k in range(_FOUR):  # the last one is visited first
            lane = (_THREE - k) ^ turn
            own_column = (column << ONE_U64) + (lane & ONE_U64)
            own_row = (row << ONE_U64) + (lane >> ONE_U64)
            planes = node_box(field, level, own_column, own_row, rays)
            entering = group_range(packet, planes, rays.t_min, groups)
            top = _push(leaf.memory, top, number, own_column, own_row, entering)
    return has_hit


@device
def _visit_cells(leaf, packet, field, place, turn_y, rays, groups, own):
    """Test the triangles of a node of the finest level, row by row."""
    first_row, column = place
    blocks, has_hit = leaf.memory + _STACK, False
    cells = np.uint64(BLOCK_CELLS)
    for k in range(cells):
        row = first_row + (cells - ONE_U64 - k if turn_y == ONE_U64 else k)
        if row < field.rows:
            planes = fill_row(field, row, column, rays, blocks)
            entering = group_range(packet, planes, rays.t_min, groups)
            has_hit |= leaf.hits.visit(
                leaf.hits, packet, _TWO_BLOCKS, blocks, planes, rays, entering, own
            )
    return has_hit


@device
def field_leaf(hits, memory):
    """Height fields whose hits go where those of a leaf of triangles do; see `FieldLeaf`."""
    return FieldLeaf(_visit_field, no_prefetch, hits, memory)
