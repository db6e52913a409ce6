"""Kernels of the builders with example arguments, for compilation without a device."""

from __future__ import annotations

from typing import Any

import numpy as np

from raystream.cuda.builders import binary_tree, clusters, lists, refit, wide
from raystream.cuda.builders.graph.precompile import graph_kernels
from raystream.cuda.bvh import pairs
from raystream.jit.constants import NULL
from raystream.jit.cuda import RangeKernel
from raystream.jit.cuda.block_kernel import BlockKernel
from raystream.jit.cuda.radix_sort import sort_kernels
from raystream.jit.cuda.scan import scan_kernels
from raystream.structures.grid.lattice import Lattice


def build_kernels() -> dict[str, tuple[RangeKernel, tuple[Any, ...]]]:
    """Kernels by name, with placeholder arguments of the right types."""
    one = (1.0, 1.0, 1.0)
    lattice = lists.as_numbers(Lattice(one, one, one, (1, 1, 1), 1.0))
    nodes = binary_tree.NodesAt(NULL, NULL, NULL, np.int64(1))
    number = np.float64(0.0)
    frame = binary_tree.KeyFrame((number, number, number), number)
    wide_at = pairs.WideAt(NULL, NULL, NULL)
    listed = clusters.ClusterList(NULL, NULL)

    def at(count: int) -> tuple[np.uint64, ...]:
        return (NULL,) * count

    chosen = [
        (lists.count_cells, (lattice, *at(3))),
        (lists.fill_pairs, (lattice, *at(5))),
        (lists.find_split, at(3)),
        (binary_tree.make_key, (*at(2), frame, *at(2))),
        (binary_tree.make_leaf, (*at(2), nodes)),
        (clusters.begin_cluster, (nodes, NULL)),
        (clusters.find_match, (listed, NULL, False, NULL)),
        (clusters.count_places, (listed, *at(2))),
        (clusters.merge, (listed, *at(3), nodes, NULL, listed)),
        (wide.count_lanes, (NULL, nodes, *at(2))),
        (wide.give_rows, (*at(3), nodes, *at(4))),
        (wide.write_node, (nodes, *at(6))),
        (pairs.COUNT, (wide_at, None)),
        (pairs.WRITE, (wide_at, (False, *at(2)))),
        (refit.move_leaves, at(4)),
        (refit.move_nodes, at(2)),
        (refit.add_costs, at(4)),
        *graph_kernels(),
    ]
    return {kernel.name.strip("_"): (kernel, arguments) for kernel, arguments in chosen}


def block_kernels() -> dict[str, BlockKernel]:
    """Kernels of scans and sorts, by name and bit width."""
    made = {}
    for dtype in ("uint32", "uint64"):
        steps = {**scan_kernels(dtype)._asdict(), **sort_kernels(dtype)._asdict()}
        made.update({f"{name}_{dtype[4:]}": kernel for name, kernel in steps.items()})
    return made
