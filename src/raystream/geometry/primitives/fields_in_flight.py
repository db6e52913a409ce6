"""Many single rays in flight through a height field's tree; see `structures.bvh.walks.in_flight`.

The rows of a leaf's cells are prefetched one by one: in a large field they are far apart.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from raystream.geometry.fields.cells import group_address, node_boxes, search_row
from raystream.geometry.fields.levels import BLOCK_CELLS
from raystream.geometry.primitives.in_flight import (
    PRIMITIVE_SLOT,
    begin_ray,
    primitive_wavefront,
)
from raystream.geometry.primitives.records import FieldRecord, LevelRecord
from raystream.jit.constants import ONE_U64, SHIFT_32, THREE_U64, ZERO_F32, ZERO_U64
from raystream.jit.cpu import device
from raystream.jit.simd import (
    compress,
    float_as_bits,
    i32x4,
    lane_numbers,
    load,
    mask_bits,
    maximum,
    permute,
    popcount,
    prefetch,
    scratch,
    select,
    store,
)
from raystream.kernels.leaf_block import BLOCK_BYTES
from raystream.kernels.triangle_lanes import boxes_interval
from raystream.structures.bvh.node_layout import LANE
from raystream.structures.bvh.walks.all_hits import SlotSearches
from raystream.structures.bvh.walks.in_flight import CHILDREN, TreeKind, line_of

_CELLS = np.uint64(BLOCK_CELLS)
_TURNED, _LAST, _ONE, _ALL = np.int32(1), np.uint64(3), np.int32(1), np.int32(-1)

#: A child is its column and its row among the nodes of its level; a leaf, the complement of that.
_COLUMN_BITS = np.uint64(15)
_COLUMN = np.uint64((1 << 15) - 1)

#: Most cells along each side of a field in flight.
MOST_CELLS = BLOCK_CELLS << 15

#: Where the stack has the levels of children: three nodes of each level remain on it, so the first
#: 256 places are enough.
_LEVELS = CHILDREN + np.uint64(4 * 256)


@device
def _begin(slot, stack, i, ray, tree, frame, source):
    begin_ray(slot, stack, i, ray, tree, frame, source)
    level = np.int32(FieldRecord(tree.nodes).level_count)
    store(stack + _LEVELS + slot.top, level)
    store(stack + _LEVELS, level)  # of no node: see `_prefetch`


@device
def _turn(slot, field):
    """The child that the ray enters first, as bits of its column and row; see `field_walk`."""
    turn_x = np.uint64((slot.inv_x < ZERO_F32) != (field.x_falls == _TURNED))
    turn_y = np.uint64((slot.inv_y < ZERO_F32) != (field.y_falls == _TURNED))
    return turn_x | (turn_y << ONE_U64)


@device
def _place(number):
    return number & _COLUMN, number >> _COLUMN_BITS


@device
def _visit_node(slot, stack, tree):
    """Test a node's four children and push those that are entered, the farthest first."""
    field, (column, row) = FieldRecord(tree.nodes), _place(np.uint64(slot.child))
    level = np.uint64(load(np.int32, stack + _LEVELS + slot.top)) - ONE_U64
    boxes = node_boxes(field, LevelRecord(field.levels, level), column, row)
    near, far = boxes_interval(slot, *boxes)
    order = lane_numbers(i32x4) ^ i32x4(np.int32(_LAST ^ _turn(slot, field)))
    near, far = permute(near, order), permute(far, order)
    entered = (near <= far) & (near <= slot.t) & (far >= slot.t_min)
    first = ((row << ONE_U64) << _COLUMN_BITS) | (column << ONE_U64)
    rows = (order >> i32x4(_ONE)) << i32x4(np.int32(_COLUMN_BITS))
    numbers = i32x4(np.int32(first)) + rows + (order & i32x4(_ONE))
    children = numbers ^ i32x4(select(level == ZERO_U64, _ALL, np.int32(0)))
    at = stack + slot.top
    store(at, compress(entered, float_as_bits(maximum(near, ZERO_F32))))
    store(at + CHILDREN, compress(entered, children))
    store(at + _LEVELS, i32x4(np.int32(level)))
    return slot.top + popcount(mask_bits(entered)) * LANE


@device
def _prefetch(slot, stack, tree):
    """Prefetch the children of the next node, or the heights of the next leaf."""
    field = FieldRecord(tree.nodes)
    if slot.child >= np.int32(0):
        column, row = _place(np.uint64(slot.child))
        level = np.uint64(load(np.int32, stack + _LEVELS + slot.top)) - ONE_U64
        prefetch(group_address(field, LevelRecord(field.levels, level), column, row))
        return
    column, row = _place(np.uint64(np.int32(~slot.child)))
    step = field.width << SHIFT_32
    at = field.heights + ((row * _CELLS * field.width + column * _CELLS) << SHIFT_32)
    for _ in range(_CELLS + ONE_U64):
        prefetch(at)
        at += step


@device
def _search_cells(slot, tree, frame, search):  # noqa: ARG001
    """Offer the hits of the four by four cells of a leaf."""
    field, (column, row) = FieldRecord(tree.nodes), _place(np.uint64(np.int32(~slot.child)))
    block, line, turn_y = scratch(BLOCK_BYTES), line_of(slot), _turn(slot, field) >> ONE_U64
    for k in range(_CELLS):
        number = row * _CELLS + (THREE_U64 - k if turn_y == ONE_U64 else k)
        if number < field.rows:
            place = number, column * _CELLS
            search = search_row(field, place, slot, line, search, block)
    return search


_FIELDS = TreeKind(PRIMITIVE_SLOT, _begin, _visit_node, _prefetch)


def field_in_flight(searches: SlotSearches) -> Any:
    """The kernel of some searches with the tree of a height field in flight."""
    return primitive_wavefront(searches, _search_cells, _FIELDS)
