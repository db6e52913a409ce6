"""Leaf blocks filled with the corners of their triangles."""

from __future__ import annotations

from raystream.jit.cpu import kernel
from raystream.jit.cuda import RangeKernel
from raystream.kernels.leaf_block import AXIS, BLOCK, write_block


@kernel
def _fill_block(block, prim_ids, corners, blocks):
    write_block(blocks + block * BLOCK, prim_ids + block * AXIS, corners)


#: Write a block of `kernels.leaf_block.filled_blocks`, given addresses.
FILL_BLOCK = RangeKernel(_fill_block)
