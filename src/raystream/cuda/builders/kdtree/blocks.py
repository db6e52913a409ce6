"""Leaf blocks filled with the corners of their triangles."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from raystream.jit.constants import THREE_U64
from raystream.jit.cpu import device
from raystream.jit.cuda import DeviceArray, Gpu, gpu_kernel
from raystream.jit.simd import load, store
from raystream.kernels.leaf_block import AXIS, BLOCK, BLOCK_FLOATS, BLOCK_SIZE, write_block
from raystream.structures.clip import WORD

_ABSENT = np.int32(-1)


@device
def copy_list(source, count, to):
    """Copy the prim_ids of a leaf, and mark what its last block has room for as absent."""
    for k in range((count + THREE_U64) & ~THREE_U64):
        store(to + k * WORD, load(np.int32, source + k * WORD) if k < count else _ABSENT)


@gpu_kernel()
def fill_block(block, prim_ids, corners, blocks):
    """Write a block of `kernels.leaf_block.filled_blocks`."""
    write_block(blocks + block * BLOCK, prim_ids + block * AXIS, corners)


def empty_lists(gpu: Gpu, block_count: int) -> DeviceArray:
    """Allocate the prim_ids of blocks, of shape (B, 4), int32."""
    return gpu.empty("triangles of blocks", (block_count, BLOCK_SIZE), np.int32)


def filled_blocks(gpu: Gpu, prim_ids: DeviceArray, corners: DeviceArray) -> DeviceArray:
    """Launch the kernel that writes the blocks of these prim_ids; see `empty_lists`."""
    blocks = gpu.empty("blocks", (len(prim_ids), BLOCK_FLOATS), np.float32)
    fill_block.launch(gpu, len(prim_ids), (prim_ids, corners, blocks))
    return blocks


def prim_ids_of(blocks: DeviceArray) -> NDArray[np.int32]:
    """Copy the prim_ids of blocks, which are their last four words, to the host."""
    return np.ascontiguousarray(blocks.host()[:, -BLOCK_SIZE:]).view(np.int32)
