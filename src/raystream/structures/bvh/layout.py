"""The arrays of an 8-wide BVH, and the check that they are safe to traverse."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.jit.cpu import kernel
from raystream.kernels.aligned import ALIGNMENT, aligned_array
from raystream.kernels.leaf_block import BLOCK_FLOATS, BLOCK_SIZE, PRIM_IDS
from raystream.structures.bvh.options import MAX_LEAF_SIZE
from raystream.structures.saved import take

#: Children of a node.
WIDTH = 8

#: Size of a node, and byte offset of its 8 child links.
NODE_BYTES = 256
NODE_FLOATS = NODE_BYTES // 4
CHILDREN_AT = 192

#: Most blocks of a leaf: limited by the bits of its link.
MAX_LEAF_BLOCKS = MAX_LEAF_SIZE // BLOCK_SIZE

#: Most blocks of a tree: an index has 28 bits in a link.
MAX_BLOCKS = 1 << 28

#: Nodes on the longest path, in the builder and the traversal.
MAX_DEPTH = 64

#: Each node on a path leaves at most 7 entries on the stack, and the last one 8.
STACK_SIZE = (WIDTH - 1) * MAX_DEPTH + 1

#: Offset of the prim_ids in a block, in words.
_IDS_AT = int(PRIM_IDS) // 4


class BvhArrays(NamedTuple):
    """Nodes with the boxes of 8 children each, and leaves of blocks with 4 triangles each.

    Attributes
    ----------
    nodes : ndarray of shape (M, 64), float32
        Row 0 is the root. Eight numbers each, one for each child: low x, high x, low y,
        high y, low z, high z, all in the local frame; then the child itself, as the bits of
        an int32: the row of a node, greater than its parent's, or for a leaf
        ``~(first_block << 3 | block_count - 1)``. A child that is absent has an empty box
        (low = inf, high = -inf), which no ray enters, and link 0; absent ones are last. The
        last eight numbers are 0.
    leaves : ndarray of shape (B, 40), float32
        Blocks, see `kernels.leaf_block`. A triangle that moved and can no longer be hit keeps
        its prim_id and has coordinates NaN.

    Notes
    -----
    The first rows begin at a multiple of 64 bytes. A triangle is in one leaf at most.
    """

    nodes: NDArray[np.float32]
    leaves: NDArray[np.float32]

    @property
    def children(self) -> NDArray[np.int32]:
        """The links of the nodes, shape (M, 8), int32."""
        return self.nodes.view(np.int32)[:, CHILDREN_AT // 4 : CHILDREN_AT // 4 + WIDTH]

    @property
    def prim_ids(self) -> NDArray[np.int32]:
        """The triangles of the blocks, shape (B, 4), int32; -1 for unused lanes."""
        return self.leaves.view(np.int32)[:, _IDS_AT:]


class TreeAddresses(NamedTuple):
    """`BvhArrays` as kernels take them; the caller keeps the arrays alive.

    Attributes
    ----------
    nodes, leaves : uint64
        Addresses of the first node and the first leaf block; 0 for an empty tree.
    """

    nodes: np.uint64
    leaves: np.uint64


# Codes that `_check_tree` returns.
_BAD_CHILD, _BAD_LEAF, _BAD_ID, _BAD_LANE, _MISSING, _REPEATED = range(-1, -7, -1)
_FAULTS = {
    _BAD_CHILD: "a node's child is out of range or has two parents",
    _BAD_LEAF: "a leaf is out of range",
    _BAD_ID: "a leaf has a prim_id that is out of range",
    _BAD_LANE: "an absent child has a box",
    _REPEATED: "a triangle is in more than one leaf; rebuild the structure",
    _MISSING: "a triangle of the scene is in no leaf",
}


@kernel
def _check_tree(nodes, children, prim_ids, depths, wanted, held):
    """Depth of the tree, or a negative error code.

    `wanted` is true for each triangle that must be in a leaf; `held`, false at first, becomes true
    for each that is.
    """
    node_count, block_count = len(children), len(prim_ids)
    deepest = 0
    for node in range(node_count):
        # Parents come before their children, so a node not reached by now is unreachable.
        if node > 0 and depths[node] == 0:
            return _BAD_CHILD
        depth = depths[node] + 1
        deepest = max(deepest, depth)
        for lane in range(WIDTH):
            child = np.int64(children[node, lane])
            if child != 0 and lane > 0 and children[node, lane - 1] == 0:
                return _BAD_LANE  # kernels stop at the first empty lane
            if child == 0:
                for axis in range(3):
                    low = nodes[node, axis * 2 * WIDTH + lane]
                    high = nodes[node, (axis * 2 + 1) * WIDTH + lane]
                    if low != np.inf or high != -np.inf:
                        return _BAD_LANE
            elif child > 0:
                # A greater index than the parent's: no cycle. Not seen before: one parent.
                if child <= node or child >= node_count or depths[child] != 0:
                    return _BAD_CHILD
                depths[child] = depth
            else:
                first = ~child >> 3
                last = first + (~child & 7) + 1
                if last > block_count:
                    return _BAD_LEAF
                for block in range(first, last):
                    for k in range(BLOCK_SIZE):
                        prim_id = np.int64(prim_ids[block, k])
                        if prim_id < -1 or prim_id >= len(wanted):
                            return _BAD_ID
                        if prim_id >= 0 and k > 0 and prim_ids[block, k - 1] < 0:
                            return _BAD_ID  # likewise
                        if prim_id >= 0:
                            if held[prim_id]:
                                return _REPEATED
                            held[prim_id] = True
    for row in range(len(wanted)):
        if wanted[row] and not held[row]:
            return _MISSING
    return deepest


def check_arrays(
    arrays: Mapping[str, NDArray[Any]],
    solid_ids: NDArray[np.int32],
    corners: NDArray[np.float32],
) -> BvhArrays:
    """Check that any traversal of a tree from a file terminates and stays in bounds.

    Parameters
    ----------
    arrays : mapping of str to ndarray
        ``nodes`` and ``leaves``, see `BvhArrays`.
    solid_ids : ndarray of shape (A,), int32
        The triangles that the tree must hold, in increasing order.
    corners : ndarray of shape (F, 3, 3), float32
        Their expected corners.

    Returns
    -------
    BvhArrays
        The same arrays, or aligned copies of them.

    Raises
    ------
    ValueError
        If the tree is invalid.
    """
    nodes = _aligned(take(arrays, "nodes", np.float32, (None, NODE_FLOATS)))
    leaves = _aligned(take(arrays, "leaves", np.float32, (None, BLOCK_FLOATS)))
    tree = BvhArrays(nodes, leaves)
    wanted = np.zeros(len(corners), np.bool_)
    wanted[solid_ids] = True
    if not _are_the_same(tree, wanted, corners):
        raise ValueError("the triangles differ from the scene's")
    depths, held = np.zeros(len(nodes), np.int32), np.zeros_like(wanted)
    depth = _check_tree(nodes, tree.children, tree.prim_ids, depths, wanted, held)
    if depth in _FAULTS:
        raise ValueError(_FAULTS[depth])
    if depth > MAX_DEPTH:
        raise ValueError(f"the tree is {depth} nodes deep; at most {MAX_DEPTH} are possible")
    return tree


def _are_the_same(tree: BvhArrays, solid: NDArray[np.bool_], corners: NDArray[np.float32]) -> bool:
    """Whether the leaves have the scene's corners, NaN for triangles that cannot be hit."""
    rows = 1 << 16  # bounds the temporaries
    for first in range(0, len(tree.leaves), rows):
        ids = tree.prim_ids[first : first + rows]
        if (ids >= len(solid)).any():
            return False
        here = ids >= 0
        here[here] = solid[ids[here]]
        held = tree.leaves[first : first + rows, :_IDS_AT].reshape(-1, 3, 3, BLOCK_SIZE)
        held = held.transpose(0, 3, 1, 2)
        if not np.array_equal(held[here], corners[ids[here]]):
            return False
        if not np.isnan(held[~here]).all():
            return False
    return True


def _aligned(array: NDArray[np.float32]) -> NDArray[np.float32]:
    if array.ctypes.data % ALIGNMENT == 0:
        return array
    aligned = aligned_array(*array.shape)
    aligned[:] = array
    return aligned
