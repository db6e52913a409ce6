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

from raystream.cuda.bvh.pairs import KERNELS, WideAt, count_rows, write_rows
from raystream.cuda.bvh.triangles import TRIANGLE_FLOATS
from raystream.jit.cuda import DeviceArray, Gpu
from raystream.jit.cuda.scan import Scan
from raystream.jit.threads import parallel_for
from raystream.kernels.aligned import aligned_array
from raystream.structures.bvh.layout import MAX_DEPTH, WIDTH, BvhArrays
from raystream.structures.bvh.statistics import statistics

#: Floats of a node: low x, high x, low y, high y of the left child, then of the right one; low z,
#: high z of both; then, as bits of int32, the two children, and padding. A child is a node's row,
#: or for a leaf ``~first_triangle``. An absent child is 0, with an empty box.
NODE_FLOATS = 16

#: Levels of a balanced binary tree of eight leaves.
_LEVELS = 3

#: Bytes of a search's stack: a child for each level.
STACK_BYTES = 4 * _LEVELS * (MAX_DEPTH + 1)

#: Wide levels that fit this stack whatever the binary trees are; deeper trees are balanced.
ANY_SHAPE_DEPTH = STACK_BYTES // (4 * (WIDTH - 1))

#: Wide nodes per call of a kernel on the host.
CHUNK = 4096


class BinaryAddresses(NamedTuple):
    """Addresses that the traversal reads; the caller keeps the arrays alive.

    Attributes
    ----------
    nodes : uint64
        Address of the nodes, the root first; 0 for an empty tree.
    triangles : uint64
        Address of the triangles, see `triangles`.
    """

    nodes: np.uint64
    triangles: np.uint64


def unfold(tree: BvhArrays) -> dict[str, NDArray[np.float32]]:
    """Expand a wide tree in host memory to the binary layout.

    Returns
    -------
    dict
        ``nodes`` of shape (R, 16), float32, and ``triangles`` of shape (T, 12), float32.
    """
    count = len(tree.nodes)
    firsts = np.zeros(count + 1, np.uint64)
    given = WideAt(*(np.uint64(one.ctypes.data) for one in (*tree, firsts)))
    parallel_for(lambda begin, end: count_rows(begin, end, given), count, CHUNK)
    firsts[:] = np.cumsum(firsts) - firsts
    triangle_count, node_count = divmod(int(firsts[count]), 1 << 32)  # see `WideAt`
    nodes = aligned_array(node_count, NODE_FLOATS)
    triangles = aligned_array(triangle_count, TRIANGLE_FLOATS)
    is_balanced = statistics(tree)["depth"] > ANY_SHAPE_DEPTH
    to = np.uint64(nodes.ctypes.data), np.uint64(triangles.ctypes.data)
    parallel_for(lambda begin, end: write_rows(begin, end, given, is_balanced, *to), count, CHUNK)
    return {"nodes": nodes, "triangles": triangles}


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
    KERNELS.count_row.launch(gpu, count, (given,))
    Scan(gpu, count).run(firsts.address, count, firsts.address, np.uint64)
    triangle_count, node_count = divmod(int(firsts.part(count, 1).host()[0]), 1 << 32)
    nodes = gpu.empty("binary nodes", (node_count, NODE_FLOATS), np.float32)
    triangles = gpu.empty("triangles", (triangle_count, TRIANGLE_FLOATS), np.float32)
    is_balanced = depth > ANY_SHAPE_DEPTH
    KERNELS.write_row.launch(gpu, count, (given, is_balanced, nodes.address, triangles.address))
    gpu.wait()  # `firsts` is freed
    return nodes, triangles
