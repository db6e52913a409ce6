"""The binary layout: nodes of 64 bytes, each with the boxes of its two children.

The CPU's builder discards its binary tree. Here each wide node is expanded to the binary tree of
least surface area over its children, found by dynamic programming over their subsets.

References
----------
Aila, Laine, "Understanding the Efficiency of Ray Traversal on GPUs", High Performance Graphics
2009.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.cuda.bvh.entries import CHUNK, COUNT, LINK, list_entries
from raystream.cuda.bvh.pairs import depth_of, write_pairs
from raystream.cuda.bvh.triangles import TRIANGLE_FLOATS
from raystream.jit.threads import parallel_for
from raystream.kernels.aligned import aligned_array
from raystream.structures.bvh.layout import MAX_DEPTH, BvhArrays

#: Floats of a node: low x, high x, low y, high y of the left child, then of the right one; low z,
#: high z of both; then, as bits of int32, the two children, and padding. A child is a node's row,
#: or for a leaf ``~first_triangle``. An absent child is 0, with an empty box.
NODE_FLOATS = 16

#: Levels of a balanced binary tree of eight leaves.
_LEVELS = 3

#: Bytes of a search's stack: a child for each level.
STACK_BYTES = 4 * _LEVELS * (MAX_DEPTH + 1)


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


def unfold(tree: BvhArrays) -> tuple[type[BinaryAddresses], dict[str, NDArray[np.float32]]]:
    """Expand a wide tree to the binary layout.

    Parameters
    ----------
    tree : BvhArrays

    Returns
    -------
    addresses : type
        Type of the tuple that takes the arrays' addresses, by name.
    arrays : dict
        ``nodes`` of shape (R, 16), float32, and ``triangles`` of shape (T, 12), float32.

    Notes
    -----
    If the trees of least area are too deep for the stack, the balanced trees of least area are
    used.
    """
    wide = list_entries(tree)
    child_counts = np.count_nonzero(wide.words[:, :, LINK], axis=1)
    first_nodes = _starts(np.maximum(child_counts - 1, 1))
    first_triangles = _starts(wide.words[:, :, COUNT].sum(axis=1, dtype=np.int64))
    nodes = aligned_array(int(first_nodes[-1]), NODE_FLOATS)
    nodes[:] = 0.0
    links = nodes.view(np.int32)
    triangles = aligned_array(int(first_triangles[-1]), TRIANGLE_FLOATS)
    for is_balanced in (False, True):
        parallel_for(
            lambda begin, end, is_balanced=is_balanced: write_pairs(  # type: ignore[misc]
                *(begin, end, is_balanced, first_nodes, first_triangles),
                *(wide, nodes, links, triangles),
            ),
            len(wide.entries),
            CHUNK,
        )
        if depth_of(links, np.zeros(len(nodes), np.int32)) * 4 <= STACK_BYTES:
            break
    return BinaryAddresses, {"nodes": nodes, "triangles": triangles}


def _starts(counts: NDArray[np.int64]) -> NDArray[np.int64]:
    """Where ranges of these lengths begin, and where the last one ends."""
    starts = np.zeros(len(counts) + 1, np.int64)
    np.cumsum(counts, out=starts[1:])
    return starts
