"""The children of the CPU's wide nodes, listed as input for the other layouts."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.jit.cpu import kernel
from raystream.jit.threads import parallel_for
from raystream.kernels.leaf_block import BLOCK_SIZE
from raystream.structures.bvh.layout import WIDTH, BvhArrays

#: Indices into an entry's eight numbers: its box and, as the bits of an int32, its link (as in
#: `BvhArrays`; 0 if there is no child) and the number of a leaf's triangles.
LOW, LINK, HIGH, COUNT = 0, 3, 4, 7

#: Wide nodes per call of a kernel.
CHUNK = 4096


class WideEntries(NamedTuple):
    """The children of wide nodes, and the leaves of their tree.

    Attributes
    ----------
    entries, words : ndarray of shape (M, 8, 8), float32 and int32
        The same memory; see `LOW`.
    leaves : ndarray
        The CPU's leaf blocks.
    """

    entries: NDArray[np.float32]
    words: NDArray[np.int32]
    leaves: NDArray[Any]


def list_entries(tree: BvhArrays) -> WideEntries:
    """List the children of each wide node that a ray may enter, without gaps.

    Children with an empty box, and leaves whose triangles cannot be hit, are omitted.
    """
    entries = np.zeros((len(tree.nodes), WIDTH, 8), np.float32)
    words = entries.view(np.int32)
    parallel_for(
        lambda begin, end: _list(
            begin, end, tree.nodes, tree.children, tree.leaves, tree.prim_ids, entries, words
        ),
        len(entries),
        CHUNK,
    )
    return WideEntries(entries, words, tree.leaves)


@kernel
def _list(begin, end, nodes, children, leaves, prim_ids, entries, words):
    for row in range(np.uint64(begin), np.uint64(end)):
        kept = np.uint64(0)
        for lane in range(np.uint64(WIDTH)):
            link = children[row, lane]
            if link == 0:
                continue
            is_empty = False
            for axis in range(np.uint64(3)):
                plane = axis * np.uint64(2 * WIDTH) + lane
                is_empty = is_empty or nodes[row, plane] > nodes[row, plane + np.uint64(WIDTH)]
            if is_empty:
                continue
            count = 0
            if link < 0:
                first = np.uint64(~link >> 3)
                last = first + np.uint64(~link & 7)
                for block in range(first, last + np.uint64(1)):
                    for k in range(np.uint64(BLOCK_SIZE)):
                        # A triangle that can no longer be hit has NaN corners.
                        is_solid = leaves[block, k] == leaves[block, k]
                        count += prim_ids[block, k] >= 0 and is_solid
                if count == 0:
                    continue
            for axis in range(np.uint64(3)):
                plane = axis * np.uint64(2 * WIDTH) + lane
                entries[row, kept, np.uint64(LOW) + axis] = nodes[row, plane]
                entries[row, kept, np.uint64(HIGH) + axis] = nodes[row, plane + np.uint64(WIDTH)]
            words[row, kept, LINK] = link
            words[row, kept, COUNT] = count
            kept += np.uint64(1)
