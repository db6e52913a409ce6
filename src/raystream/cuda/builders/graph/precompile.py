"""Kernels of the graph builder with example arguments, for compilation without a device."""

from __future__ import annotations

from typing import Any

import numpy as np

from raystream.cuda.builders.graph import link_kernels, pruning, sectors, sharing
from raystream.cuda.builders.kdtree import numbering, partition, planes, write_tree
from raystream.cuda.builders.kdtree.blocks import FILL_BLOCK
from raystream.jit.constants import NULL
from raystream.jit.cuda import RangeKernel
from raystream.structures.graph.face_subtrees import RopeTree
from raystream.structures.graph.prune import Chosen
from raystream.structures.kdtree.split import Costs

_COSTS = Costs(*(np.float64(0.0),) * 4)


def graph_kernels() -> list[tuple[RangeKernel, tuple[Any, ...]]]:
    """Kernels, with placeholder arguments of the right types."""
    return [*_of_trees(), *_of_sectors(), *_of_links()]


def _at(count: int) -> tuple[np.uint64, ...]:
    return (NULL,) * count


def _of_trees() -> list[tuple[RangeKernel, tuple[Any, ...]]]:
    refs, level, tried = planes.References(*_at(3)), planes.Level(*_at(4)), planes.Tried(*_at(4))
    choices, counts, made = (
        planes.Choices(*_at(4)),
        partition.Counts(*_at(2)),
        partition.Made(*_at(3)),
    )
    numbers = numbering.Numbering(*_at(5))
    grown = partition.GrownTriangles(NULL, np.float64(0.0), np.int64(0))
    return [
        (planes.try_planes, (refs, level, _COSTS, NULL, tried)),
        (planes.choose_plane, (level, _COSTS, NULL, tried, choices)),
        (partition.make_reference, (*_at(2), np.float32(0.0), refs)),
        (partition.count_cut, (refs, choices)),
        (partition.confirm, (level, choices, counts)),
        (partition.count_parts, (refs, choices, grown, counts)),
        (partition.make_cells, (level, choices, counts, made, *_at(2), level)),
        (
            partition.place_parts,
            (refs, level, choices, grown, counts, made, NULL, refs),
        ),
        (numbering.count_below, (*_at(2), numbers)),
        (numbering.mark_large, (*_at(3), numbers, *_at(2))),
        (numbering.begin_rows, (*_at(6), numbers)),
        (numbering.number_children, (*_at(4), numbers)),
        (write_tree.write_tree_node, (*_at(2), numbers, *_at(2))),
        (write_tree.extend_children, (*_at(2), numbers, NULL)),
    ]


def _of_sectors() -> list[tuple[RangeKernel, tuple[Any, ...]]]:
    chosen = Chosen(*_at(4))
    return [
        (pruning.place_list, (*_at(5), _COSTS, chosen)),
        (pruning.weigh, (*_at(3), _COSTS, chosen, pruning.ListBudget(*_at(4)))),
        (pruning.cut, (NULL, chosen)),
        (sectors.place_cells, _at(7)),
        (sectors.place_nodes, _at(6)),
        (sectors.mark_leaf, _at(3)),
        (sectors.list_leaf, _at(6)),
        (sectors.number_sector, _at(4)),
        (sectors.write_sector, _at(7)),
        (sectors.fill_bin, _at(8)),
        (FILL_BLOCK, _at(3)),
    ]


def _of_links() -> list[tuple[RangeKernel, tuple[Any, ...]]]:
    tree, raw, table = RopeTree(*_at(4)), link_kernels.Raw(*_at(5)), sharing.Table(*_at(6))
    order = link_kernels.CandidateOrder(*_at(3))
    return [
        (link_kernels.find_node_axes, _at(3)),
        (link_kernels.count_raw, (NULL, tree, *_at(2))),
        (link_kernels.spread_covered, _at(3)),
        (link_kernels.mark_covered, _at(5)),
        (link_kernels.put_covered, (*_at(4), order, NULL, table)),
        (link_kernels.share_covered, (*_at(3), order, NULL, table)),
        (link_kernels.fill_raw, (NULL, tree, *_at(3), raw, NULL)),
        (link_kernels.put_raw, (*_at(2), raw, table)),
        (link_kernels.share_raw, (NULL, raw, table)),
        (link_kernels.place_links, (NULL, raw, table, NULL)),
        (sharing.mark_first, (table,)),
        (sharing.write_link_node, (table, NULL)),
    ]
