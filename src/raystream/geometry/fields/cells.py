"""The traversal of a height field: a tree of blocks of cells, down to triangles made on the way.

A cell's triangles are written as lanes of a leaf block and tested by the function of all leaves, so
they have the bits of a mesh's. Nodes are left out by the slab test of all structures, which is
monotone: a node's padded box holds those of its triangles. So the tree leaves out no hit.
"""

from __future__ import annotations

import numpy as np

from raystream.geometry.fields.levels import BLOCK_CELLS
from raystream.geometry.primitives.records import LevelRecord
from raystream.jit.cpu import device
from raystream.jit.simd import (
    f32x4,
    fma,
    i32x4,
    lane_numbers,
    lanes_from_bits,
    load,
    mask4,
    mask_bits,
    maximum,
    minimum,
    reduce_max,
    reduce_min,
    select,
    store,
)
from raystream.kernels.leaf_block import AXIS, BLOCK, PRIM_IDS, SECOND, THIRD, intersect_block
from raystream.kernels.search import is_full
from raystream.kernels.tally import LEAVES, STEPS, TESTS, add_to
from raystream.kernels.triangle_lanes import slab_interval

_NONE, _ONE, _TWO, _THREE, _FOUR, _FIVE = np.arange(6, dtype=np.uint64)
_ZERO, _INF, _NAN = np.float32(0.0), np.float32(np.inf), np.float32(np.nan)
_TURNED = np.int32(1)
_CELLS = np.uint64(BLOCK_CELLS)
_LANES = np.uint64(4)

#: An entry of the stack: the distance at which the ray enters a node, its level, column and row.
_ENTRY = np.uint64(16)

#: Three nodes of each level remain on the stack, and four of the last: at most 30 levels fit.
STACK_BYTES = 2048
_STACK = np.uint64(STACK_BYTES)

#: Lanes of the children in the second column, and in the second row.
_SECOND_COLUMN, _SECOND_ROW = np.uint64(10), np.uint64(12)

#: Memory of a traversal: also the four distances of a node's children, or a leaf block.
FIELD_BYTES = STACK_BYTES + int(BLOCK)

#: The same of a packet's: two leaf blocks.
PACKET_BYTES = FIELD_BYTES + int(BLOCK)


@device
def _plane(at, index):
    return load(np.float32, at + (index << _TWO))


@device
def _spans(at, first, size, count, inv, near, far):
    """Where a ray enters and leaves two neighbouring nodes along one axis: two pairs of numbers."""
    middle, end = min(first + size, count), min(first + size + size, count)
    a, b, c = _plane(at, first), _plane(at, middle), _plane(at, end)
    lows, highs = (min(a, b), min(b, c)), (max(a, b), max(b, c))
    if inv < _ZERO:
        lows, highs = highs, lows
    t_in = fma(lows[0], inv, near), fma(lows[1], inv, near)
    return t_in, (fma(highs[0], inv, far), fma(highs[1], inv, far))


@device
def _enter(field, level, column, row, ray):
    """The slab intervals of four nodes: f32x4 of distances in and out.

    Parameters
    ----------
    field : FieldRecord
    level : LevelRecord
    column, row : uint64
        Of the group of four.
    ray : Ray
    """
    size = level.size
    left, top = (column << _ONE) * size, (row << _ONE) * size
    x_in, x_out = _spans(field.x, left, size, field.columns, ray.inv_x, ray.near_x, ray.far_x)
    y_in, y_out = _spans(field.y, top, size, field.rows, ray.inv_y, ray.near_y, ray.far_y)
    at = field.ranges + ((level.first + row * level.columns + column) << _FIVE)
    low, high = load(f32x4, at), load(f32x4, at + np.uint64(16))
    is_down = ray.inv_z < _ZERO
    z_in = fma(select(is_down, high, low), ray.inv_z, ray.near_z)
    z_out = fma(select(is_down, low, high), ray.inv_z, ray.far_z)
    across, along = lanes_from_bits(mask4, _SECOND_COLUMN), lanes_from_bits(mask4, _SECOND_ROW)
    t_in = maximum(
        maximum(_pair(across, x_in), _pair(along, y_in)),
        z_in,
    )
    t_out = minimum(
        minimum(_pair(across, x_out), _pair(along, y_out)),
        z_out,
    )
    return t_in, t_out


@device
def _pair(is_second, pair):
    return select(is_second, f32x4(pair[1]), f32x4(pair[0]))


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
    turn = turn_x | (turn_y << _ONE)
    distances = stack + _STACK
    top = _NONE
    if search.t_min <= search.t_far:
        store(stack, search.t_min)
        store(stack + np.uint64(4), np.int32(field.level_count))
        store(stack + np.uint64(8), np.int32(0))
        store(stack + np.uint64(12), np.int32(0))
        top = _ENTRY
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
        level -= _ONE
        t_in, t_out = _enter(field, LevelRecord(field.levels, level), column, row, ray)
        entered = mask_bits((t_in <= t_out) & (t_in <= search.t_far) & (t_out >= search.t_min))
        store(distances, t_in)
        for k in range(_FOUR):  # the last one is visited first
            child = (_THREE - k) ^ turn
            at = stack + top  # overwritten by the next one, if the ray does not enter this one
            store(at, load(np.float32, distances + (child << _TWO)))
            store(at + np.uint64(4), np.int32(level))
            store(at + np.uint64(8), np.int32((column << _ONE) + (child & _ONE)))
            store(at + np.uint64(12), np.int32((row << _ONE) + (child >> _ONE)))
            top += ((entered >> child) & _ONE) * _ENTRY
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
def _box(x, y, z, back):
    """Near x, y, z and far x, y, z planes of boxes, of which pairs of planes are given.

    `back` says of each axis whether the rays' directions are negative; z has its low plane first.
    """
    low_x, high_x = minimum(x[0], x[1]), maximum(x[0], x[1])
    low_y, high_y = minimum(y[0], y[1]), maximum(y[0], y[1])
    return (
        select(back[0], high_x, low_x),
        select(back[1], high_y, low_y),
        select(back[2], z[1], z[0]),
        select(back[0], low_x, high_x),
        select(back[1], low_y, high_y),
        select(back[2], z[0], z[1]),
    )


@device
def _load_row(field, row, column):
    """Load four cells of a row; see `core.height_field.HeightField`.

    Returns
    -------
    x, y : tuple of two f32x4, or numbers
        Left and right, top and bottom.
    z : tuple of four f32x4
        At the corners a, b, c and d.
    known : tuple of two f32x4
        NaN where the triangles a, b, c, and a, c, d, are missing.
    """
    # Past the end of a row x is NaN, and where there is no data z is.
    top = field.heights + ((row * field.width + column) << _TWO)
    bottom = top + (field.width << _TWO)
    a, b = load(f32x4, top), load(f32x4, top + _FOUR)
    d, c = load(f32x4, bottom), load(f32x4, bottom + _FOUR)
    across = field.x + (column << _TWO)
    x = load(f32x4, across), load(f32x4, across + _FOUR)
    y = _plane(field.y, row), _plane(field.y, row + _ONE)
    # Local coordinates are too small for an overflow: a sum is NaN if one of its terms is.
    ends = x[0] + x[1] + (a + c)
    return x, y, (a, b, c, d), (ends + b, ends + d)


@device
def _store_corner(at, x, y, z, known):
    store(at, x)
    store(at + AXIS, f32x4(y))
    store(at + AXIS + AXIS, select(known == known, z, f32x4(_NAN)))  # no ray hits NaN


@device
def _write_triangles(field, cells, half, row, column, block):
    """Write the triangles a, b, c of four cells to a leaf block; or, of half 1, a, c, d."""
    x, y, (a, b, c, d), known = cells
    is_upper = half == _NONE
    own = select(is_upper, known[0], known[1])
    # The last two corners are exchanged where fronts would point down.
    turns = field.turns == _TURNED
    corner_c = block + (SECOND if turns == is_upper else THIRD)
    other = block + (THIRD if turns == is_upper else SECOND)
    _store_corner(block, x[0], y[0], a, own)
    _store_corner(corner_c, x[1], y[1], c, own)
    other_y = y[0] if is_upper else y[1]
    _store_corner(other, select(is_upper, x[1], x[0]), other_y, select(is_upper, b, d), own)
    first = np.int32((row * field.columns + column) << _ONE) + np.int32(half)
    numbers = lane_numbers(i32x4)
    store(block + PRIM_IDS, numbers + numbers + np.int32(field.first_id + first))


@device
def _search_row(field, row, column, ray, line, search, block):
    """Test four cells of a row."""
    # Step 1: the cells' boxes, where all four corners are known.
    cells = _load_row(field, row, column)
    x, y, (a, b, c, d), known = cells
    upper, lower = known[0] == known[0], known[1] == known[1]
    low_z = minimum(minimum(a, b), minimum(c, d))
    high_z = maximum(maximum(a, b), maximum(c, d))
    back = ray.inv_x < _ZERO, ray.inv_y < _ZERO, ray.inv_z < _ZERO
    t_in, t_out = slab_interval(
        _box(x, y, (low_z, high_z), back),
        (ray.inv_x, ray.inv_y, ray.inv_z),
        (ray.near_x, ray.near_y, ray.near_z),
        (ray.far_x, ray.far_y, ray.far_z),
    )
    missed = (t_in > t_out) | (t_in > search.t_far) | (t_out < search.t_min)
    if mask_bits(upper | lower) & ~mask_bits(missed & upper & lower) == _NONE:
        return search

    # Step 2: the triangles.
    add_to(search.counters, TESTS, _LANES + _LANES)
    for half in range(_TWO):
        _write_triangles(field, cells, half, row, column, block)
        search = intersect_block(block, line, search, search.t_min, _INF)
        if is_full(search):
            break
    return search


# For packets of rays


@device
def node_box(field, level, column, row, back):
    """The box of a node, see `_box`."""
    lane = (column & _ONE) | ((row & _ONE) << _ONE)
    group = level.first + (row >> _ONE) * level.columns + (column >> _ONE)
    left, top = min(column * level.size, field.columns), min(row * level.size, field.rows)
    right = min(left + level.size, field.columns)
    bottom = min(top + level.size, field.rows)
    x = _plane(field.x, left), _plane(field.x, right)
    y = _plane(field.y, top), _plane(field.y, bottom)
    at = field.ranges + (group << _FIVE)
    return _box(x, y, (_plane(at, lane), _plane(at, lane + _FOUR)), back)


@device
def fill_row(field, row, column, back, blocks):
    """Write the triangles of four cells to two leaf blocks; returns their box, see `_box`."""
    cells = _load_row(field, row, column)
    for half in range(_TWO):
        _write_triangles(field, cells, half, row, column, blocks + half * BLOCK)
    x = _plane(field.x, column), _plane(field.x, min(column + _LANES, field.columns))
    low, high = f32x4(_INF), f32x4(-_INF)
    for z in cells[2]:  # the second operand stays where the first one is NaN
        low, high = minimum(z, low), maximum(z, high)
    return _box(x, cells[1], (reduce_min(low), reduce_max(high)), back)
