"""Pruning of splits that did not pay off, level by level from the leaves up.

The CPU visits nodes one by one, and stops joining leaves when its memory for new lists is full.
Here leaves are joined wherever that pays off; if the new lists, scanned in the CPU's order, exceed
that memory, the pass is repeated with the nodes that fit.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.cuda.builders.kdtree.grow import GrownTree
from raystream.cuda.builders.kdtree.numbering import Numbers, split_at
from raystream.jit.constants import BYTES_64, TWO_U64, ZERO_U64
from raystream.jit.cuda import DeviceArray, Gpu, gpu_kernel
from raystream.jit.cuda.scan import scan_in_place
from raystream.jit.simd import load, scratch, store
from raystream.structures.clip import WORD
from raystream.structures.graph.cells import NODE_BYTES
from raystream.structures.graph.prune import (
    PENDING_BYTES,
    UNION_BYTES,
    Chosen,
    choose_leaf,
    weigh_split,
)
from raystream.structures.kdtree.layout import LEAF_AXIS
from raystream.structures.kdtree.split import Costs

_LEAF = np.uint64(LEAF_AXIS)
_ALL = np.uint64(0xFFFFFFFFFFFFFFFF)


class Lists(NamedTuple):
    """The triangles of leaves, on a device.

    Attributes
    ----------
    ids : DeviceArray, int32
        prim_ids of each leaf of the unpruned tree, padded to blocks of four.
    lists : DeviceArray of shape (M,), uint64
        Addresses into `ids`.
    sizes : DeviceArray of shape (M,), uint32
    """

    ids: DeviceArray
    lists: DeviceArray
    sizes: DeviceArray


class ListBudget(NamedTuple):
    """Memory for the lists of joined leaves.

    Attributes
    ----------
    rows : DeviceArray of shape (M,), uint32
        The CPU's rows of the nodes.
    sizes : DeviceArray of shape (M + 1,), uint64
        The new lists' sizes by those rows.
    total : uint64
        The sum of the sizes once they are scanned, else 0.
    room : uint64
        Maximum of the sum.
    """

    rows: DeviceArray
    sizes: DeviceArray
    total: np.uint64
    room: np.uint64


@gpu_kernel(costs=Costs, chosen=Chosen)
def place_list(node, nodes, boxes, tree_ids, places, ids, costs, chosen):
    """Copy a leaf's list to its range of `ids`."""
    axis, count = split_at(nodes, node)
    if axis != _LEAF:
        return
    first = np.uint64(load(np.uint32, nodes + node * NODE_BYTES))
    to = ids + np.uint64(load(np.uint32, places + node * WORD)) * WORD
    for k in range(count):
        store(to + k * WORD, load(np.int32, tree_ids + (first + k) * WORD))
    choose_leaf(node, boxes, costs, chosen, to, count)


@gpu_kernel(costs=Costs, chosen=Chosen, budget=ListBudget)
def weigh(i, first, nodes, boxes, costs, chosen, budget):
    """Turn node first + i into a leaf if that pays off; its children have been weighed.

    Once the sizes of new lists are scanned, a list is made only if it and those of later rows fit.
    """
    node = first + i
    axis, _ = split_at(nodes, node)
    if axis == _LEAF:
        return
    at = budget.sizes + np.uint64(load(np.uint32, budget.rows + node * WORD)) * BYTES_64
    free = _ALL
    if budget.total > ZERO_U64 and budget.total - load(np.uint64, at) > budget.room:
        free = ZERO_U64
    pending, union = scratch(PENDING_BYTES), scratch(UNION_BYTES)
    size = weigh_split(node, nodes, boxes, costs, chosen, free, pending, union)
    if budget.total == ZERO_U64:
        store(at, size)


@gpu_kernel(chosen=Chosen)
def cut(node, nodes, chosen):
    """Turn a split into a leaf if that was chosen."""
    axis, _ = split_at(nodes, node)
    if axis != _LEAF and load(np.uint32, chosen.leaf_counts + node * WORD) == np.uint32(1):
        size = np.uint64(load(np.uint32, chosen.sizes + node * WORD))
        store(nodes + node * NODE_BYTES + WORD, np.uint32(size << TWO_U64 | _LEAF))


def prune(gpu: Gpu, tree: GrownTree, numbers: Numbers, costs: Costs) -> Lists:
    """Turn splits that did not pay off into leaves.

    Parameters
    ----------
    gpu : Gpu
    tree : GrownTree
        Its nodes are modified; those below a new leaf remain.
    numbers : Numbers
        Of this tree.
    costs : Costs
        Those with which it was grown.

    Returns
    -------
    Lists
        Lists of joined leaves are unused.

    Raises
    ------
    CudaError
        If device memory runs out.
    """
    count = len(tree.nodes)
    (room,) = (int(one) for one in numbers.rooms.part(0, 1).host())
    ids = gpu.empty("lists of sectors", room, np.int32)
    leaf_counts, sizes = (gpu.empty(name, count, np.uint32) for name in ("leaves", "sizes"))
    lists = gpu.empty("lists", count, np.uint64)
    prices = gpu.empty("prices", count, np.float64)
    chosen = Chosen(*(one.address for one in (leaf_counts, lists, sizes, prices)))
    used = gpu.zeros("sizes of new lists", count + 1, np.uint64)
    cells, decision = (tree.nodes, tree.boxes), (Costs(*map(float, costs)), chosen)

    def weigh_all(total: int) -> None:
        places = tree.ids, numbers.places, ids
        place_list.launch(gpu, count, (*cells, *places, *decision))
        budget = ListBudget(numbers.rows, used, np.uint64(total), np.uint64(room))
        tree.launch_by_level(gpu, (weigh, (*cells, *decision, budget)), upward=True)

    weigh_all(0)
    total = scan_in_place(gpu, used)
    if total > room:
        weigh_all(total)
    cut.launch(gpu, count, (tree.nodes, chosen))
    return Lists(ids, lists, sizes)
