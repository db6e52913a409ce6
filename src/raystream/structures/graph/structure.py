"""GraphStructure: the built graph of sectors."""

from __future__ import annotations

import time
from collections.abc import Mapping
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.atomic_write import atomic_write
from raystream.core.query import Kind, Query
from raystream.core.rays import RayBatch
from raystream.core.triangles import Triangles
from raystream.jit.threads import Progress
from raystream.kernels.aligned import aligned_array
from raystream.kernels.hits import Sink
from raystream.kernels.leaf_block import filled_blocks
from raystream.kernels.local_frame import LocalRays
from raystream.structures.base import BuildReport, Structure
from raystream.structures.graph.build import build_graph, graph_box
from raystream.structures.graph.check import check_graph
from raystream.structures.graph.layout import SECTOR_ROWS, VOID, GraphArrays
from raystream.structures.graph.locate import StartSectors, find_sectors
from raystream.structures.graph.options import Graph
from raystream.structures.graph.statistics import statistics
from raystream.structures.graph.steps import GraphAddresses
from raystream.structures.graph.text_format import dump_graph
from raystream.structures.graph.traversal import STACK_BYTES, traverse
from raystream.structures.saved import solid_mask


class GraphStructure(Structure):
    """A graph of sectors, built; see `Graph`.

    Parameters
    ----------
    triangles : Triangles
    options : Graph
    progress : callable, optional
        Called with (triangles placed, triangles) while building.
    """

    traverse = staticmethod(traverse)
    stack_bytes = STACK_BYTES
    options: Graph

    def __init__(
        self, triangles: Triangles, options: Graph, *, progress: Progress | None = None
    ) -> None:
        started = time.perf_counter()
        self._set(triangles, build_graph(triangles, options, progress), options, started)

    def _set(
        self, triangles: Triangles, graph: GraphArrays, options: Graph, started: float
    ) -> None:
        self.triangles = triangles
        self.graph = graph
        self.options = options
        self.blocks = filled_blocks(graph.prim_ids, triangles.corners)
        # A sector is a cache line.
        self._rows = aligned_array(len(graph.rows), 4).view(np.uint32)
        self._rows[:] = graph.rows
        _open_sides(self._rows[: SECTOR_ROWS * graph.sector_count])
        self.arrays = {"rows": self._rows, "blocks": self.blocks, "bins": graph.bins}
        self.view = self._make_addresses()
        arrays = (self._rows, graph.prim_ids, graph.bins, self.blocks)
        seconds = time.perf_counter() - started
        self.report = BuildReport(seconds, sum(array.nbytes for array in arrays))

    def _make_addresses(self) -> GraphAddresses:
        rows = np.uint64(self._rows.ctypes.data if len(self._rows) else 0)
        blocks, bins = np.uint64(self.blocks.ctypes.data), np.uint64(self.graph.bins.ctypes.data)
        return addresses_of(self.triangles, self.graph.bins.shape, rows, blocks, bins)

    @property
    def sector_count(self) -> int:
        """The number of sectors."""
        return self.graph.sector_count

    @property
    def rows(self) -> NDArray[np.uint32]:
        """The graph's rows as kernels read them: planes without a sector behind are at infinity."""
        return self._rows

    def view_for(self, query: Query, rays: RayBatch, sink: Sink) -> GraphAddresses:
        """The view for rays whose start is known, and whose hits keep their sectors."""
        starts = ends = np.uint64(0)
        if rays.near is not None and query.kind in (Kind.FIRST_HIT, Kind.ANY_HIT):
            starts = np.uint64(rays.near.ctypes.data)
        if query.kind is Kind.FIRST_HIT:
            sink.sectors = np.full(len(rays), -1, np.int32)
            ends = np.uint64(sink.sectors.ctypes.data)
        return self.view._replace(starts=starts, ends=ends)

    def start_sectors(
        self,
        rays: LocalRays,
        t: NDArray[np.float32] | None = None,
        near: NDArray[np.int64] | None = None,
    ) -> StartSectors:
        """Find the sectors in which local rays are; see `locate.find_sectors`."""
        return find_sectors(self.view, np.float32(self.triangles.max_coordinate), rays, t, near)

    def dump(self, path: str | PathLike[str]) -> None:
        """Write the graph as text, one line per triangle, sector and link node.

        Parameters
        ----------
        path : str or path
            Replaced atomically. The format is described in `text_format`.
        """
        with atomic_write(path) as file, file.open("w", encoding="ascii", newline="\n") as text:
            dump_graph(text, self.graph, self.triangles.corners)

    def quality(self) -> dict[str, float]:
        """Counts, depth, bytes and cost; see `statistics`."""
        return statistics(self.graph, self.options)

    def saved_arrays(self) -> dict[str, NDArray[Any]]:
        """The graph."""
        return {name: np.asarray(array) for name, array in self.graph._asdict().items()}

    @classmethod
    def from_arrays(
        cls, triangles: Triangles, arrays: Mapping[str, NDArray[Any]], options: Graph
    ) -> GraphStructure:
        """Make a graph from saved arrays; see `Structure.from_arrays`."""
        started = time.perf_counter()
        graph = check_graph(arrays, triangles.bounds, solid_mask(triangles))
        structure = cls.__new__(cls)
        structure._set(triangles, graph, options, started)
        return structure


def addresses_of(
    triangles: Triangles,
    bin_counts: tuple[int, ...],
    rows: np.uint64,
    blocks: np.uint64,
    bins: np.uint64,
) -> GraphAddresses:
    """The view of a graph, given the addresses of its arrays."""
    low, high = triangles.bounds
    box = graph_box(triangles).astype(np.float64)
    sizes = box[1] - box[0]
    scales = [n / size if size > 0.0 else 0.0 for n, size in zip(bin_counts, sizes, strict=True)]
    box_of = _triple(bin_counts), _triple(box[0]), _triple(scales)
    no_rays = np.uint64(0), np.uint64(0)
    return GraphAddresses(rows, blocks, bins, *box_of, _triple(low), _triple(high), *no_rays)


def _open_sides(rows: NDArray[np.uint32]) -> None:
    """Move planes without a neighbouring sector to infinity, so that no ray passes them."""
    sectors = rows.reshape(-1, 16)
    planes, links = sectors.view(np.float32), sectors[:, 8:14]
    for axis in range(3):
        planes[links[:, 2 * axis] == VOID, axis] = -np.inf
        planes[links[:, 2 * axis + 1] == VOID, 4 + axis] = np.inf


def _triple(numbers: Any) -> tuple[np.float32, np.float32, np.float32]:
    x, y, z = numbers
    return np.float32(x), np.float32(y), np.float32(z)
