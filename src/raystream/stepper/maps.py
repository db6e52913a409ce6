"""Interpret a machine's records of grids, kd-trees and graphs as cells, nodes and sectors."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.stepper.bvh_map import BvhMap
from raystream.stepper.structure_map import BlockMap, LocalSpot, Records, StructureMap, to_world
from raystream.structures import Structure
from raystream.structures.bvh.structure import BvhStructure
from raystream.structures.graph.layout import FACES, NODE_BIT, SECTOR_ROWS, VOID
from raystream.structures.graph.structure import GraphStructure
from raystream.structures.grid.structure import GridStructure
from raystream.structures.kdtree.foley_layout import LEAF_BIT
from raystream.structures.kdtree.layout import LEAF_AXIS
from raystream.structures.kdtree.structure import KdTreeStructure
from raystream.structures.kdtree.traversals.short_stack import stack_entries


def map_of(structure: Structure) -> StructureMap:
    """Make the map of a structure.

    Raises
    ------
    ValueError
        If the structure has none.
    """
    kinds = (
        (GridStructure, GridMap),
        (KdTreeStructure, KdMap),
        (GraphStructure, GraphMap),
        (BvhStructure, BvhMap),
    )
    for kind, made in kinds:
        if isinstance(structure, kind):
            return made(structure)  # type: ignore[arg-type]
    raise ValueError(
        f"walk: expected a tracer of a grid, kdtree, graph or bvh, got one of {structure.name!r}"
    )


class GridMap(StructureMap):
    """Cells of a grid, followed by those of its second level."""

    def __init__(self, grid: GridStructure) -> None:
        self._grid = grid
        lattice, fine = grid.lattice, grid.fine
        # The first cell of each fine lattice.
        sizes = np.prod(fine.counts, axis=1, dtype=np.int64)
        self._firsts = lattice.cell_count + np.cumsum(sizes) - sizes
        self._row_of = {cell: row for row, cell in enumerate(fine.cells.tolist())}

    def box(self, number: int) -> NDArray[np.float64]:
        """See `StructureMap.box`."""
        lattice, fine = self._grid.lattice, self._grid.fine
        row = int(np.searchsorted(self._firsts, number, "right")) - 1
        cell = number if row < 0 else int(fine.cells[row])
        box = _cell_box(np.array(lattice.low), np.array(lattice.size), lattice.counts, cell)
        if row >= 0:
            counts, inner = fine.counts[row], number - int(self._firsts[row])
            box = _cell_box(box[0], (box[1] - box[0]) / counts, counts, inner)
        return to_world(self._grid, box)

    def kind(self, number: int) -> str:
        """See `StructureMap.kind`."""
        del number
        return "cell"

    def spot(self, records: Records) -> LocalSpot:
        """See `StructureMap.spot`."""
        place = records.place
        outer, cell = int(place["outer"]), int(place["cell"])
        number = cell if outer < 0 else int(self._firsts[self._row_of[outer]]) + cell
        t_out = min(float(place["t_next"].min()), float(place["t_end"]))
        return LocalSpot(number, float(place["t_in"]), t_out)

    def tested(self, place: Any, count: int) -> tuple[int, ...]:
        """See `StructureMap.tested`."""
        lists = self._grid.lists if place["outer"] < 0 else self._grid.fine.lists
        row = int(place["row"])
        return tuple(lists.references[row : row + count].tolist())


def _cell_box(low: Any, size: Any, counts: Any, number: int) -> NDArray[np.float64]:
    """The box of one of a lattice's cells, of shape (2, 3)."""
    nx, ny, _ = (int(count) for count in counts)
    corner = np.array([number % nx, number // nx % ny, number // (nx * ny)])
    return np.stack([low + corner * size, low + (corner + 1) * size])


class KdMap(BlockMap):
    """Nodes of a kd-tree, by their rows in `KdArrays.nodes`.

    Attributes
    ----------
    axes, children : ndarray of shape (M,), int32
        Axis of each split, 3 for a leaf; row of its lower child, followed by the upper one, or
        number of a leaf's triangles.
    """

    def __init__(self, tree: KdTreeStructure) -> None:
        nodes = tree.tree.nodes
        self._block_rows, self._blocks = tree.tree.prim_ids, tree.blocks
        self._traversal = tree.options.traversal
        self.axes, self.children = nodes[:, 1] & 3, nodes[:, 1] >> 2
        is_leaf = self.axes == LEAF_AXIS
        # Maps node numbers of a search to rows.
        packed = tree.options.layout == "foley"
        every = np.arange(len(nodes))
        self._splits = np.flatnonzero(~is_leaf) if packed else every
        self._leaves = np.flatnonzero(is_leaf) if packed else every
        self._planes = np.ascontiguousarray(nodes).view(np.float32)[:, 0].astype(np.float64)
        self._tree = tree
        splits = np.flatnonzero(~is_leaf)
        self._parents = np.full(len(nodes), -1)
        self._parents[self.children[splits]] = self._parents[self.children[splits] + 1] = splits

    def box(self, number: int) -> NDArray[np.float64]:
        """See `StructureMap.box`."""
        box: NDArray[np.float64] = self._tree.triangles.bounds.astype(np.float64)
        is_cut = np.zeros((2, 3), np.bool_)
        while number != 0:  # upward: the first plane of each side counts
            parent = int(self._parents[number])
            axis, side = int(self.axes[parent]), int(number == self.children[parent])
            if not is_cut[side, axis]:
                box[side, axis], is_cut[side, axis] = self._planes[parent], True
            number = parent
        return to_world(self._tree, box)

    def kind(self, number: int) -> str:
        """See `StructureMap.kind`."""
        return "leaf" if self.axes[number] == LEAF_AXIS else "split"

    def _row(self, node: int) -> int:
        if node >> LEAF_BIT:
            return int(self._leaves[node & ((1 << LEAF_BIT) - 1)])
        return int(self._splits[node])

    def spot(self, records: Records) -> LocalSpot:
        """See `StructureMap.spot`."""
        place = records.place
        row = self._row(int(place["node"]))
        return LocalSpot(row, float(place["t_in"]), float(place["t_out"]))

    def stack(self, records: Records) -> tuple[LocalSpot, ...]:
        """See `StructureMap.stack`."""
        place, memory = records.place, records.memory
        top = int(place["top"])
        if self._traversal == "stack":
            entries = memory[:top].view(np.uint32).reshape(-1, 2)
        elif self._traversal == "short-stack":
            entries = stack_entries(memory, top)
        else:
            return ()
        nodes, ends = entries[:, 0], entries.view(np.float32)[:, 1]
        spots = []
        # The top entry begins where the ray leaves its current node.
        t_in = float(place["t_out"])
        for node, t_out in zip(nodes[::-1].tolist(), ends[::-1].tolist(), strict=True):
            spots.append(LocalSpot(self._row(node), t_in, t_out))
            t_in = t_out
        return tuple(spots)


class GraphMap(BlockMap):
    """Sectors of a graph."""

    def __init__(self, graph: GraphStructure) -> None:
        self._block_rows, self._blocks = graph.graph.prim_ids, graph.blocks
        count, rows = graph.graph.sector_count, graph.graph.rows
        self._row_at = int(graph.view.rows)
        self._nodes = rows
        sectors = rows[: SECTOR_ROWS * count].reshape(count, 16)
        planes = np.ascontiguousarray(sectors).view(np.float32).astype(np.float64)
        self.boxes = to_world(graph, np.stack([planes[:, 0:3], planes[:, 4:7]], axis=1))
        self._opened = np.stack([planes[:, 0:3], planes[:, 4:7]], axis=1)
        links = sectors[:, 8:14]
        self._opened[:, 0][links[:, 0::2] == VOID] = -np.inf
        self._opened[:, 1][links[:, 1::2] == VOID] = np.inf
        self._links = links

    def box(self, number: int) -> NDArray[np.float64]:
        """See `StructureMap.box`."""
        return self.boxes[number]

    def _behind(self, link: int) -> list[int]:
        """The sectors that a link leads to."""
        found: list[int] = []
        waiting = [link]
        while waiting:
            link = waiting.pop()
            if link == VOID:
                continue
            if link & NODE_BIT:
                waiting += self._nodes[link ^ NODE_BIT][2:4].tolist()
            elif link // SECTOR_ROWS not in found:
                found.append(link // SECTOR_ROWS)
        return sorted(found)

    def kind(self, number: int) -> str:
        """See `StructureMap.kind`."""
        del number
        return "sector"

    def spot(self, records: Records) -> LocalSpot:
        """See `StructureMap.spot`."""
        ray, place = records.ray, records.place
        number = (int(place["sector"]) - self._row_at) // (16 * SECTOR_ROWS)
        # The end of a sector is not stored: it is computed from the planes, as in kernels, here up
        # to rounding.
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
            if direction[axis] != 0.0 and target in self._behind(int(self._links[origin, face])):
                return FACES[face]
        return None
