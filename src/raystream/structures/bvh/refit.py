"""Refit a finished tree to moved triangles: same nodes and leaves, new boxes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from raystream.jit.constants import INF_F32
from raystream.jit.cpu import device, kernel
from raystream.jit.simd import (
    address,
    f32x4,
    f32x8,
    load,
    maximum,
    minimum,
    prefetch,
    reduce_max,
    reduce_min,
    store,
)
from raystream.jit.threads import parallel_for
from raystream.kernels.leaf_block import BLOCK, BLOCK_SIZE, PRIM_IDS, TRIANGLE_BYTES, write_corners
from raystream.structures.bvh.layout import WIDTH, BvhArrays
from raystream.structures.bvh.node_layout import (
    BOX_FLIP,
    CHILDREN,
    LANE,
    NODE,
    NODE_AXIS,
    leaf_address,
    leaf_end,
)

#: Nodes per call of `_refit_leaves`.
_CHUNK = 1 << 9


def refit(arrays: BvhArrays, corners: NDArray[np.float32]) -> None:
    """Refit to new positions of all triangles, in place.

    Parameters
    ----------
    arrays : BvhArrays
        Changed; no query may run at the same time.
    corners : ndarray of shape (F, 3, 3), float32
        By prim_id, local frame. One with a NaN is never hit.

    Notes
    -----
    Boxes are the tightest around the triangles below them. Results stay correct however far
    triangles move, but rays take longer when neighbours drift apart: compare `statistics` before
    and after.
    """
    nodes, leaves = arrays
    corners = np.ascontiguousarray(corners, np.float32)
    parallel_for(
        lambda begin, end: _refit_leaves(begin, end, corners, nodes, leaves), len(nodes), _CHUNK
    )
    _refit_nodes(nodes)


@kernel
def _refit_leaves(begin, end, corners, nodes, leaves):
    """Write the blocks of the leaves of some nodes, and their boxes into the nodes."""
    corner_at, node_at, leaf_at = address(corners), address(nodes), address(leaves)
    last_block = leaf_at + np.uint64(len(leaves)) * BLOCK
    for row in range(np.uint64(begin), np.uint64(end)):
        refit_leaves(node_at + row * NODE, corner_at, leaf_at, last_block)


@device
def refit_leaves(node, corners, leaves, last_block):
    """Write the blocks of the leaves of a node, and their boxes into it.

    Parameters
    ----------
    node, corners, leaves : uint64
        Addresses of the node, and of all corners and blocks.
    last_block : uint64
        Address after the last block.
    """
    for lane in range(np.uint64(WIDTH)):
        link = load(np.int32, node + CHILDREN + lane * LANE)
        if link >= np.int32(0):
            continue
        first = block = leaf_address(leaves, link)
        end_block = leaf_end(first, link)
        while block != end_block:
            # The corners of the next leaf's triangles are far away in memory.
            if block + (BLOCK + BLOCK) < last_block:
                _prefetch_corners(block + (BLOCK + BLOCK), corners)
            _copy_corners(block, corners)
            block += BLOCK
        for axis in range(np.uint64(3)):
            low, high = f32x4(INF_F32), f32x4(-INF_F32)
            at = first + axis * np.uint64(16)
            while at < end_block:
                # NaN, of unused lanes, has no effect: the second operand wins.
                for vertex in range(np.uint64(3)):
                    plane = load(f32x4, at + vertex * np.uint64(48))
                    low, high = minimum(plane, low), maximum(plane, high)
                at += BLOCK
            to = node + axis * NODE_AXIS + lane * LANE
            store(to, reduce_min(low))
            store(to + BOX_FLIP, reduce_max(high))


@device
def _prefetch_corners(block, corners):
    for k in range(np.uint64(BLOCK_SIZE)):
        prim_id = load(np.int32, block + PRIM_IDS + k * np.uint64(4))
        # For -1 the address is invalid, which a prefetch ignores.
        at = corners + np.uint64(prim_id) * TRIANGLE_BYTES
        prefetch(at)
        prefetch(at + (TRIANGLE_BYTES - np.uint64(4)))


@device
def _copy_corners(block, corners):
    for k in range(np.uint64(BLOCK_SIZE)):
        prim_id = load(np.int32, block + PRIM_IDS + k * np.uint64(4))
        if prim_id < np.int32(0):
            break
        write_corners(block, k, prim_id, corners)


@kernel
def _refit_nodes(nodes):
    """Write the boxes of children that are nodes; those of leaves are up to date."""
    node_at = address(nodes)
    row = np.uint64(len(nodes))
    while row != np.uint64(0):
        row -= np.uint64(1)
        # Children have greater rows, which are done.
        refit_node(node_at + row * NODE, node_at)


@device
def refit_node(node, nodes):
    """Write the boxes of a node's children that are nodes, from their own children's.

    Parameters
    ----------
    node, nodes : uint64
        Addresses of the node, and of all nodes.
    """
    for lane in range(np.uint64(WIDTH)):
        link = load(np.int32, node + CHILDREN + lane * LANE)
        if link <= np.int32(0):
            continue
        child = nodes + np.uint64(link) * NODE
        for axis in range(np.uint64(3)):
            planes = axis * NODE_AXIS
            to = node + planes + lane * LANE
            store(to, reduce_min(load(f32x8, child + planes)))
            store(to + BOX_FLIP, reduce_max(load(f32x8, child + planes + BOX_FLIP)))
