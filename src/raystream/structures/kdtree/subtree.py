"""Building kd-trees over the references of a cell, on one thread."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.jit.constants import ONE_U64, TWO_U64, ZERO_U64
from raystream.jit.cpu import device, device_call, kernel
from raystream.jit.simd import address, load, scratch, store
from raystream.structures.boxes import copy_box
from raystream.structures.clip import BOX_BYTES, HIGH, WORD, clip_to_plane
from raystream.structures.exact_overlap import clip_to_triangle
from raystream.structures.kdtree.layout import LEAF_AXIS
from raystream.structures.kdtree.options import MAX_DEPTH, OVERLAPS
from raystream.structures.kdtree.split import LEAF, WORK_BYTES, Costs, choose_split

_LANES = np.uint64(4)
_NODE = np.uint64(8)
_TRIANGLE = np.uint64(36)
_LEAF_BITS = np.int32(LEAF_AXIS)
_ABSENT = np.int32(-1)

#: See `KdTree`; for kernels.
_EXACT, _BOX = np.int64(OVERLAPS.index("exact")), np.int64(OVERLAPS.index("box"))

#: A pending cell: begin, end, node, depth, bad splits and room (uint64), and the box.
_PENDING = np.uint64(72)
_PENDING_BYTES = 72 * (MAX_DEPTH + 2)
_END_AT, _NODE_AT, _DEPTH_AT = np.uint64(8), np.uint64(16), np.uint64(24)
_BAD_AT, _ROOM_AT, _CELL_AT = np.uint64(32), np.uint64(40), np.uint64(48)


class BuildSettings(NamedTuple):
    """Settings of the builder.

    Attributes
    ----------
    costs : Costs
    max_depth : int
        Splits on a path.
    max_leaf_size : int
        Cells of at most this many references are not split.
    overlap : int
        Which cells list a triangle: an index of `options.OVERLAPS`.
    """

    costs: Costs
    max_depth: int
    max_leaf_size: int
    overlap: int = 0


class GrownTriangles(NamedTuple):
    """The triangles that references are clipped to.

    Attributes
    ----------
    corners : ndarray of shape (F, 3, 3), float32
    bound : float
        How far boxes and planes are grown, see `clip.BOUND`.
    overlap : int
        What references are clipped to, see `BuildSettings`.
    """

    corners: NDArray[np.float32]
    bound: float
    overlap: int


class References(NamedTuple):
    """The references of a cell, in the first `size` of R rows; the others are free.

    Attributes
    ----------
    boxes : ndarray of shape (R, 6), float32
        Low x, y, z, high x, y, z.
    ids : ndarray of shape (R,), int32
        Their triangles.
    size : int
        N; kernels do nothing if it is 0.
    """

    boxes: NDArray[np.float32]
    ids: NDArray[np.int32]
    size: int


class Cell(NamedTuple):
    """A cell that may be split.

    Attributes
    ----------
    box : ndarray of shape (6,), float32
    depth : int
        Splits above it.
    bad_splits, room : int
        See `split.choose_split`.
    """

    box: NDArray[np.float32]
    depth: int
    bad_splits: int
    room: int


@kernel
def make_references(begin, end, corners, prim_ids, bound, boxes, bounds):
    """Write the grown boxes of triangles to rows begin to end, and extend their bounds.

    Parameters
    ----------
    begin, end : int
    corners : ndarray of shape (F, 3, 3), float32
    prim_ids : ndarray of shape (A,), int32
        Rows of `corners`.
    bound : float32
        How far boxes are grown.
    boxes : ndarray of shape (A, 6), float32
        Low x, y, z, high x, y, z.
    bounds : ndarray of shape (6,), float32
    """
    for i in range(np.uint64(begin), np.uint64(end)):
        prim_id = np.uint64(prim_ids[i])
        for axis in range(np.uint64(3)):
            a, b, c = (
                corners[prim_id, 0, axis],
                corners[prim_id, 1, axis],
                corners[prim_id, 2, axis],
            )
            low, high = min(a, b, c) - bound, max(a, b, c) + bound
            boxes[i, axis], boxes[i, axis + np.uint64(3)] = low, high
            bounds[axis] = min(bounds[axis], low)
            bounds[axis + np.uint64(3)] = max(bounds[axis + np.uint64(3)], high)


@device
def _clip(triangle, triangles, box):
    """Clip a reference's box to its triangle; returns whether anything is left."""
    if triangles.overlap == _BOX:
        return True
    if triangles.overlap == _EXACT:
        return clip_to_triangle(triangle, triangles.bound, box)
    return clip_to_plane(triangle, triangles.bound, box)


@device
def split_reference(box, triangle, triangles, step, position, to_below, to_above):
    """Split a reference at a plane: find its sides, and write its box on each.

    Parameters
    ----------
    box : uint64
        Address of its box.
    triangle : uint64
        Address of its triangle.
    triangles : GrownTriangles
        For what it is clipped to.
    step : uint64
        Bytes from a box's x to the plane's axis.
    position : float32
        Of the plane.
    to_below, to_above : uint64
        Addresses of a box each, written; `to_above` may be `box`.

    Returns
    -------
    is_below, is_above : bool
    """
    low, high = load(np.float32, box + step), load(np.float32, box + HIGH + step)
    is_above = high > position
    is_below = low < position or not is_above
    is_cut = is_above and is_below
    if is_below:
        copy_box(to_below, box)
        if is_cut:
            store(to_below + HIGH + step, position)
            is_below = _clip(triangle, triangles, to_below)
    if is_above:
        copy_box(to_above, box)
        if is_cut:
            store(to_above + step, position)
            # Rounding must not lose it on both sides.
            is_above = _clip(triangle, triangles, to_above) or not is_below
    return is_below, is_above


@device
def room_above(room, below_count, above_count):
    """Room for references above the plane of a split: proportional, but enough for both sides."""
    above = room * above_count // max(below_count + above_count, ONE_U64)
    return min(max(above, above_count), room - below_count)


@device_call
def _partition(boxes, ids, begin, end, axis, position, triangles):
    """Partition a cell's references at a plane, and split those that it cuts.

    Those above are written from row `begin` on; those below from row `end` on.

    Returns
    -------
    above_end, below_end : uint64
    """
    above, below = begin, end
    corners = address(triangles.corners)
    step = axis * WORD
    for i in range(begin, end):
        box, prim_id = boxes + i * BOX_BYTES, load(np.int32, ids + i * WORD)
        triangle = corners + np.uint64(prim_id) * _TRIANGLE
        to_below, to_above = boxes + below * BOX_BYTES, boxes + above * BOX_BYTES
        is_below, is_above = split_reference(
            box, triangle, triangles, step, position, to_below, to_above
        )
        if is_above:
            store(ids + above * WORD, prim_id)
            above += ONE_U64
        if is_below:
            store(ids + below * WORD, prim_id)
            below += ONE_U64
    return above, below


@kernel
def split_range(references, cell, triangles, costs, result):
    """Split a cell in two, if that pays.

    Parameters
    ----------
    references : References
        Of 3 N rows. Written: those above the plane from row 0 on, those below it from row N on.
    cell : Cell
    triangles : GrownTriangles
    costs : Costs
    result : ndarray of shape (4,), int64
        Written: axis, or 3; bad splits; end of the rows above, and of those below.

    Returns
    -------
    float32
        The position of the plane.
    """
    position = np.float32(0.0)
    if references.size == 0:
        return position
    boxes, end = address(references.boxes), np.uint64(references.size)
    axis, position, bad = choose_split(
        boxes,
        ZERO_U64,
        end,
        address(cell.box),
        np.uint64(cell.bad_splits),
        np.uint64(cell.room),
        costs,
        scratch(WORK_BYTES),
    )
    result[0], result[1] = axis, bad
    if axis != LEAF:
        ids = address(references.ids)
        above, below = _partition(boxes, ids, ZERO_U64, end, axis, position, triangles)
        result[2], result[3] = above, below
    return position


@device
def _put_pending(to, begin, end, node, depth, bad_splits, room):
    store(to, begin)
    store(to + _END_AT, end)
    store(to + _NODE_AT, node)
    store(to + _DEPTH_AT, depth)
    store(to + _BAD_AT, bad_splits)
    store(to + _ROOM_AT, room)


@device
def put_leaf(node, ids, begin, end, leaf_ids, block):
    """Write a leaf and its blocks of triangles.

    Parameters
    ----------
    node : uint64
        Address.
    ids : uint64
        Address of the triangles, of which the leaf gets `begin` to `end`.
    begin, end : uint64
    leaf_ids : uint64
        Address of the blocks of all leaves.
    block : uint64
        The leaf's first one.

    Returns
    -------
    uint64
        The next block.
    """
    count = end - begin
    store(node, np.int32(block))
    store(node + WORD, np.int32((np.int32(count) << np.int32(2)) | _LEAF_BITS))
    next_block = block + (count + _LANES - ONE_U64) // _LANES
    to, last = leaf_ids + block * _LANES * WORD, leaf_ids + next_block * _LANES * WORD
    for i in range(begin, end):
        store(to, load(np.int32, ids + i * WORD))
        to += WORD
    while to != last:
        store(to, _ABSENT)
        to += WORD
    return next_block


@kernel
def grow_subtree(references, cell, triangles, settings, tree, result):
    """Build the whole tree over a cell.

    Parameters
    ----------
    references : References
        Of at least 2 room + N rows.
    cell : Cell
    triangles : GrownTriangles
    settings : BuildSettings
        With a depth of at most `MAX_DEPTH`.
    tree : KdArrays
        Written: up to M nodes, after which cells are not split; and, of shape
        (room / 4 + M / 2 + 2, 4), the triangles of the leaves.
    result : ndarray of shape (2,), int64
        Written: numbers of nodes and of blocks.
    """
    if references.size == 0:
        return
    box_at, id_at = address(references.boxes), address(references.ids)
    node_at, leaf_at = address(tree.nodes), address(tree.prim_ids)
    node_limit = len(tree.nodes)
    pending, work = scratch(_PENDING_BYTES), scratch(WORK_BYTES)
    count, room = np.uint64(references.size), np.uint64(cell.room)
    depth, bad_splits = np.uint64(cell.depth), np.uint64(cell.bad_splits)
    _put_pending(pending, ZERO_U64, count, ZERO_U64, depth, bad_splits, room)
    copy_box(pending + _CELL_AT, address(cell.box))
    node_end, block = ONE_U64, ZERO_U64
    top = pending + _PENDING
    while top != pending:
        top -= _PENDING
        begin, end = load(np.uint64, top), load(np.uint64, top + _END_AT)
        node = node_at + load(np.uint64, top + _NODE_AT) * _NODE
        level, left_room = load(np.uint64, top + _DEPTH_AT), load(np.uint64, top + _ROOM_AT)
        axis, position, bad = LEAF, np.float32(0.0), ZERO_U64
        is_large = end - begin > np.uint64(settings.max_leaf_size)
        has_room = node_end + TWO_U64 <= np.uint64(node_limit)
        if is_large and level < np.uint64(settings.max_depth) and has_room:
            axis, position, bad = choose_split(
                box_at,
                begin,
                end,
                top + _CELL_AT,
                load(np.uint64, top + _BAD_AT),
                left_room,
                settings.costs,
                work,
            )
        if axis == LEAF:
            block = put_leaf(node, id_at, begin, end, leaf_at, block)
            continue
        store(node, position)
        store(node + WORD, np.int32(node_end << TWO_U64 | axis))
        above_end, below_end = _partition(box_at, id_at, begin, end, axis, position, triangles)
        # Those below move down, so that all free rows follow them.
        below_count = below_end - end
        for i in range(below_count):
            copy_box(box_at + (above_end + i) * BOX_BYTES, box_at + (end + i) * BOX_BYTES)
            store(id_at + (above_end + i) * WORD, load(np.int32, id_at + (end + i) * WORD))
        below_end = above_end + below_count
        # choose_split has checked that there is enough room.
        above_room = room_above(left_room, below_count, above_end - begin)
        below = top + _PENDING
        copy_box(below + _CELL_AT, top + _CELL_AT)
        step = axis * WORD
        store(top + _CELL_AT + step, position)
        store(below + _CELL_AT + HIGH + step, position)
        level += ONE_U64
        _put_pending(top, begin, above_end, node_end + ONE_U64, level, bad, above_room)
        _put_pending(below, above_end, below_end, node_end, level, bad, left_room - above_room)
        top = below + _PENDING
        node_end += TWO_U64
    result[0], result[1] = node_end, block


@kernel
def place_subtree(begin, end, nodes, slot, base, first_block, tree):
    """Copy a subtree's nodes into the tree: its root to row `slot`, the others from `base` on.

    Parameters
    ----------
    begin, end : int
        Rows of `nodes` to copy.
    nodes : ndarray of shape (M, 2), int32
    slot, base, first_block : int
        `base` is odd.
    tree : ndarray of shape (T, 2), int32
    """
    for i in range(begin, end):
        to = slot if i == 0 else base + i - 1
        first, word = nodes[i, 0], nodes[i, 1]
        if word & 3 == LEAF_AXIS:
            tree[to, 0], tree[to, 1] = first + first_block, word
        else:
            tree[to, 0], tree[to, 1] = first, word + ((base - 1) << 2)
