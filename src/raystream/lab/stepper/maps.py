"""Maps of structures: what a machine's records say, as cells, nodes and sectors in the world."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.structures import Structure
from raystream.structures.graph import Graph
from raystream.structures.graph.layout import FACES, NODE_BIT, SECTOR_ROWS, VOID
from raystream.structures.grid import Grid
from raystream.structures.kdtree import KdTree
from raystream.structures.kdtree.layout import LEAF_AXIS
from raystream.structures.kdtree.packed import LEAF_BIT
from raystream.structures.kdtree.short_stack import kept_entries

__all__ = ["GraphMap", "GridMap", "KdMap", "LocalSpot", "StructureMap", "map_of"]

#: Bytes of a block of four triangles.
_BLOCK_BYTES = 160
_LANES = 4


class LocalSpot(NamedTuple):
    """A place in a structure, and the part of a ray in it in local direction lengths."""

    number: int
    t_in: float
    t_out: float


class StructureMap(ABC):
    """Reads what a ray's records say of one structure.

    Attributes
    ----------
    boxes : ndarray of shape (M, 2, 3), float64
        Low and high corner of each cell, node or sector; world space.
    """

    boxes: NDArray[np.float64]

    @abstractmethod
    def kind(self, number: int) -> str:
        """``"cell"``, ``"split"``, ``"leaf"`` or ``"sector"``."""

    @abstractmethod
    def label(self, number: int) -> str:
        """What to call it in a sentence."""

    @abstractmethod
    def list_size(self, number: int) -> int:
        """How many triangles it lists."""

    @abstractmethod
    def spot(self, ray: Any, place: Any) -> LocalSpot:
        """Where a ray is that has something to search."""

    @abstractmethod
    def tested(self, place: Any, count: int) -> tuple[int, ...]:
        """The prim_ids of the next `count` triangles that a ray tests."""

    def stack(self, place: Any, memory: NDArray[np.uint8]) -> tuple[LocalSpot, ...]:
        """What a ray has put aside, that which is next first."""
        del place, memory
        return ()

    def way(self, origin: int, target: int, direction: NDArray[np.float64]) -> str | None:
        """How a ray went from one place to another: a face, or None if that says nothing."""
        del origin, target, direction
        return None


def map_of(structure: Structure) -> StructureMap:
    """Make the map of a structure.

    Raises
    ------
    ValueError
        If there is none.
    """
    for kind, made in ((Grid, GridMap), (KdTree, KdMap), (Graph, GraphMap)):
        if isinstance(structure, kind):
            return made(structure)  # type: ignore[arg-type]
    raise ValueError(
        f"walk: expected a tracer of a grid, kdtree or graph, got one of {structure.name!r}"
    )


def _to_world(structure: Structure, local: NDArray[np.float64]) -> NDArray[np.float64]:
    triangles = structure.triangles
    world: NDArray[np.float64] = local / triangles.scale + triangles.center
    return world


class GridMap(StructureMap):
    """Cells of a grid, and after them those of its second level."""

    def __init__(self, grid: Grid) -> None:
        self._grid = grid
        lattice, fine = grid.lattice, grid.fine
        self.counts = lattice.counts
        coarse = _cell_boxes(np.array(lattice.low), np.array(lattice.size), lattice.counts)
        parts = [coarse]
        self._first_of = {}
        first = lattice.cell_count
        for cell, counts in zip(fine.cells.tolist(), fine.counts.tolist(), strict=True):
            self._first_of[cell] = first
            low, high = coarse[cell]
            parts.append(_cell_boxes(low, (high - low) / counts, counts))
            first += len(parts[-1])
        self.boxes = _to_world(grid, np.concatenate(parts))

    def kind(self, number: int) -> str:
        """See `StructureMap.kind`."""
        del number
        return "cell"

    def label(self, number: int) -> str:
        """See `StructureMap.label`."""
        nx, ny, _ = self.counts
        if number >= self._grid.lattice.cell_count:
            return f"inner cell {number}"
        return f"cell ({number % nx}, {number // nx % ny})"

    def list_size(self, number: int) -> int:
        """See `StructureMap.list_size`."""
        count = self._grid.lattice.cell_count
        lists = self._grid.lists if number < count else self._grid.fine.lists
        row = number if number < count else number - count
        return int(lists.splits[row + 1]) - int(lists.splits[row])

    def spot(self, ray: Any, place: Any) -> LocalSpot:
        """See `StructureMap.spot`."""
        del ray
        outer, cell = int(place["outer"]), int(place["cell"])
        number = cell if outer < 0 else self._first_of[outer] + cell
        t_out = min(float(place["t_next"].min()), float(place["t_end"]))
        return LocalSpot(number, float(place["t_in"]), t_out)

    def tested(self, place: Any, count: int) -> tuple[int, ...]:
        """See `StructureMap.tested`."""
        lists = self._grid.lists if place["outer"] < 0 else self._grid.fine.lists
        row = int(place["row"])
        return tuple(lists.references[row : row + count].tolist())


def _cell_boxes(low: Any, size: Any, counts: Any) -> NDArray[np.float64]:
    """Boxes of a lattice's cells by number, of shape (C, 2, 3)."""
    k, j, i = np.indices(tuple(counts)[::-1]).reshape(3, -1)
    corner = np.stack([i, j, k], axis=1)
    return np.stack([low + corner * size, low + (corner + 1) * size], axis=1)


class _BlockMap(StructureMap):
    """What lists triangles in blocks of four."""

    _block_rows: NDArray[np.int32]
    _blocks: NDArray[np.float32]

    def tested(self, place: Any, count: int) -> tuple[int, ...]:
        """See `StructureMap.tested`."""
        row = (int(place["block"]) - self._blocks.ctypes.data) // _BLOCK_BYTES
        last = row + -(-count // _LANES)
        return tuple(self._block_rows[row:last].ravel()[:count].tolist())


class KdMap(_BlockMap):
    """Nodes of a kd-tree, by their rows in `KdArrays.nodes`.

    Attributes
    ----------
    axes, children : ndarray of shape (M,), int32
        Axis of each split, 3 for a leaf; row of its child below the plane, the other one being
        next to it, or number of a leaf's triangles.
    planes : ndarray of shape (M,), float64
        Where splits are, in world space; of no meaning for leaves.
    """

    def __init__(self, tree: KdTree) -> None:
        nodes = tree.tree.nodes
        self._block_rows, self._blocks = tree.tree.prim_ids, tree.blocks
        self._traversal = tree.options["traversal"]
        self.axes, self.children = nodes[:, 1] & 3, nodes[:, 1] >> 2
        is_leaf = self.axes == LEAF_AXIS
        # The rows of nodes by the numbers that a search has for them.
        packed = tree.options["layout"] == "foley"
        every = np.arange(len(nodes))
        self._splits = np.flatnonzero(~is_leaf) if packed else every
        self._leaves = np.flatnonzero(is_leaf) if packed else every
        local = np.ascontiguousarray(nodes).view(np.float32)[:, 0].astype(np.float64)
        boxes = np.zeros((len(nodes), 2, 3))
        if len(nodes):
            boxes[0] = tree.triangles.bounds
        for node in self._rows_of_splits():
            axis, child = self.axes[node], self.children[node]
            boxes[child : child + 2] = boxes[node]
            boxes[child, 1, axis] = boxes[child + 1, 0, axis] = local[node]
        self.boxes = _to_world(tree, boxes)
        self.planes = np.zeros(len(nodes))
        for node in self._rows_of_splits():
            self.planes[node] = self.boxes[self.children[node], 1, self.axes[node]]

    def _rows_of_splits(self) -> list[int]:
        rows: list[int] = np.flatnonzero(self.axes != LEAF_AXIS).tolist()
        return rows

    def kind(self, number: int) -> str:
        """See `StructureMap.kind`."""
        return "leaf" if self.axes[number] == LEAF_AXIS else "split"

    def label(self, number: int) -> str:
        """See `StructureMap.label`."""
        return f"{self.kind(number)} {number}"

    def list_size(self, number: int) -> int:
        """See `StructureMap.list_size`."""
        return int(self.children[number]) if self.kind(number) == "leaf" else 0

    def _row(self, node: int) -> int:
        if node >> LEAF_BIT:
            return int(self._leaves[node & ((1 << LEAF_BIT) - 1)])
        return int(self._splits[node])

    def spot(self, ray: Any, place: Any) -> LocalSpot:
        """See `StructureMap.spot`."""
        del ray
        row = self._row(int(place["node"]))
        return LocalSpot(row, float(place["t_in"]), float(place["t_out"]))

    def stack(self, place: Any, memory: NDArray[np.uint8]) -> tuple[LocalSpot, ...]:
        """See `StructureMap.stack`."""
        top = int(place["top"])
        if self._traversal == "stack":
            entries = memory[:top].view(np.uint32).reshape(-1, 2)
        elif self._traversal == "short-stack":
            entries = kept_entries(memory, top)
        else:
            return ()
        nodes, ends = entries[:, 0], entries.view(np.float32)[:, 1]
        spots = []
        # What lies on top begins where the ray is to leave the node that it is in.
        t_in = float(place["t_out"])
        for node, t_out in zip(nodes[::-1].tolist(), ends[::-1].tolist(), strict=True):
            spots.append(LocalSpot(self._row(node), t_in, t_out))
            t_in = t_out
        return tuple(spots)


class GraphMap(_BlockMap):
    """Sectors of a graph.

    Attributes
    ----------
    neighbors : list of list of list of int
        For each sector and each of its faces, in the order of `FACES`, the sectors behind it.
    """

    def __init__(self, graph: Graph) -> None:
        self._block_rows, self._blocks = graph.graph.prim_ids, graph.blocks
        count, rows = graph.graph.sector_count, graph.graph.rows
        self._row_at = int(graph.arrays.rows)
        self._nodes = rows.tolist()
        sectors = rows[: SECTOR_ROWS * count].reshape(count, 16)
        planes = np.ascontiguousarray(sectors).view(np.float32).astype(np.float64)
        self.boxes = _to_world(graph, np.stack([planes[:, 0:3], planes[:, 4:7]], axis=1))
        self._opened = np.stack([planes[:, 0:3], planes[:, 4:7]], axis=1)
        links = sectors[:, 8:14]
        self._opened[:, 0][links[:, 0::2] == VOID] = -np.inf
        self._opened[:, 1][links[:, 1::2] == VOID] = np.inf
        self._sizes = sectors[:, 7].tolist()
        self.neighbors = [[self._behind(link) for link in row] for row in links.tolist()]

    def _behind(self, link: int) -> list[int]:
        """The sectors that a link leads to."""
        found: list[int] = []
        waiting = [link]
        while waiting:
            link = waiting.pop()
            if link == VOID:
                continue
            if link & NODE_BIT:
                waiting += self._nodes[link ^ NODE_BIT][2:4]
            elif link // SECTOR_ROWS not in found:
                found.append(link // SECTOR_ROWS)
        return sorted(found)

    def kind(self, number: int) -> str:
        """See `StructureMap.kind`."""
        del number
        return "sector"

    def label(self, number: int) -> str:
        """See `StructureMap.label`."""
        return f"sector {number}"

    def list_size(self, number: int) -> int:
        """See `StructureMap.list_size`."""
        return int(self._sizes[number])

    def spot(self, ray: Any, place: Any) -> LocalSpot:
        """See `StructureMap.spot`."""
        number = (int(place["sector"]) - self._row_at) // (16 * SECTOR_ROWS)
        # A place does not keep where its sector ends: it follows from the planes, as kernels
        # find it, here to a rounding.
        t_out = float(place["t_end"])
        for axis in range(3):
            way = float(ray["direction"][axis])
            if way != 0.0:
                plane = float(self._opened[number, int(way > 0.0), axis])
                t_out = min(t_out, (plane - float(ray["origin"][axis])) / way)
        return LocalSpot(number, float(place["t_in"]), t_out)

    def way(self, origin: int, target: int, direction: NDArray[np.float64]) -> str | None:
        """See `StructureMap.way`."""
        for axis in range(3):
            face = 2 * axis + int(direction[axis] > 0.0)
            if direction[axis] != 0.0 and target in self.neighbors[origin][face]:
                return FACES[face]
        return None
