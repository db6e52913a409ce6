"""The traversal of a height field: a tree of blocks of cells, down to triangles made on the way.

A cell's triangles are written as lanes of a leaf block and tested by the function of all leaves, so
they have the bits of a mesh's. Nodes are left out by the slab test of all structures, which is
monotone: a node's padded box holds those of its triangles. So the tree leaves out no hit.
"""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device
from raystream.jit.simd import (
    count_trailing_zeros,
    f32x4,
    load,
    mask_bits,
    maximum,
    minimum,
    select,
    store,
)
from raystream.kernels.leaf_block import AXIS, SECOND, THIRD, test_block
from raystream.kernels.search import is_full, offer
from raystream.kernels.slab import box_interval
from raystream.kernels.tally import LEAVES, STEPS, TESTS, add_to
from raystream.kernels.triangle_lanes import slab_interval
from raystream.primitives.levels import BLOCK_CELLS
from raystream.primitives.records import LevelRecord

__all__ = ["FIELD_BYTES", "traverse_all_cells", "traverse_field"]

_NONE, _ONE, _TWO, _THREE, _FOUR = np.arange(5, dtype=np.uint64)
_ZERO = np.float32(0.0)
_TURNED = np.int32(1)
_CELLS = np.uint64(BLOCK_CELLS)
_LANES = np.uint64(4)

#: An entry of the stack: the distance at which the ray enters a node, and its level, column, row.
_ENTRY = np.uint64(16)

#: Three nodes of each level remain on the stack; a field has at most 30 levels.
_STACK = np.uint64(2048)

#: Of `test_block`.
_BLOCK = np.uint64(192)
_U, _V = np.uint64(16), np.uint64(32)

#: Memory of a traversal.
FIELD_BYTES = 2048 + 192 + 64


@device
def _plane(at, index):
    return load(np.float32, at + (index << _TWO))


@device
def _node_interval(field, level, column, row, ray):
    """The padded slab interval of a node."""
    left, top = column * level.size, row * level.size
    right, bottom = min(left + level.size, field.columns), min(top + level.size, field.rows)
    xa, xb = _plane(field.x, left), _plane(field.x, right)
    ya, yb = _plane(field.y, top), _plane(field.y, bottom)
    at = field.ranges + ((level.first + row * level.columns + column) << _THREE)
    low, high = load(np.float32, at), load(np.float32, at + _FOUR)
    return box_interval(ray, min(xa, xb), min(ya, yb), low, max(xa, xb), max(ya, yb), high)


@device
def _push(stack, top, t_in, level, column, row):
    at = stack + top
    store(at, t_in)
    store(at + np.uint64(4), np.int32(level))
    store(at + np.uint64(8), np.int32(column))
    store(at + np.uint64(12), np.int32(row))
    return top + _ENTRY


@device
def traverse_field(field, ray, line, search, stack):
    """Offer the hits of a ray with a height field to a search.

    Parameters
    ----------
    field : FieldRecord
    ray : Ray
    line : BlockRay
        The same one.
    search : Search
        Not full.
    stack : uint64
        Address of `FIELD_BYTES`.

    Returns
    -------
    Search
    """
    # The first child is the one that rays of this direction enter first.
    turn_x = np.uint64((ray.inv_x < _ZERO) != (field.x_falls == _TURNED))
    turn_y = np.uint64((ray.inv_y < _ZERO) != (field.y_falls == _TURNED))
    root = field.level_count - _ONE
    t_in, t_out = _node_interval(field, LevelRecord(field.levels, root), _NONE, _NONE, ray)
    top = _NONE
    if t_in <= t_out and t_out >= search.t_min and search.t_min <= search.t_far:
        top = _push(stack, top, t_in, root, _NONE, _NONE)
    while top != _NONE:
        top -= _ENTRY
        at = stack + top
        if load(np.float32, at) > search.t_far:
            continue
        level = np.uint64(load(np.int32, at + np.uint64(4)))
        column = np.uint64(load(np.int32, at + np.uint64(8)))
        row = np.uint64(load(np.int32, at + np.uint64(12)))
        if level == _NONE:
            add_to(search.counters, LEAVES, _ONE)
            place = row * _CELLS, column * _CELLS
            search = _search_cells(field, place, turn_y, ray, line, search, stack + _STACK)
            if is_full(search):
                break
            continue
        add_to(search.counters, STEPS, _ONE)
        below = LevelRecord(field.levels, level - _ONE)
        for k in range(_FOUR):  # the last one is visited first
            child_column = (column << _ONE) + ((k & _ONE) ^ _ONE ^ turn_x)
            child_row = (row << _ONE) + ((k >> _ONE) ^ _ONE ^ turn_y)
            if child_column < below.columns and child_row < below.rows:
                t_in, t_out = _node_interval(field, below, child_column, child_row, ray)
                if t_in <= t_out and t_in <= search.t_far and t_out >= search.t_min:
                    top = _push(stack, top, t_in, level - _ONE, child_column, child_row)
    return search


@device
def _search_cells(field, place, turn_y, ray, line, search, blocks):
    """Test the cells of a node of the finest level, row by row."""
    first_row, column = place
    for k in range(_CELLS):
        row = first_row + (_CELLS - _ONE - k if turn_y == _ONE else k)
        if row < field.rows:
            search = _search_row(field, row, column, ray, line, search, blocks)
            if is_full(search):
                break
    return search


@device
def traverse_all_cells(field, ray, line, search, stack):
    """Like `traverse_field`, without the tree: all cells, row by row."""
    for row in range(field.rows):
        column = _NONE
        while column < field.columns:
            search = _search_row(field, row, column, ray, line, search, stack + _STACK)
            if is_full(search):
                return search
            column += _CELLS
    return search


@device
def _store_corner(at, x, y, z):
    store(at, x)
    store(at + AXIS, y)
    store(at + AXIS + AXIS, z)


@device
def _search_row(field, row, column, ray, line, search, blocks):
    """Test four cells of a row."""
    # Step 1: the corners. Past the end of a row x is NaN, and where there is no data z is.
    top = field.heights + ((row * field.width + column) << _TWO)
    bottom = top + (field.width << _TWO)
    za, zb = load(f32x4, top), load(f32x4, top + _FOUR)
    zd, zc = load(f32x4, bottom), load(f32x4, bottom + _FOUR)
    across = field.x + (column << _TWO)
    x_left, x_right = load(f32x4, across), load(f32x4, across + _FOUR)
    y_top, y_bottom = _plane(field.y, row), _plane(field.y, row + _ONE)
    # Local coordinates are too small for an overflow: a sum is NaN if one of its terms is.
    ends = x_left + x_right + (za + zc)
    known_upper, known_lower = ends + zb, ends + zd
    known = (known_upper == known_upper) | (known_lower == known_lower)

    # Step 2: the cells' boxes, where all four corners are known.
    all_known = (known_upper == known_upper) & (known_lower == known_lower)
    low_z = minimum(minimum(za, zb), minimum(zc, zd))
    high_z = maximum(maximum(za, zb), maximum(zc, zd))
    low_x, high_x = minimum(x_left, x_right), maximum(x_left, x_right)
    low_y, high_y = f32x4(min(y_top, y_bottom)), f32x4(max(y_top, y_bottom))
    back_x, back_y, back_z = ray.inv_x < _ZERO, ray.inv_y < _ZERO, ray.inv_z < _ZERO
    t_in, t_out = slab_interval(
        select(back_x, high_x, low_x),
        select(back_y, high_y, low_y),
        select(back_z, high_z, low_z),
        select(back_x, low_x, high_x),
        select(back_y, low_y, high_y),
        select(back_z, low_z, high_z),
        (ray.inv_x, ray.inv_y, ray.inv_z),
        (ray.near_x, ray.near_y, ray.near_z),
        (ray.far_x, ray.far_y, ray.far_z),
    )
    missed = (t_in > t_out) | (t_in > search.t_far) | (t_out < search.t_min)
    if mask_bits(known) & ~mask_bits(missed & all_known) == _NONE:
        return search

    # Step 3: the triangles.
    add_to(search.counters, TESTS, _LANES + _LANES)
    lanes = blocks + _BLOCK
    turns = field.turns == _TURNED
    y_upper, y_lower = f32x4(y_top), f32x4(y_bottom)
    for half in range(_TWO):
        is_upper = half == _NONE
        # a, b, c and a, c, d; the last two exchanged where fronts would point down.
        corner_c = blocks + (SECOND if turns == is_upper else THIRD)
        other = blocks + (THIRD if turns == is_upper else SECOND)
        _store_corner(blocks, x_left, y_upper, za)
        _store_corner(corner_c, x_right, y_lower, zc)
        if is_upper:
            _store_corner(other, x_right, y_upper, zb)
        else:
            _store_corner(other, x_left, y_lower, zd)
        bits = test_block(blocks, line, search.t_min, search.t_far, search.surfaces, lanes)
        is_known = known_upper if is_upper else known_lower
        bits &= mask_bits(is_known == is_known)
        while bits != _NONE:
            k = count_trailing_zeros(bits)
            bits &= bits - _ONE
            at = lanes + (k << _TWO)
            cell = row * field.columns + column + k
            number = np.int32(field.first_id + np.int32((cell << _ONE) + half))
            search = offer(
                search,
                load(np.float32, at),
                load(np.float32, at + _U),
                load(np.float32, at + _V),
                number,
            )
            if is_full(search):
                return search
    return search
