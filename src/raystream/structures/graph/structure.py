"""Graph: the graph of sectors as a structure."""

from __future__ import annotations

import operator
import time
from collections.abc import Mapping
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.triangles import Triangles
from raystream.core.whole_file import replacing
from raystream.jit.threads import Progress
from raystream.kernels.aligned import aligned_array
from raystream.kernels.leaf_block import filled_blocks
from raystream.kernels.local_frame import LocalRays
from raystream.kernels.queries import ray_queries
from raystream.structures.base import BuildReport, Structure
from raystream.structures.graph.build import Method, build_graph, graph_box
from raystream.structures.graph.check import check_graph
from raystream.structures.graph.graphlog import dump_graph
from raystream.structures.graph.layout import SECTOR_ROWS, VOID, GraphArrays
from raystream.structures.graph.start import StartSectors, find_sectors
from raystream.structures.graph.statistics import statistics
from raystream.structures.graph.steps import GraphAddresses
from raystream.structures.graph.traversal import STACK_BYTES, traverse
from raystream.structures.kdtree.layout import MAX_DEPTH, usual_depth

__all__ = ["Graph", "addresses_of", "chosen_options", "method_of"]


class Graph(Structure):
    """A graph of sectors (Rayforce 2013): boxes that are linked through their faces.

    Rays walk from sector to sector, without a stack, and meet triangles in the order of the ray.
    How sectors are made and linked is our reading of Gribble and Naveros, "GPU Ray Tracing with
    Rayforce", SIGGRAPH 2013 posters; see docs/decisions.

    Parameters
    ----------
    triangles : Triangles
    crossing_cost, intersection_cost, link_cost : float
        Prices of a step into a sector, of a triangle test, and of a plane between the sectors
        behind a face, by which the graph is built; only their ratios matter. The defaults are
        measured: what is expensive about a sector or a plane is that it is far in memory.
    max_depth : int, optional
        Most splits that a sector is the result of, up to 64. Without it 8 + 1.3 log2 of the
        number of triangles, but at most 64.
    max_leaf_size : int
        Sectors with so many triangles or fewer are not split, 1 to 1024.
    progress : callable, optional
        Called with (triangles placed, triangles) while building.

    Raises
    ------
    ValueError
        If an option is out of range.
    TypeError
        If a number is no number, or no integer where one is needed.
    """

    name = "graph"
    queries = ray_queries(traverse, STACK_BYTES)

    def __init__(
        self,
        triangles: Triangles,
        *,
        crossing_cost: float = 24.0,
        intersection_cost: float = 1.0,
        link_cost: float = 16.0,
        max_depth: int | None = None,
        max_leaf_size: int = 4,
        progress: Progress | None = None,
    ) -> None:
        started = time.perf_counter()
        options = chosen_options(
            crossing_cost, intersection_cost, link_cost, max_depth, max_leaf_size
        )
        method = method_of(options, len(triangles.prim_ids))
        self._set(triangles, build_graph(triangles, method, progress), options, started)

    def _set(
        self, triangles: Triangles, graph: GraphArrays, options: Mapping[str, Any], started: float
    ) -> None:
        self.triangles = triangles
        self.graph = graph
        self.options = options
        self.blocks = filled_blocks(graph.prim_ids, triangles.corners)
        # A sector is a cache line.
        self._rows = aligned_array(len(graph.rows), 4).view(np.uint32)
        self._rows[:] = graph.rows
        _open_sides(self._rows[: SECTOR_ROWS * graph.sector_count])
        self._addresses = self._make_addresses()
        arrays = (self._rows, graph.prim_ids, graph.bins, self.blocks)
        seconds = time.perf_counter() - started
        self.report = BuildReport(seconds, sum(array.nbytes for array in arrays))

    def _make_addresses(self) -> GraphAddresses:
        rows = np.uint64(self._rows.ctypes.data if len(self._rows) else 0)
        blocks, bins = np.uint64(self.blocks.ctypes.data), np.uint64(self.graph.bins.ctypes.data)
        return addresses_of(self.triangles, self.graph.bins.shape, rows, blocks, bins)

    @property
    def rows(self) -> NDArray[np.uint32]:
        """The graph's rows as rays take them: planes without a sector behind are at infinity."""
        return self._rows

    @property
    def arrays(self) -> GraphAddresses:
        """Where the graph is; the structure keeps it."""
        return self._addresses

    @property
    def memory(self) -> dict[str, NDArray[Any]]:
        """Sectors and links, leaf blocks, and bins."""
        return {"rows": self._rows, "blocks": self.blocks, "bins": self.graph.bins}

    def start_sectors(
        self,
        rays: LocalRays,
        t: NDArray[np.float32] | None = None,
        near: NDArray[np.int64] | None = None,
    ) -> StartSectors:
        """Find the sectors in which local rays are; see `start.find_sectors`."""
        return find_sectors(self.arrays, np.float32(self.triangles.extreme), rays, t, near)

    def dump(self, path: str | PathLike[str]) -> None:
        """Write the graph as text, a line for each triangle, sector and link node.

        Parameters
        ----------
        path : str or path
            Replaced as a whole when writing succeeded. `graphlog.load_graph` reads it.
        """
        with replacing(path) as file, file.open("w", encoding="ascii", newline="\n") as text:
            dump_graph(text, self.graph, self.triangles.corners)

    def quality(self) -> dict[str, float]:
        """Counts, depth, bytes and cost; see `statistics`."""
        return statistics(self.graph, method_of(self.options, len(self.triangles.prim_ids)))

    def saved_arrays(self) -> dict[str, NDArray[Any]]:
        """The graph, and how it was built."""
        options = self.options
        numbers = [
            options["crossing_cost"],
            options["intersection_cost"],
            options["link_cost"],
            -1 if options["max_depth"] is None else options["max_depth"],
            options["max_leaf_size"],
        ]
        arrays = {name: np.asarray(array) for name, array in self.graph._asdict().items()}
        return {**arrays, "options": np.array(numbers, np.float64)}

    @classmethod
    def from_arrays(cls, triangles: Triangles, arrays: Mapping[str, NDArray[Any]]) -> Graph:
        """Make a graph of saved arrays; see `Structure.from_arrays`."""
        started = time.perf_counter()
        options = _saved_options(arrays)
        graph = check_graph(arrays, triangles.bounds, triangles.prim_ids, len(triangles))
        structure = cls.__new__(cls)
        structure._set(triangles, graph, options, started)
        return structure


def chosen_options(
    crossing_cost: float,
    intersection_cost: float,
    link_cost: float,
    max_depth: int | None,
    max_leaf_size: int,
) -> dict[str, Any]:
    """The build options of a graph, checked; see `Graph`."""
    options = {
        "crossing_cost": float(crossing_cost),
        "intersection_cost": float(intersection_cost),
        "link_cost": float(link_cost),
        "max_depth": None if max_depth is None else operator.index(max_depth),
        "max_leaf_size": operator.index(max_leaf_size),
    }
    _check(options)
    return options


def addresses_of(
    triangles: Triangles,
    bin_counts: tuple[int, ...],
    rows: np.uint64,
    blocks: np.uint64,
    bins: np.uint64,
) -> GraphAddresses:
    """What the traversal is given of a graph whose arrays are at some addresses."""
    low, high = triangles.bounds
    box = graph_box(triangles).astype(np.float64)
    sizes = box[1] - box[0]
    scales = [n / size if size > 0.0 else 0.0 for n, size in zip(bin_counts, sizes, strict=True)]
    box_of = _triple(bin_counts), _triple(box[0]), _triple(scales)
    return GraphAddresses(rows, blocks, bins, *box_of, _triple(low), _triple(high))


def _open_sides(rows: NDArray[np.uint32]) -> None:
    """Move the planes of sectors that have no neighbour to infinity: no ray passes them."""
    sectors = rows.reshape(-1, 16)
    planes, links = sectors.view(np.float32), sectors[:, 8:14]
    for axis in range(3):
        planes[links[:, 2 * axis] == VOID, axis] = -np.inf
        planes[links[:, 2 * axis + 1] == VOID, 4 + axis] = np.inf


def _triple(numbers: Any) -> tuple[np.float32, np.float32, np.float32]:
    x, y, z = numbers
    return np.float32(x), np.float32(y), np.float32(z)


def method_of(options: Mapping[str, Any], triangle_count: int) -> Method:
    """How to build a graph with such options."""
    max_depth = options["max_depth"]
    if max_depth is None:
        max_depth = usual_depth(triangle_count)
    return Method(
        crossing_cost=options["crossing_cost"],
        intersection_cost=options["intersection_cost"],
        link_cost=options["link_cost"],
        max_depth=max_depth,
        max_leaf_size=options["max_leaf_size"],
    )


def _check(options: Mapping[str, Any]) -> None:
    """Raise ValueError for the first option that is out of range."""
    for name in ("crossing_cost", "intersection_cost"):
        if not 1e-6 <= options[name] <= 1e6:
            raise ValueError(f"{name}: expected 1e-6 to 1e6, got {options[name]}")
    if not 0.0 <= options["link_cost"] <= 1e6:
        raise ValueError(f"link_cost: expected 0 to 1e6, got {options['link_cost']}")
    depth, size = options["max_depth"], options["max_leaf_size"]
    if depth is not None and not 0 <= depth <= MAX_DEPTH:
        raise ValueError(f"max_depth: expected 0 to {MAX_DEPTH}, got {depth}")
    if not 1 <= size <= 1024:
        raise ValueError(f"max_leaf_size: expected 1 to 1024, got {size}")


def _saved_options(arrays: Mapping[str, NDArray[Any]]) -> dict[str, Any]:
    """Build options from a file, for when the graph is built anew."""
    numbers = arrays.get("options")
    if numbers is None or numbers.shape != (5,) or numbers.dtype != np.float64:
        raise ValueError("array 'options' is missing or of another kind")
    depth, size = numbers[3:].tolist()
    if not (depth.is_integer() and size.is_integer()):
        raise ValueError("its build options are out of range")
    options = {
        "crossing_cost": float(numbers[0]),
        "intersection_cost": float(numbers[1]),
        "link_cost": float(numbers[2]),
        "max_depth": None if depth == -1 else int(depth),
        "max_leaf_size": int(size),
    }
    _check(options)
    return options
