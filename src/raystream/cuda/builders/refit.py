"""Refit of a BVH on the device to moved triangles, and its tracing cost."""

from __future__ import annotations

import numpy as np

from raystream.cuda.builders.wide import WideTree
from raystream.jit.constants import SHIFT_32, SHIFT_64
from raystream.jit.cpu import device
from raystream.jit.cuda import DeviceArray, Gpu, gpu_kernel
from raystream.jit.simd import load, store
from raystream.kernels.leaf_block import BLOCK
from raystream.structures.bvh.layout import CHILDREN_AT, NODE_BYTES, WIDTH
from raystream.structures.bvh.refit import refit_leaves, refit_node

#: Threads that sum costs, each over some nodes.
_ADDING_THREADS = 1 << 12

_AXIS_BYTES = np.uint64(64)
_HIGH = np.uint64(32)


@gpu_kernel()
def move_leaves(row, nodes, leaves, block_count, corners):
    """Update the leaves of a node and their boxes."""
    last_block = leaves + block_count * BLOCK
    refit_leaves(nodes + row * np.uint64(NODE_BYTES), corners, leaves, last_block)


@gpu_kernel()
def move_nodes(i, first, nodes):
    """Update the boxes of the inner children of node first + i."""
    refit_node(nodes + (first + i) * np.uint64(NODE_BYTES), nodes)


@device
def _extent(node, lane, axis):
    at = node + np.uint64(axis) * _AXIS_BYTES + (lane << SHIFT_32)
    return np.float64(load(np.float32, at + _HIGH)) - np.float64(load(np.float32, at))


@gpu_kernel()
def add_costs(i, thread_count, node_count, nodes, costs):
    """Sum the areas of the children of every `thread_count`-th node; a leaf counts per block."""
    total = 0.0
    row = i
    while row < node_count:
        node = nodes + row * np.uint64(NODE_BYTES)
        for lane in range(np.uint64(WIDTH)):
            link = load(np.int32, node + np.uint64(CHILDREN_AT) + (lane << SHIFT_32))
            x, y, z = _extent(node, lane, 0), _extent(node, lane, 1), _extent(node, lane, 2)
            area = x * y + y * z + z * x
            if link > np.int32(0):
                total += area
            elif link < np.int32(0):
                total += area * ((~link & np.int32(7)) + np.int32(1))
        row += thread_count
    store(costs + (i << SHIFT_64), total)


def refit(gpu: Gpu, tree: WideTree, corners: DeviceArray) -> None:
    """Launch an in-place refit to new positions of all triangles; see `structures.bvh.refit`.

    Parameters
    ----------
    gpu : Gpu
    tree : WideTree
        Modified; no query may run meanwhile.
    corners : DeviceArray of shape (F, 3, 3), float32
        By prim_id; one with a NaN is never hit.

    Raises
    ------
    CudaError
        If a kernel cannot be launched.
    """
    nodes, leaves, levels = tree
    block_count = np.uint64(leaves.shape[0])
    move_leaves.launch(gpu, nodes.shape[0], (nodes, leaves, block_count, corners))
    for first, end in zip(levels[-2::-1], levels[:0:-1], strict=True):
        move_nodes.launch(gpu, end - first, (np.uint64(first), nodes))


def cost_of(gpu: Gpu, tree: WideTree) -> float:
    """Expected nodes and leaf blocks on a random line through the bounds; waits for the device.

    Equal to `structures.bvh.structure.trace_cost` up to rounding.
    """
    nodes = tree.nodes
    thread_count = min(_ADDING_THREADS, nodes.shape[0])
    costs = gpu.empty("costs", thread_count, np.float64)
    counted = np.uint64(thread_count), np.uint64(nodes.shape[0])
    add_costs.launch(gpu, thread_count, (*counted, nodes, costs))
    root = nodes.part(0, nodes.shape[1]).host().reshape(-1, WIDTH)
    low, high = root[0:6:2].min(axis=1), root[1:6:2].max(axis=1)
    x, y, z = (high.astype(np.float64) - low).tolist()
    with np.errstate(divide="ignore", invalid="ignore"):
        return float(1.0 + np.float64(costs.host().sum()) / (x * y + y * z + z * x))
