"""The binary layout: nodes of 64 bytes, each with the boxes of its two children.

Each wide node is expanded to a binary tree over its children, where the wide tree is: on the host,
or on the device that built it.

References
----------
Aila, Laine, "Understanding the Efficiency of Ray Traversal on GPUs", High Performance Graphics
2009.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.cuda.bvh.pairs import CHILD, COUNT, WRITE, WideAt, count_rows, write_rows
from raystream.cuda.bvh.triangles import TRIANGLE_FLOATS
from raystream.jit.constants import NULL
from raystream.jit.cuda import DeviceArray, Gpu
from raystream.jit.cuda.scan import scan_in_place
from raystream.jit.threads import parallel_for
from raystream.kernels.aligned import aligned_array
from raystream.kernels.leaf_block import BLOCK_FLOATS
from raystream.structures.bvh.layout import MAX_DEPTH, WIDTH, BvhArrays
from raystream.structures.bvh.statistics import statistics

#: Floats of a node: those of two `pairs.CHILD`. A link is a node's row, and for a leaf
#: ``~first_triangle``, or the wide tree's link. An absent child is 0, with an empty box.
NODE_FLOATS = 2 * CHILD.itemsize // 4

#: Levels of a balanced binary tree of eight leaves.
_LEVELS = 3

#: Bytes of a search's stack: a child for each level.
STACK_BYTES = 4 * _LEVELS * (MAX_DEPTH + 1)

#: Wide levels that fit this stack whatever the binary trees are; deeper trees are balanced.
ANY_SHAPE_DEPTH = STACK_BYTES // (4 * (WIDTH - 1))

#: Wide nodes per call of a kernel on the host.
CHUNK = 4096

_NO_LEAVES = np.zeros((0, BLOCK_FLOATS), np.float32)


class Binary(NamedTuple):
    """A binary tree in host memory.

    Attributes
    ----------
    nodes : ndarray of shape (R, 16), float32
        The root first.
    leaves : ndarray of shape (T, 12), float32
        Triangles.
    firsts : ndarray of shape (M + 1,), int64
        The row in which each wide node's binary nodes begin, and the end.
    """

    nodes: NDArray[np.float32]
    leaves: NDArray[np.float32]
    firsts: NDArray[np.int64]


def unfold(nodes: NDArray[np.float32], leaves: NDArray[np.float32] | None = None) -> Binary:
    """Expand a wide tree in host memory to the binary layout, or a row of such trees.

    Parameters
    ----------
    nodes, leaves : ndarray
        See `BvhArrays`. Without `leaves`, links to leaves stay as they are.
    """
    count = len(nodes)
    firsts = np.zeros(count + 1, np.uint64)
    leaves_at = NULL if leaves is None else np.uint64(leaves.ctypes.data)
    given = WideAt(np.uint64(nodes.ctypes.data), leaves_at, np.uint64(firsts.ctypes.data))
    parallel_for(lambda begin, end: count_rows(begin, end, given, None), count, CHUNK)
    firsts[:] = np.cumsum(firsts) - firsts
    triangle_count, node_count = divmod(int(firsts[count]), 1 << 32)  # see `WideAt`
    pairs = aligned_array(node_count, NODE_FLOATS)
    triangles = aligned_array(triangle_count, TRIANGLE_FLOATS)
    depth = statistics(BvhArrays(nodes, _NO_LEAVES))["depth"]
    to = depth > ANY_SHAPE_DEPTH, np.uint64(pairs.ctypes.data), np.uint64(triangles.ctypes.data)
    parallel_for(lambda begin, end: write_rows(begin, end, given, to), count, CHUNK)
    return Binary(pairs, triangles, (firsts & 0xFFFFFFFF).astype(np.int64))


def unfold_on_device(
    gpu: Gpu, wide_nodes: DeviceArray, leaves: DeviceArray, depth: int
) -> tuple[DeviceArray, DeviceArray]:
    """Expand a wide tree of some depth in device memory; see `unfold`.

    Raises
    ------
    CudaError
        If device memory runs out.
    """
    count = wide_nodes.shape[0]
    firsts = gpu.empty("binary nodes before each wide one", count + 1, np.uint64)
    given = WideAt(wide_nodes.address, leaves.address, firsts.address)
    COUNT.launch(gpu, count, (given, None))
    triangle_count, node_count = divmod(scan_in_place(gpu, firsts), 1 << 32)
    nodes = gpu.empty("binary nodes", (node_count, NODE_FLOATS), np.float32)
    triangles = gpu.empty("triangles", (triangle_count, TRIANGLE_FLOATS), np.float32)
    to = depth > ANY_SHAPE_DEPTH, nodes, triangles
    WRITE.launch(gpu, count, (given, to))
    gpu.wait()  # `firsts` is freed
    return nodes, triangles
