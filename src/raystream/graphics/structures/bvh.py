"""The bounding volume hierarchy as shaders read it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from raystream.graphics.structures.base import ShaderStructure, budget_for, numbers
from raystream.kernels.leaf_block import BLOCK_SIZE
from raystream.structures.bvh.layout import WIDTH, BvhArrays
from raystream.structures.bvh.structure import BvhStructure

#: Stack sizes are multiples of this, so that most trees share a shader.
_STACK_STEP = 32

#: The prim_id of a triangle without finite vertices after an update; see bvh_leaf.wgsl.
_NEVER_HIT = -2


def shader_structure(bvh: BvhStructure) -> ShaderStructure:
    """The nodes and leaves of the CPU."""
    tree = bvh.tree
    return ShaderStructure(
        name="bvh",
        shader="bvh.wgsl",
        tree=numbers(len(tree.nodes)),
        arrays=(tree.nodes.view(np.uint32), leaf_blocks(tree)),
        budget=budget_for(most_steps(tree)),
        sizes={"STACK_SIZE": stack_size(bvh.stack_half)},
    )


def most_steps(tree: BvhArrays) -> int:
    """Upper bound of the steps and tests of a search."""
    # A node is visited once and its children are popped once; a slot is read once, and a
    # triangle that is crossed once more.
    return (1 + WIDTH) * len(tree.nodes) + 2 * BLOCK_SIZE * len(tree.leaves)


def has_lost_triangles(tree: BvhArrays) -> bool:
    """Whether an update has moved triangles so that they cannot be hit."""
    return bool(_lost(tree).any())


def _lost(tree: BvhArrays) -> NDArray[np.bool_]:
    """The slots of triangles without coordinates, shape (B, 4)."""
    return np.isnan(tree.leaves[:, :BLOCK_SIZE]) & (tree.prim_ids >= 0)


def stack_size(half: int) -> int:
    """Entries of a stack, from the bytes of half of the CPU's: see `steps.stack_half`."""
    return -(-half // (4 * _STACK_STEP)) * _STACK_STEP


def leaf_blocks(tree: BvhArrays) -> NDArray[np.uint32]:
    """The leaves; triangles without coordinates are marked by their prim_id."""
    blocks = tree.leaves.view(np.uint32)
    is_lost = _lost(tree)
    if is_lost.any():
        blocks = blocks.copy()
        ids = BvhArrays(tree.nodes, blocks.view(np.float32)).prim_ids
        ids[is_lost] = _NEVER_HIT
    return blocks
