"""Binary BVHs on the device: their rows, and leaves sorted by Morton keys.

Nodes are rows, as in `structures.bvh.builder.binary_tree`: first the leaves in key order, then the
inner nodes. A leaf's row has its prim_id where an inner node would have its first record.

References
----------
Lauterbach, Garland, Sengupta, Luebke and Manocha, "Fast BVH Construction on GPUs", Computer
Graphics Forum 28(2), 2009.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.core.triangles import Triangles
from raystream.jit.constants import SHIFT_32, SHIFT_64
from raystream.jit.cpu import device
from raystream.jit.cuda import DeviceArray, Gpu, gpu_kernel
from raystream.jit.cuda.radix_sort import sort_pairs
from raystream.jit.simd import f32x8, load, maximum, scratch, store
from raystream.kernels.morton import spread_bits
from raystream.structures.bvh.builder.binary_tree import LINK_BYTES, Link
from raystream.structures.bvh.builder.collapse import COST_BYTES, leaf_costs, merge_costs
from raystream.structures.bvh.builder.prim_refs import COUNT_AT, REF_BYTES, write_ref

#: Bits of a key per axis.
_BITS = 16
_LAST_STEP = np.float64(2**_BITS - 1)

#: Costs of a node and of a leaf block, as on the CPU.
_COSTS = (np.float32(1.0), np.float32(1.0), np.float32(0.0))

_AXES = np.uint64(3)


class Nodes(NamedTuple):
    """The rows of a binary tree of N leaves on a device: rows N to 2 N - 2 are inner nodes.

    Attributes
    ----------
    boxes, links, costs : DeviceArray of shape (2 N, ...), uint8
        See `structures.bvh.builder.binary_tree` and `structures.bvh.builder.collapse`.
    max_leaf_size : int64
    """

    boxes: DeviceArray
    links: DeviceArray
    costs: DeviceArray
    max_leaf_size: np.int64

    @property
    def leaf_count(self) -> int:
        """N."""
        return len(self.boxes) // 2

    @classmethod
    def allocate(cls, gpu: Gpu, count: int, max_leaf_size: int) -> Nodes:
        """Allocate a tree of `count` leaves.

        Raises
        ------
        CudaError
            If device memory runs out: it takes 80 bytes per node.
        """
        rows = 2 * count
        return cls(
            gpu.empty("boxes", (rows, REF_BYTES), np.uint8),
            gpu.empty("links", (rows, LINK_BYTES), np.uint8),
            gpu.empty("costs", (rows, COST_BYTES), np.uint8),
            np.int64(max_leaf_size),
        )


class KeyFrame(NamedTuple):
    """Quantization of positions to Morton keys.

    Attributes
    ----------
    low : tuple of three float64
        Twice the low corner of the bounds.
    scale : float64
        Key steps per unit of doubled coordinates.
    """

    low: tuple[np.float64, np.float64, np.float64]
    scale: np.float64

    @classmethod
    def of(cls, triangles: Triangles) -> KeyFrame:
        """The frame of some triangles, with the same step size along all axes."""
        low, high = triangles.bounds.astype(np.float64)
        longest = float((high - low).max())
        x, y, z = 2.0 * low
        scale = 2.0**_BITS / (2.0 * longest) if longest > 0.0 else 0.0
        return cls((x, y, z), np.float64(scale))


@device
def _step(place, low, frame):
    """Quantize a doubled coordinate along one axis."""
    steps = (place - low) * frame.scale
    return np.uint64(np.int64(min(max(steps, 0.0), _LAST_STEP)))


@gpu_kernel(frame=KeyFrame)
def make_key(i, corners, prim_ids, frame, keys, values):
    """Write the key of the triangle in row i of `prim_ids`, and its prim_id."""
    prim_id = load(np.int32, prim_ids + (i << SHIFT_32))
    record = scratch(32)
    write_ref(corners, prim_id, record)
    key = np.uint64(0)
    for axis in range(_AXES):
        at = record + (axis << SHIFT_32)
        low, high = np.float64(-load(np.float32, at)), load(np.float32, at + np.uint64(16))
        key |= spread_bits(_step(low + np.float64(high), frame.low[axis], frame)) << axis
    store(keys + (i << SHIFT_64), key)
    store(values + (i << SHIFT_32), np.uint32(prim_id))


@gpu_kernel(nodes=Nodes)
def make_leaf(i, corners, values, nodes):
    """Write row i of the tree: a leaf of one triangle."""
    box = nodes.boxes + i * np.uint64(REF_BYTES)
    write_ref(corners, load(np.int32, values + (i << SHIFT_32)), box)
    store(box + np.uint64(COUNT_AT), np.int32(1))
    link = Link(nodes.links, i)
    link.left, link.is_top = np.int32(-1), np.int32(0)
    store(nodes.costs + i * np.uint64(COST_BYTES), leaf_costs(box, _COSTS))


@device
def join(nodes, row, left, right):
    """Write an inner node to a row, given the rows of its two children."""
    box = nodes.boxes + row * np.uint64(REF_BYTES)
    link = Link(nodes.links, row)
    left_box = nodes.boxes + left * np.uint64(REF_BYTES)
    right_box = nodes.boxes + right * np.uint64(REF_BYTES)
    count = load(np.int32, left_box + np.uint64(COUNT_AT))
    count += load(np.int32, right_box + np.uint64(COUNT_AT))
    store(box, maximum(load(f32x8, left_box), load(f32x8, right_box)))
    store(box + np.uint64(COUNT_AT), np.int32(count))
    link.left, link.right, link.is_top = np.int32(left), np.int32(right), np.int32(0)
    left_costs = load(f32x8, nodes.costs + left * np.uint64(COST_BYTES))
    right_costs = load(f32x8, nodes.costs + right * np.uint64(COST_BYTES))
    costs = merge_costs(box, link, left_costs, right_costs, nodes.max_leaf_size, _COSTS)
    store(nodes.costs + row * np.uint64(COST_BYTES), costs)


def make_leaves(gpu: Gpu, triangles: Triangles, corners: DeviceArray, nodes: Nodes) -> None:
    """Launch the kernels that write the leaves of a tree in key order.

    Parameters
    ----------
    gpu : Gpu
    triangles : Triangles
    corners : DeviceArray of shape (F, 3, 3), float32
        The triangles' corners.
    nodes : Nodes
        Its leaf rows are written.

    Raises
    ------
    CudaError
        If device memory runs out.
    """
    prim_ids = gpu.upload("prim_ids", triangles.prim_ids)
    keys = gpu.empty("keys", nodes.leaf_count, np.uint64)
    values = gpu.empty("triangles by key", nodes.leaf_count, np.uint32)
    given = corners, prim_ids, KeyFrame.of(triangles), keys, values
    make_key.launch(gpu, nodes.leaf_count, given)
    _, values = sort_pairs(gpu, keys, values, 3 * _BITS)
    make_leaf.launch(gpu, nodes.leaf_count, (corners, values, nodes))
