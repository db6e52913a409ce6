"""The compressed layout: 8-wide nodes of 80 bytes, with a byte per plane of the children's boxes.

A node has an origin p and, for each axis, a step s that is a power of two; a child's planes are
p + q s with q from 0 to 255, rounded outward. Children are in slots by octant: slot i comes first
for rays whose direction is negative along axis k exactly if bit k of i is 1. A ray visits the slots
in the order of slot number XOR octant. The child nodes of a node are contiguous, in the order of
slots, and so are the triangles of its leaves.

Unlike in the paper, a leaf may have four triangles, as in the CPU's tree, and a node up to 32: the
work that a ray has left in a node is eight bits of nodes and 32 bits of triangles, in two words.
Larger leaves become nodes of several.

References
----------
Ylitie, Karras, Laine, "Efficient Incoherent Ray Traversal on GPUs Through Compressed Wide BVHs",
High Performance Graphics 2017, sections 3 and 4.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.cuda.bvh.entries import CHUNK, COUNT, LINK, list_entries
from raystream.cuda.bvh.quantise import number_nodes, write_nodes
from raystream.cuda.bvh.slots import assign_slots
from raystream.cuda.bvh.triangles import TRIANGLE_FLOATS
from raystream.jit.threads import parallel_for
from raystream.kernels.aligned import aligned_array
from raystream.structures.bvh.layout import MAX_DEPTH, WIDTH, BvhArrays

__all__ = ["LEAF_SIZE", "NODE_WORDS", "STACK_BYTES", "CompressedAddresses", "compress"]

#: 32-bit words of a node: p; the biased exponents of the steps and the mask of slots that are
#: nodes, a byte each; row of the first child node; row of the first triangle; a byte for each slot;
#: the bytes q of low x, y, z, of high x, y, z.
NODE_WORDS = 20

#: Maximum number of triangles in a leaf.
LEAF_SIZE = 4

#: Bytes of a search's stack: an entry for the remaining children of a node at each level, and one
#: for leaves that became nodes.
STACK_BYTES = 8 * (MAX_DEPTH + 2)


class CompressedAddresses(NamedTuple):
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


def compress(tree: BvhArrays) -> tuple[type[CompressedAddresses], dict[str, NDArray[Any]]]:
    """Convert a wide tree to the compressed layout.

    Parameters
    ----------
    tree : BvhArrays

    Returns
    -------
    addresses : type
        Type of the tuple that takes the arrays' addresses, by name.
    arrays : dict
        ``nodes`` of shape (R, 20), uint32, and ``triangles`` of shape (T, 12), float32.
    """
    wide = list_entries(tree)
    entries, words, _ = wide
    parallel_for(lambda begin, end: assign_slots(begin, end, entries, words), len(entries), CHUNK)
    is_large = (words[:, :, LINK] < 0) & (words[:, :, COUNT] > LEAF_SIZE)
    most = len(entries) + int(np.count_nonzero(is_large))
    sources, bases = np.zeros(most, np.int64), np.zeros((most, 2), np.uint32)
    pending = np.empty(WIDTH * (MAX_DEPTH + 2), np.int64)
    node_count, triangle_count = number_nodes(words, sources, bases, pending)
    floats = aligned_array(node_count, NODE_WORDS)
    nodes = floats.view(np.uint32)
    nodes[:] = 0
    triangles = aligned_array(triangle_count, TRIANGLE_FLOATS)
    parallel_for(
        lambda begin, end: write_nodes(begin, end, sources, bases, wide, nodes, floats, triangles),
        node_count,
        CHUNK,
    )
    return CompressedAddresses, {"nodes": nodes, "triangles": triangles}
