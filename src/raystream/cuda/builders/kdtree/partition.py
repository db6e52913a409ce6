"""Stable partition of a level's references into the cells below and above the planes.

Each reference is read twice: first to count its parts, then, after a scan of the counts, to write
them. Cells of the next level are in the order of their parents, the one below the plane first.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.cuda.builders.kdtree.planes import Choices, Level, References, cell_range
from raystream.jit.atomics import atomic_add_aggregated
from raystream.jit.constants import BITS_32, BYTES_64, LOW_32, ONE_U64, TWO_U64, ZERO_U64
from raystream.jit.cpu import device
from raystream.jit.cuda import DeviceArray, gpu_kernel
from raystream.jit.simd import load, scratch, store
from raystream.structures.boxes import copy_box
from raystream.structures.clip import BOX_BYTES, HIGH, WORD
from raystream.structures.kdtree.layout import LEAF_AXIS
from raystream.structures.kdtree.split import LEAF
from raystream.structures.kdtree.subtree import room_above, split_reference

_NODE = np.uint64(8)
_TRIANGLE = np.uint64(36)


class Counts(NamedTuple):
    """Counts, after a scan their prefix sums: a uint64 each, and one for the total.

    Attributes
    ----------
    parts : DeviceArray of shape (R + 1,), uint64
        Of references: parts below the plane, times 2**32, plus parts above it.
    cells : DeviceArray of shape (C + 1,), uint64
        Of cells: 2**32 for one that is split, the number of its references for a leaf.
    """

    parts: DeviceArray
    cells: DeviceArray


class Made(NamedTuple):
    """A finished level.

    Attributes
    ----------
    nodes : DeviceArray of shape (C, 2), int32
        Of cells, as `kdtree.layout.KdArrays.nodes`; a leaf's first word is the index of its first
        reference in `ids`.
    sizes : DeviceArray of shape (C,), uint32
        The number of the cells' references.
    ids : DeviceArray, int32
        prim_ids of all leaves.
    """

    nodes: DeviceArray
    sizes: DeviceArray
    ids: DeviceArray


class GrownTriangles(NamedTuple):
    """Triangles, and the margin by which their boxes are grown.

    Attributes
    ----------
    corners : DeviceArray of shape (F, 3, 3), float32
    bound : float64
        See `structures.clip`.
    overlap : int64
        See `kdtree.subtree.BuildSettings`.
    """

    corners: DeviceArray
    bound: np.float64
    overlap: np.int64


@device
def _choice(choices, cell):
    """Axis and position of a cell's plane."""
    at = cell * WORD
    axis = np.uint64(load(np.uint32, choices.axes + at))
    return axis, load(np.float32, choices.positions + at)


@gpu_kernel(refs=References, choices=Choices)
def count_cut(i, refs, choices):
    """Count reference i if its cell's plane cuts its box."""
    cell = np.uint64(load(np.uint32, refs.cells + i * WORD))
    axis, position = _choice(choices, cell)
    if axis == LEAF:
        return
    box = refs.boxes + i * BOX_BYTES + axis * WORD
    if load(np.float32, box) < position and load(np.float32, box + HIGH) > position:
        atomic_add_aggregated(choices.cut_counts + cell * WORD, np.uint32(1))


@gpu_kernel(level=Level, choices=Choices, counts=Counts)
def confirm(cell, level, choices, counts):
    """Split a cell only if there is room for its parts, and count it."""
    begin, end = cell_range(level, cell)
    axis, _ = _choice(choices, cell)
    total = end - begin + np.uint64(load(np.uint32, choices.cut_counts + cell * WORD))
    if axis != LEAF and total > load(np.uint64, level.rooms + cell * BYTES_64):
        axis = LEAF
        store(choices.axes + cell * WORD, np.uint32(axis))
    store(counts.cells + cell * BYTES_64, end - begin if axis == LEAF else ONE_U64 << BITS_32)


@device
def _part(i, refs, choices, triangles, below, above):
    """Whether reference i is below and above its cell's plane; writes its box on each side."""
    cell = np.uint64(load(np.uint32, refs.cells + i * WORD))
    axis, position = _choice(choices, cell)
    if axis == LEAF:
        return False, False
    triangle = triangles.corners + np.uint64(load(np.int32, refs.ids + i * WORD)) * _TRIANGLE
    box = refs.boxes + i * BOX_BYTES
    return split_reference(box, triangle, triangles, axis * WORD, position, below, above)


@gpu_kernel(refs=References, choices=Choices, triangles=GrownTriangles, counts=Counts)
def count_parts(i, refs, choices, triangles, counts):
    """Count the parts of reference i."""
    below, above = scratch(24), scratch(24)
    is_below, is_above = _part(i, refs, choices, triangles, below, above)
    found = ONE_U64 << BITS_32 if is_below else ZERO_U64
    found += ONE_U64 if is_above else ZERO_U64
    store(counts.parts + i * BYTES_64, found)


@device
def _before(counts, i):
    """Number of parts below planes, and above, of all references before reference i."""
    found = load(np.uint64, counts.parts + i * BYTES_64)
    return found >> BITS_32, found & LOW_32


@device
def _places(level, counts, cell):
    """Ranges of a cell's parts: begin of those below, begin of those above, end."""
    begin, end = cell_range(level, cell)
    below, above = _before(counts, begin)
    below_end, above_end = _before(counts, end)
    return below + above, below_end + above, below_end + above_end


@gpu_kernel(level=Level, choices=Choices, counts=Counts, made=Made, parts=Level)
def make_cells(cell, level, choices, counts, made, first_row, first_id, parts):
    """Write a cell's node and, if it is split, its two child cells."""
    begin, end = cell_range(level, cell)
    axis, position = _choice(choices, cell)
    before = load(np.uint64, counts.cells + cell * BYTES_64)
    node = made.nodes + cell * _NODE
    store(made.sizes + cell * WORD, np.uint32(end - begin))
    if axis == LEAF:
        store(node, np.uint32(first_id + (before & LOW_32)))
        store(node + WORD, np.uint32((end - begin) << TWO_U64 | np.uint64(LEAF_AXIS)))
        return
    below = (before >> BITS_32) << ONE_U64
    store(node, position)
    store(node + WORD, np.uint32((first_row + below) << TWO_U64 | axis))
    # Its room is shared out by the children's numbers of references, as on the CPU.
    below_begin, above_begin, above_end = _places(level, counts, cell)
    room = load(np.uint64, level.rooms + cell * BYTES_64)
    above_room = room_above(room, above_begin - below_begin, above_end - above_begin)
    for side in range(TWO_U64):
        child = below + side
        box = parts.boxes + child * BOX_BYTES
        copy_box(box, level.boxes + cell * BOX_BYTES)
        store(box + axis * WORD + (ZERO_U64 if side == ONE_U64 else HIGH), position)
        begin = above_begin if side == ONE_U64 else below_begin
        store(parts.begins + child * WORD, np.uint32(begin))
        store(parts.bads + child * WORD, load(np.uint32, choices.bads + cell * WORD))
        store(parts.rooms + child * BYTES_64, above_room if side == ONE_U64 else room - above_room)
    # The level's end; elsewhere the same value as the next cell writes.
    store(parts.begins + (below + TWO_U64) * WORD, np.uint32(above_end))


@device
def _put_reference(parts, to, cell, box, prim_id):
    copy_box(parts.boxes + to * BOX_BYTES, box)
    store(parts.ids + to * WORD, prim_id)
    store(parts.cells + to * WORD, np.uint32(cell))


@gpu_kernel(
    refs=References,
    level=Level,
    choices=Choices,
    triangles=GrownTriangles,
    counts=Counts,
    made=Made,
    parts=References,
)
def place_parts(i, refs, level, choices, triangles, counts, made, first_id, parts):
    """Write the parts of reference i to their cells' ranges, or reference i to its leaf's list."""
    cell = np.uint64(load(np.uint32, refs.cells + i * WORD))
    prim_id = load(np.int32, refs.ids + i * WORD)
    before = load(np.uint64, counts.cells + cell * BYTES_64)
    axis, _ = _choice(choices, cell)
    if axis == LEAF:
        # A leaf's list is in the order of its references, after those of earlier leaves.
        begin, _ = cell_range(level, cell)
        to = first_id + (before & LOW_32) + i - begin
        store(made.ids + to * WORD, prim_id)
        return
    below, above = scratch(24), scratch(24)
    is_below, is_above = _part(i, refs, choices, triangles, below, above)
    begin, end = cell_range(level, cell)
    own_below, own_above = _before(counts, i)
    child = (before >> BITS_32) << ONE_U64
    # The cell's parts below come after all parts of earlier cells; its parts above after those.
    if is_below:
        _, all_above = _before(counts, begin)
        _put_reference(parts, own_below + all_above, child, below, prim_id)
    if is_above:
        all_below, _ = _before(counts, end)
        _put_reference(parts, all_below + own_above, child + ONE_U64, above, prim_id)


@gpu_kernel(bound=np.float32, refs=References)
def make_reference(i, corners, prim_ids, bound, refs):
    """Write the reference of the triangle in row i of `prim_ids`: its grown box."""
    prim_id = load(np.int32, prim_ids + i * WORD)
    triangle, box = corners + np.uint64(prim_id) * _TRIANGLE, refs.boxes + i * BOX_BYTES
    for axis in range(np.uint64(3)):
        at = triangle + axis * WORD
        a, b = load(np.float32, at), load(np.float32, at + np.uint64(12))
        c = load(np.float32, at + np.uint64(24))
        store(box + axis * WORD, min(a, b, c) - bound)
        store(box + HIGH + axis * WORD, max(a, b, c) + bound)
    store(refs.ids + i * WORD, prim_id)
    store(refs.cells + i * WORD, np.uint32(0))
