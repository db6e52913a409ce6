"""The steps of a ray's traversal of the wide tree, each a function of a small state.

`traversal.traverse` runs them fused, one ray from start to end; the multipass machine runs each
over many rays, with their stacks in memory.

The stack has children with a key each: the distance at which the ray enters the child's box, with
the lane in the lowest three bits, so that eight keys are sorted at once. Keys and children are two
arrays, the halves of the stack. `begin` pushes the root, `next_entry` pops a child, and `visit`
pushes the children of a node that the ray enters, or `kernels.leaf_block` tests a block of a leaf.
Between steps, a ray's state is the bytes on its stack, the next child or block, the number of its
hits, and the distance beyond which none is wanted.
"""

from __future__ import annotations

import numpy as np

from raystream.jit.constants import NULL, SHIFT_32, ZERO_F32, ZERO_U64
from raystream.jit.cpu import device, kernel
from raystream.jit.simd import (
    compress,
    f32x8,
    float_as_bits,
    i32x8,
    lane_numbers,
    load,
    mask_bits,
    maximum,
    minimum,
    permute,
    popcount,
    select,
    store,
)
from raystream.kernels.triangle_lanes import slab_interval
from raystream.structures.bvh.layout import WIDTH, BvhArrays
from raystream.structures.bvh.node_layout import (
    BOX_FLIP,
    CHILDREN,
    LANE,
    NODE,
    leaf_address,
    leaf_end,
    plane_offset,
    sort_keys,
    t_key,
)

_ROOT = np.int32(0)
_KEY_BITS = np.int32(~7)
_NO_KEY = np.int32(-1)
_LEAST_KEY = np.int32(0)
_AXIS_SHIFT = np.uint64(4)  # `kernels.leaf_block.AXIS`

#: A half of a stack is a multiple of this many bytes, so that both are whole cache lines.
_HALF_LINE = 32


@device
def begin(tree, t_min, t_max, stack, half):
    """Push the root, if there is anything to search.

    Parameters
    ----------
    tree : TreeAddresses
    t_min, t_max : float32
        Closed interval in which a hit is wanted; may be empty.
    stack : uint64
        Address of two halves.
    half : uint64
        Bytes of a half: at least `stack_half` of the tree.

    Returns
    -------
    top : uint64
        Bytes in use of a half; 0 for an empty stack.
    """
    if tree.nodes == NULL or not (t_min <= t_max):
        return ZERO_U64
    store(stack, np.int32(0))
    store(stack + half, _ROOT)
    return LANE


@device
def next_entry(stack, half, top, t_far):
    """Pop the next child whose box the ray enters within t_far.

    Parameters
    ----------
    stack, half, top : uint64
        See `begin`.
    t_far : float32
        Hits beyond are not wanted.

    Returns
    -------
    found : bool
        Whether there is one; else the search is over.
    child : int32
        A node or leaf; see `is_leaf`.
    top : uint64
    """
    limit = t_key(t_far)
    while top != ZERO_U64:
        top -= LANE
        if load(np.int32, stack + top) <= limit:
            return True, load(np.int32, stack + half + top), top
    return False, _ROOT, top


@device
def is_leaf(child):
    """Whether a child is a leaf."""
    return child < np.int32(0)


@device
def leaf_blocks(tree, child):
    """Addresses of a leaf's first block, and after its last one."""
    block = leaf_address(tree.leaves, child)
    return block, leaf_end(block, child)


@device
def _first_planes(at, inv):
    """Offset of the planes that a ray enters by, for the axis at offset `at` in a block."""
    return plane_offset(at >> _AXIS_SHIFT, inv)


@device
def enter(node, line, t_min, t_far):
    """Test the boxes of a node's children.

    Parameters
    ----------
    node : uint64
        Address.
    line : BlockRay
    t_min, t_far : float32
        Closed interval in which a hit is wanted.

    Returns
    -------
    keys : i32x8
        The children's keys, with those that the ray does not enter.
    entered : mask8
        The children that it enters.
    """
    at_x = node + _first_planes(line.axis[0], line.inv[0])
    at_y = node + _first_planes(line.axis[1], line.inv[1])
    at_z = node + _first_planes(line.axis[2], line.inv[2])
    near = load(f32x8, at_x), load(f32x8, at_y), load(f32x8, at_z)
    at_x, at_y, at_z = at_x ^ BOX_FLIP, at_y ^ BOX_FLIP, at_z ^ BOX_FLIP
    planes = (*near, load(f32x8, at_x), load(f32x8, at_y), load(f32x8, at_z))
    t_in, t_out = slab_interval(planes, line.inv, line.near, line.far)
    entered = maximum(t_in, t_min) <= minimum(t_out, t_far)
    # Only the bits of positive numbers are in the numbers' order.
    keys = (float_as_bits(maximum(t_in, ZERO_F32)) & _KEY_BITS) | lane_numbers(i32x8)
    return keys, entered


@device
def push(node, keys, entered, wants_any, stack, half, top):
    """Push the children of a node that a ray enters, the nearest last.

    Parameters
    ----------
    node, keys, entered
        See `enter`.
    wants_any : bool
        Whether the search ends at any hit: then the children are not sorted, and all have the
        smallest key, as the interval does not shrink.
    stack, half, top : uint64
        See `begin`.

    Returns
    -------
    top : uint64
    """
    children = load(i32x8, node + CHILDREN)
    if wants_any:
        store(stack + top, i32x8(_LEAST_KEY))
        store(stack + half + top, compress(entered, children))
    else:
        key = sort_keys(select(entered, keys, i32x8(_NO_KEY)))
        store(stack + top, key)
        store(stack + half + top, permute(children, key))
    return top + (popcount(mask_bits(entered)) << SHIFT_32)


@device
def visit(tree, child, line, t_min, t_far, wants_any, stack, half, top):
    """Push the children of a node that a ray enters; see `enter` and `push`.

    Parameters
    ----------
    tree : TreeAddresses
    child : int32
        A node.
    line, t_min, t_far, wants_any, stack, half, top
        See there.

    Returns
    -------
    top : uint64
    """
    node = tree.nodes + np.uint64(child) * NODE
    keys, entered = enter(node, line, t_min, t_far)
    return push(node, keys, entered, wants_any, stack, half, top)


def stack_half(tree: BvhArrays) -> int:
    """Bytes of half a stack that suffice for any search in a tree.

    Parameters
    ----------
    tree : BvhArrays

    Returns
    -------
    int
        A multiple of 32.
    """
    entry_count = _most_entries(tree.children) if len(tree.nodes) else 1
    return -(-4 * entry_count // _HALF_LINE) * _HALF_LINE


@kernel
def _most_entries(children):
    """Most entries that `visit` writes to a half: those of other nodes, and eight lanes."""
    below = np.zeros(len(children), np.int64)
    most = 0
    for node in range(len(children)):  # parents come before their children
        most = max(most, below[node] + WIDTH)
        child_count = 0
        for lane in range(WIDTH):
            child_count += children[node, lane] != 0
        for lane in range(WIDTH):
            child = children[node, lane]
            if child > 0:
                below[child] = below[node] + child_count - 1
    return most
