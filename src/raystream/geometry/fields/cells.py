"""The traversal of a height field: a tree of blocks of cells, down to triangles made on the way.

A cell's triangles are written as lanes of a leaf block and tested by the function of all leaves, so
they have the bits of a mesh's. Nodes are left out by the slab test of all structures, which is
monotone: a node's padded box holds those of its triangles. So the tree leaves out no hit.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from raystream.geometry.fields.levels import BLOCK_CELLS
from raystream.geometry.primitives.records import LevelRecord
from raystream.jit.cpu import device
from raystream.jit.simd import (
    bits_as_float,
    f32x4,
    float_as_bits,
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
from raystream.kernels.triangle_lanes import boxes_interval

_NONE, _ONE, _TWO, _THREE, _FOUR, _FIVE = np.arange(6, dtype=np.uint64)
_ZERO, _INF, _NAN = np.float32(0.0), np.float32(np.inf), np.float32(np.nan)
_TURNED = np.int32(1)
_CELLS = np.uint64(BLOCK_CELLS)
_LANES = np.uint64(4)

#: Bytes of a node on the stack; where its level, column and row are, after its key. (A view of them
#: takes 1.02 to 1.08 times as long: LLVM joins its loads, which then wait for the single stores.)
_ENTRY = np.uint64(16)
_LEVEL, _COLUMN, _ROW = np.uint64(4), np.uint64(8), np.uint64(12)

#: Three nodes of each level remain on the stack, and four of the last: at most 30 levels fit.
STACK_BYTES = 2048
_STACK = np.uint64(STACK_BYTES)

#: Lanes of the children in the second column, and in the second row.
_SECOND_COLUMN, _SECOND_ROW = np.uint64(10), np.uint64(12)

#: Memory of a traversal: also the keys of a node's four children, or a leaf block.
FIELD_BYTES = STACK_BYTES + int(BLOCK)

#: The same of a packet's: two leaf blocks.
PACKET_BYTES = FIELD_BYTES + int(BLOCK)


@device
def _plane(at, index):
    return load(np.float32, at + (index << _TWO))


@device
def _ends(at, first, size, count, seconds):
    """The planes between which four nodes lie along an axis, of which two are each other's next.

    Parameters
    ----------
    at : uint64
        Address of the planes.
    first, size, count : uint64
        First cell of the first nodes, cells of a node, and of the whole field.
    seconds : uint64
        Bits of the lanes of the second nodes.
    """
    middle, end = min(first + size, count), min(first + size + size, count)
    a, b, c = _plane(at, first), _plane(at, middle), _plane(at, end)
    is_second = lanes_from_bits(mask4, seconds)
    return select(is_second, f32x4(b), f32x4(a)), select(is_second, f32x4(c), f32x4(b))


@device
def _box(x, y, z):
    """Low and high corners of boxes between pairs of planes, of which z has its low one first."""
    low = minimum(x[0], x[1]), minimum(y[0], y[1]), z[0]
    return low, (maximum(x[0], x[1]), maximum(y[0], y[1]), z[1])


@device
def group_address(field, level, column, row):
    """Where the heights of a group of four nodes of a `LevelRecord` are."""
    return field.ranges + ((level.first + row * level.columns + column) << _FIVE)


@device
def node_boxes(field, level, column, row):
    """The boxes of a group of four nodes of a `LevelRecord`, see `_box`."""
    left, top = (column << _ONE) * level.size, (row << _ONE) * level.size
    x = _ends(field.x, left, level.size, field.columns, _SECOND_COLUMN)
    y = _ends(field.y, top, level.size, field.rows, _SECOND_ROW)
    at = group_address(field, level, column, row)
    return _box(x, y, (load(f32x4, at), load(f32x4, at + np.uint64(16))))


@device
def _store_node(at, key, level, column, row):
    store(at, key)
    store(at + _LEVEL, np.int32(level))
    store(at + _COLUMN, np.int32(column))
    store(at + _ROW, np.int32(row))


def field_walk(
    take: Callable[..., Any], enter: Callable[..., Any], search_row: Callable[..., Any]
) -> Callable[..., Any]:
    """Make the walk of a height field's tree, for one ray or for rays side by side.

    Nodes wait on the stack with a key, an int32: what the test of their boxes has found.

    Parameters
    ----------
    take : device function
        ``take(key, level, query, found)`` returns whether a node from the stack is still wanted.
    enter : device function
        ``enter(boxes, key, query, found, keys)`` tests the boxes of a node's four children, see
        `_box`. It writes their keys to the address `keys`, and returns bits of those that are
        entered.
    search_row : device function
        ``search_row(field, place, key, query, found, blocks) -> (found, is_over)`` tests four cells
        of a row. `place` is their row and first column, `blocks` the address of free memory.

    Returns
    -------
    device function
        ``walk(field, back, key, query, found, memory) -> found``. `back` says whether the rays'
        directions along x and y are negative, `key` is the root's; `query` and `found` are as the
        functions take them. `memory` is the address of `FIELD_BYTES`, or more for the blocks.
    """

    @device
    def walk(field, back, key, query, found, memory):
        # The first child is the one that rays of these directions enter first.
        turn_x = np.uint64(back[0] != (field.x_falls == _TURNED))
        turn_y = np.uint64(back[1] != (field.y_falls == _TURNED))
        turn, free = turn_x | (turn_y << _ONE), memory + _STACK
        _store_node(memory, key, field.level_count, _NONE, _NONE)
        top = _ENTRY
        while top != _NONE:
            top -= _ENTRY
            at = memory + top
            key, level = load(np.int32, at), np.uint64(load(np.int32, at + _LEVEL))
            if not take(key, level, query, found):
                continue
            column = np.uint64(load(np.int32, at + _COLUMN))
            row = np.uint64(load(np.int32, at + _ROW))
            if level == _NONE:
                for k in range(_CELLS):
                    number = row * _CELLS + (_CELLS - _ONE - k if turn_y == _ONE else k)
                    if number < field.rows:
                        place = number, column * _CELLS
                        found, is_over = search_row(field, place, key, query, found, free)
                        if is_over:
                            return found
                continue
            level -= _ONE
            boxes = node_boxes(field, LevelRecord(field.levels, level), column, row)
            entered = enter(boxes, key, query, found, free)
            for k in range(_FOUR):  # the last one is visited first
                child = (_THREE - k) ^ turn
                x, y = (column << _ONE) + (child & _ONE), (row << _ONE) + (child >> _ONE)
                # Overwritten by the next one, if this one is not entered.
                _store_node(memory + top, load(np.int32, free + (child << _TWO)), level, x, y)
                top += ((entered >> child) & _ONE) * _ENTRY
        return found

    return walk


# One ray


@device
def _take(t_in, level, query, search):  # noqa: ARG001
    """Whether a node is near enough; counts it."""
    if not bits_as_float(t_in) <= search.t_far:
        return False
    add_to(search.counters, LEAVES if level == _NONE else STEPS, _ONE)
    return True


@device
def _enter(boxes, t_in, query, search, keys):  # noqa: ARG001
    """Find the nodes that the ray enters; their keys are the distances."""
    near, far = boxes_interval(query[0], *boxes)
    store(keys, near)
    return mask_bits((near <= far) & (near <= search.t_far) & (far >= search.t_min))


@device
def _search_cells(field, place, t_in, query, search, block):  # noqa: ARG001
    search = search_row(field, place, *query, search, block)
    return search, is_full(search)


_walk = field_walk(_take, _enter, _search_cells)


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
    back = ray.inv_x < _ZERO, ray.inv_y < _ZERO
    return _walk(field, back, float_as_bits(search.t_min), (ray, line), search, stack)


@device
def traverse_all_cells(field, ray, line, search, stack):
    """Like `traverse_field`, without the tree: all cells, row by row."""
    for row in range(field.rows):
        column = _NONE
        while column < field.columns:
            search = search_row(field, (row, column), ray, line, search, stack + _STACK)
            if is_full(search):
                return search
            column += _CELLS
    return search


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
def search_row(field, place, ray, line, search, block):
    """Test four cells of a row; `place` is their row and first column."""
    # Step 1: the cells' boxes, where all four corners are known.
    row, column = place
    cells = _load_row(field, row, column)
    x, y, (a, b, c, d), known = cells
    upper, lower = known[0] == known[0], known[1] == known[1]
    low_z = minimum(minimum(a, b), minimum(c, d))
    high_z = maximum(maximum(a, b), maximum(c, d))
    t_in, t_out = boxes_interval(ray, *_box(x, y, (low_z, high_z)))
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


# For packets of rays, and for points


@device
def corners_of_number(field, number):
    """The corners of a field's triangle, as `_write_triangles` has them: triples of float64."""
    own = np.uint64(np.int32(number - field.first_id))
    cell, is_upper = own >> _ONE, own & _ONE == _NONE
    row, column = cell // field.columns, cell % field.columns
    x, y = field.x + (column << _TWO), field.y + (row << _TWO)
    top = field.heights + ((row * field.width + column) << _TWO)
    bottom = top + (field.width << _TWO)
    a = _place(x, y, top)
    c = _place(x + _FOUR, y + _FOUR, bottom + _FOUR)
    other = _place(x + _FOUR, y, top + _FOUR) if is_upper else _place(x, y + _FOUR, bottom)
    if (field.turns == _TURNED) == is_upper:
        return a, c, other
    return a, other, c


@device
def _place(x, y, z):
    return (
        np.float64(load(np.float32, x)),
        np.float64(load(np.float32, y)),
        np.float64(load(np.float32, z)),
    )


@device
def fill_row(field, row, column, blocks):
    """Write the triangles of four cells to two leaf blocks; returns their box, see `_box`."""
    cells = _load_row(field, row, column)
    for half in range(_TWO):
        _write_triangles(field, cells, half, row, column, blocks + half * BLOCK)
    x = _plane(field.x, column), _plane(field.x, min(column + _LANES, field.columns))
    low, high = f32x4(_INF), f32x4(-_INF)
    for z in cells[2]:  # the second operand stays where the first one is NaN
        low, high = minimum(z, low), maximum(z, high)
    return _box(x, cells[1], (reduce_min(low), reduce_max(high)))
