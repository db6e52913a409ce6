"""DeviceGraph: a sector graph built on a device and kept in its memory."""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray

from raystream.core.triangles import Triangles
from raystream.cuda.builders.device_resident import RebuiltOnDevice, Resident
from raystream.cuda.builders.graph import sectors
from raystream.cuda.builders.graph.linker import link_sectors
from raystream.cuda.builders.graph.pruning import prune
from raystream.cuda.builders.graph.sectors import Ordered, number_sectors, order_sectors
from raystream.cuda.builders.kdtree.blocks import empty_lists, filled_blocks, prim_ids_of
from raystream.cuda.builders.kdtree.grow import GrownTree, grow_tree
from raystream.cuda.builders.kdtree.numbering import number_nodes
from raystream.jit.cuda import DeviceArray, Gpu
from raystream.structures.graph.bins import bin_corners, choose_bin_counts
from raystream.structures.graph.build import graph_box, tree_settings_of
from raystream.structures.graph.layout import NODE_WORDS, SECTOR_ROWS, VOID, GraphArrays
from raystream.structures.graph.options import Graph
from raystream.structures.graph.structure import GraphStructure, addresses_of


class DeviceGraph(RebuiltOnDevice, GraphStructure):
    """A graph in device memory, copied to the host when first needed there.

    There open sides are at infinity.
    """

    _host_class = GraphStructure
    _host_names = ("graph", "blocks", "_rows", "view", "arrays")
    _sector_count: int

    def _host_arguments(self) -> tuple[GraphArrays]:
        given, blocks, bins = self.resident.arrays
        rows = given.host()
        _close_sides(rows[: SECTOR_ROWS * self._sector_count], graph_box(self.triangles))
        return (GraphArrays(rows, self._sector_count, prim_ids_of(blocks), bins.host()),)


def _close_sides(rows: NDArray[np.uint32], box: NDArray[np.float32]) -> None:
    """Move planes with no sector behind them back to the sides of the graph's box."""
    of_sectors = rows.reshape(-1, 4 * SECTOR_ROWS)
    planes, links = of_sectors.view(np.float32), of_sectors[:, 8:14]
    for face in range(6):
        axis, is_high = face // 2, face % 2
        planes[links[:, face] == VOID, axis + 4 * is_high] = box[is_high, axis]


def build_graph(gpu: Gpu, triangles: Triangles, options: Graph) -> GraphStructure:
    """Build a graph of sectors on a device.

    Parameters
    ----------
    gpu : Gpu
    triangles : Triangles
    options : Graph

    Returns
    -------
    GraphStructure
        Its arrays equal the CPU's bit for bit.

    Raises
    ------
    ValueError
        If an option is out of range, or the graph would be too large for its links.
    TypeError
        If an option is not a number, or not an integer where one is needed.
    CudaError
        If device memory runs out.
    """
    if len(triangles.prim_ids) == 0:
        return GraphStructure(triangles, options)
    started = time.perf_counter()
    corners = gpu.upload("corners", triangles.corners)
    settings = tree_settings_of(options, len(triangles.prim_ids))
    tree = grow_tree(gpu, triangles, corners, settings)
    numbers = number_nodes(gpu, tree, len(triangles.prim_ids))
    lists = prune(gpu, tree, numbers, settings.costs)
    ordered = order_sectors(gpu, tree, numbers)
    firsts, block_count = number_sectors(gpu, ordered, lists)
    linked = link_sectors(gpu, tree, ordered)
    sector_count = len(ordered.leaves)
    rows = gpu.empty(
        "rows", (SECTOR_ROWS * sector_count + linked.node_count, NODE_WORDS), np.uint32
    )
    prim_ids = empty_lists(gpu, block_count)
    given = ordered.leaves, tree.boxes, lists.lists, lists.sizes, firsts, rows, prim_ids
    sectors.write_sector.launch(gpu, sector_count, given)
    linked.write(gpu, rows)
    bins = _fill_bins(gpu, triangles, tree, ordered)
    arrays = rows, filled_blocks(gpu, prim_ids, corners), bins
    addresses = addresses_of(triangles, bins.shape, *(one.address for one in arrays))
    made = DeviceGraph(gpu, triangles, options, Resident(addresses, arrays), started)
    made._sector_count = sector_count
    return made


def _fill_bins(gpu: Gpu, triangles: Triangles, tree: GrownTree, ordered: Ordered) -> DeviceArray:
    """Launch the search for the sectors at the bins' low corners."""
    box = graph_box(triangles)
    counts = choose_bin_counts(len(ordered.leaves), box)
    bins = gpu.empty("bins", counts, np.uint32)
    places = [gpu.upload("corners of bins", one) for one in bin_corners(box, counts)]
    _, y_count, z_count = map(np.uint64, counts)
    given = tree.nodes, ordered.sectors, *places, y_count, z_count, bins
    sectors.fill_bin.launch(gpu, bins.size, given)
    return bins
