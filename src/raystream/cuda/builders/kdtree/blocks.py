"""Leaf blocks, with the corners of their triangles."""

from __future__ import annotations

from raystream.jit.cpu import kernel
from raystream.jit.cuda import RangeKernel
from raystream.structures.kdtree.layout import fill_block

__all__ = ["FILL_BLOCK"]


@kernel
def _fill_block(block, prim_ids, corners, blocks):
    fill_block(block, prim_ids, corners, blocks)


#: Write a block of `kdtree.layout.filled_blocks`, given addresses.
FILL_BLOCK = RangeKernel(_fill_block)
