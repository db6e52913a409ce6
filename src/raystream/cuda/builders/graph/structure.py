"""DeviceGraph: a sector graph built on a device and kept in its memory."""

from __future__ import annotations

import time
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.triangles import Triangles
from raystream.cuda.builders.device_resident import RebuiltOnDevice, finish
from raystream.cuda.builders.graph import sectors
from raystream.cuda.builders.graph.linker import link_sectors
from raystream.cuda.builders.graph.pruning import prune
from raystream.cuda.builders.graph.sectors import Ordered, number_sectors, order_sectors
from raystream.cuda.builders.kdtree.blocks import FILL_BLOCK
from raystream.cuda.builders.kdtree.grow import GrownTree, grow_tree
from raystream.cuda.builders.kdtree.numbering import number_nodes
from raystream.cuda.structures import Resident
from raystream.jit.cuda import DeviceArray, Gpu
from raystream.kernels.leaf_block import BLOCK_FLOATS
from raystream.structures.graph.bins import bin_corners, choose_bin_counts
from raystream.structures.graph.build import graph_box, tree_settings_of
from raystream.structures.graph.layout import NODE_WORDS, SECTOR_ROWS, VOID, GraphArrays
from raystream.structures.graph.options import Graph
from raystream.structures.graph.structure import GraphStructure, addresses_of


class _Built(NamedTuple):
    """A graph on a device; see `GraphArrays`. Open sides are at infinity."""

    rows: DeviceArray
    sector_count: int
    blocks: DeviceArray
    bins: DeviceArray


class DeviceGraph(RebuiltOnDevice, GraphStructure):
    """A graph in device memory, copied to the host when first needed there.

    Parameters
    ----------
    triangles : Triangles
    gpu : Gpu
    built : _Built
    options : Graph
    started : float
        When the build began, by `time.perf_counter`.
    """

    _host_names = ("graph", "blocks", "_rows", "view", "arrays")

    def __init__(
        self,
        triangles: Triangles,
        gpu: Gpu,
        built: _Built,
        options: Graph,
        started: float,
    ) -> None:
        self.triangles, self.gpu, self.options = triangles, gpu, options
        self._built = built
        arrays = built.rows, built.blocks, built.bins
        addresses = [one.address for one in arrays]
        self.resident = Resident(addresses_of(triangles, built.bins.shape, *addresses), arrays)
        byte_count = sum(one.nbytes for one in arrays)
        self.report = finish(gpu, byte_count, started)

    @cached_property
    def _on_host(self) -> GraphStructure:
        """The same graph with its arrays in host memory."""
        made, built = GraphStructure.__new__(GraphStructure), self._built
        rows = built.rows.host()
        _close_sides(rows[: SECTOR_ROWS * built.sector_count], graph_box(self.triangles))
        # A block's prim_ids are its last four words.
        prim_ids = np.ascontiguousarray(built.blocks.host()[:, -4:]).view(np.int32)
        graph = GraphArrays(rows, built.sector_count, prim_ids, built.bins.host())
        made._set(self.triangles, graph, self.options, 0.0)
        return made


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
    corners = gpu.upload("corners", np.ascontiguousarray(triangles.corners))
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
    prim_ids = gpu.empty("triangles of blocks", (block_count, 4), np.int32)
    given = ordered.leaves, tree.boxes, lists.lists, lists.sizes, firsts, rows, prim_ids
    addresses = tuple(one.address for one in given)
    sectors.write_sector.launch(gpu, sector_count, addresses)
    linked.write(gpu, rows)
    bins = _fill_bins(gpu, triangles, tree, ordered)
    blocks = gpu.empty("blocks", (block_count, BLOCK_FLOATS), np.float32)
    of_blocks = prim_ids.address, corners.address, blocks.address
    FILL_BLOCK.launch(gpu, block_count, of_blocks)
    return DeviceGraph(triangles, gpu, _Built(rows, sector_count, blocks, bins), options, started)


def _fill_bins(gpu: Gpu, triangles: Triangles, tree: GrownTree, ordered: Ordered) -> DeviceArray:
    """Launch the search for the sectors at the bins' low corners."""
    box = graph_box(triangles)
    counts = choose_bin_counts(len(ordered.leaves), box)
    bins = gpu.empty("bins", counts, np.uint32)
    places = [gpu.upload("corners of bins", one) for one in bin_corners(box, counts)]
    of_places = tuple(one.address for one in places)
    of_tree = tree.nodes.address, ordered.sectors.address
    _, y_count, z_count = map(np.uint64, counts)
    given = *of_tree, *of_places, y_count, z_count, bins.address
    sectors.fill_bin.launch(gpu, bins.size, given)
    return bins
