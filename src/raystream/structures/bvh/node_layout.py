"""Nodes, links and sort keys as kernels read them; see `layout` for the arrays."""

from __future__ import annotations

import numpy as np

from raystream.jit.constants import ONE_U64, ZERO_F32, ZERO_U64
from raystream.jit.cpu import device
from raystream.jit.simd import (
    float_as_bits,
    lanes_from_bits,
    mask8,
    maximum,
    minimum,
    permutation,
    prefetch,
    select,
)
from raystream.jit.views import view
from raystream.kernels.leaf_block import BLOCK

#: Bytes of a node and of its planes along one axis; offset from low to high planes.
NODE = np.uint64(256)
NODE_AXIS = np.uint64(64)
BOX_FLIP = np.uint64(32)

#: A node: low and high planes of its eight boxes for each axis, then links; and the same with a
#: lane index.
Node = view([("planes", "f4", (6, 8)), ("children", "i4", 8), ("unused", "V32")])
NodeLanes = view([("planes", "f4", (6, 8, 1)), ("children", "i4", (8, 1)), ("unused", "V32")])

#: Byte offset of a node's eight links.
CHILDREN = np.uint64(192)

#: Bytes of one lane.
LANE = np.uint64(4)

#: Low bits of a sort key, which hold the lane.
KEY_LANES = np.int32(7)

_LINE = np.uint64(64)
_NO_LIMIT = np.int32(2**31 - 1)
_BLOCK_BITS = np.int32(7)
_BLOCK_SHIFT = np.int32(3)


@device
def leaf_address(leaves, child):
    """Address of a leaf's first block; `child` is negative."""
    return leaves + np.uint64(np.int32(~child) >> _BLOCK_SHIFT) * BLOCK


@device
def leaf_end(first, child):
    """Address after a leaf's last block."""
    return first + (np.uint64(np.int32(~child) & _BLOCK_BITS) + np.uint64(1)) * BLOCK


@device
def prefetch_child(child, nodes, leaves):
    """Prefetch a node or the start of a leaf."""
    at = leaf_address(leaves, child) if child < np.int32(0) else nodes + np.uint64(child) * NODE
    prefetch(at)
    prefetch(at + _LINE)
    prefetch(at + (_LINE + _LINE))
    prefetch(at + (_LINE + _LINE + _LINE))


@device
def plane_offset(axis, inv):
    """Byte offset of the planes of an axis that a ray with this reciprocal enters by."""
    return axis * NODE_AXIS + (BOX_FLIP if inv < ZERO_F32 else ZERO_U64)


@device
def plane_row(axis, inv):
    """Row of the planes of an axis that a ray with this reciprocal enters by; see `Node`."""
    return (axis << ONE_U64) | (ONE_U64 if inv < ZERO_F32 else ZERO_U64)


@device
def t_key(t):
    """The largest sort key of a child within t, whatever its lane bits."""
    return np.int32(float_as_bits(t) | KEY_LANES) if t >= ZERO_F32 else _NO_LIMIT


# A sorting network of 8 lanes: 19 comparisons in 6 layers. In each layer pairs of lanes are
# exchanged, and the lanes in the mask keep the larger one.
_swap_1 = permutation(2, 3, 0, 1, 6, 7, 4, 5)
_swap_2 = permutation(4, 5, 6, 7, 0, 1, 2, 3)
_swap_3 = permutation(1, 0, 3, 2, 5, 4, 7, 6)
_swap_4 = permutation(0, 1, 4, 5, 2, 3, 6, 7)
_swap_5 = permutation(0, 4, 2, 6, 1, 5, 3, 7)
_swap_6 = permutation(0, 2, 1, 4, 3, 6, 5, 7)
_KEEP_1 = np.uint64(0b00110011)
_KEEP_2 = np.uint64(0b00001111)
_KEEP_3 = np.uint64(0b01010101)
_KEEP_4 = np.uint64(0b00001100)
_KEEP_5 = np.uint64(0b00001010)
_KEEP_6 = np.uint64(0b00101010)


@device
def _layer(keys, moved, keep):
    return select(lanes_from_bits(mask8, keep), maximum(keys, moved), minimum(keys, moved))


@device
def sort_keys(keys):
    """Sort eight i32 lanes in descending order."""
    keys = _layer(keys, _swap_1(keys), _KEEP_1)
    keys = _layer(keys, _swap_2(keys), _KEEP_2)
    keys = _layer(keys, _swap_3(keys), _KEEP_3)
    keys = _layer(keys, _swap_4(keys), _KEEP_4)
    keys = _layer(keys, _swap_5(keys), _KEEP_5)
    return _layer(keys, _swap_6(keys), _KEEP_6)
