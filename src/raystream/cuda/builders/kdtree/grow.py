"""Growth of a kd-tree level by level: all cells of a level are split in parallel."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.core.triangles import Triangles
from raystream.cuda.builders.kdtree import partition, planes
from raystream.cuda.builders.kdtree.partition import Counts, GrownTriangles, Made
from raystream.cuda.builders.kdtree.planes import BIN_BYTES, Choices, Level, References, Tried
from raystream.jit.cuda import DeviceArray, Gpu
from raystream.jit.cuda.scan import scan_in_place
from raystream.structures.clip import BOUND
from raystream.structures.kdtree.build import LEAST_ROOM, MAX_REFERENCES, root_box
from raystream.structures.kdtree.layout import MAX_NODES
from raystream.structures.kdtree.options import MAX_DEPTH
from raystream.structures.kdtree.split import MOST_EXACT, Costs
from raystream.structures.kdtree.subtree import BuildSettings

_LOWER = 0xFFFFFFFF


class GrownTree(NamedTuple):
    """A kd-tree on a device, in level order.

    Attributes
    ----------
    nodes : DeviceArray of shape (M, 2), int32
        As `kdtree.layout.KdArrays.nodes`, in level order. The first word of a leaf is the index
        of its first reference in `ids`.
    boxes : DeviceArray of shape (M, 6), float32
        Their cells.
    sizes : DeviceArray of shape (M,), uint32
        Number of references in their cells.
    ids : DeviceArray, int32
        prim_ids of all leaves.
    levels : tuple of int
        Level i is rows levels[i] to levels[i + 1].
    """

    nodes: DeviceArray
    boxes: DeviceArray
    sizes: DeviceArray
    ids: DeviceArray
    levels: tuple[int, ...]


def as_numbers(costs: Costs) -> Costs:
    """Costs as NumPy scalars, for kernel arguments."""
    return Costs(*map(np.float64, costs))


def grow_tree(
    gpu: Gpu, triangles: Triangles, corners: DeviceArray, settings: BuildSettings
) -> GrownTree:
    """Grow a kd-tree on a device.

    Parameters
    ----------
    gpu : Gpu
    triangles : Triangles
        At least one that can be hit.
    corners : DeviceArray of shape (F, 3, 3), float32
        The triangles' corners.
    settings : BuildSettings

    Returns
    -------
    GrownTree
        With the CPU's planes and the CPU's references in each leaf.

    Raises
    ------
    ValueError
        If the tree would be too large for the layout.
    CudaError
        If device memory runs out: it takes about 100 bytes per reference of a level.

    Notes
    -----
    The host waits for the device once per level, to read the number of cells and references of
    the next one.
    """
    return _Grower(gpu, triangles, corners, settings).grow()


class _Cells(NamedTuple):
    """The arrays of a `Level`."""

    boxes: DeviceArray
    begins: DeviceArray
    bads: DeviceArray
    rooms: DeviceArray

    @classmethod
    def allocate(cls, gpu: Gpu, count: int) -> _Cells:
        return cls(
            gpu.pooled("boxes of cells", (count, 6), np.float32),
            gpu.pooled("references of cells", count + 1, np.uint32),
            gpu.pooled("bad splits", count, np.uint32),
            gpu.pooled("rooms of cells", count, np.uint64),
        )

    @property
    def at(self) -> Level:
        return Level(*(one.address for one in self))


class _Lists(NamedTuple):
    """The arrays of `References`."""

    boxes: DeviceArray
    ids: DeviceArray
    cells: DeviceArray

    @classmethod
    def allocate(cls, gpu: Gpu, count: int) -> _Lists:
        return cls(
            gpu.pooled("boxes of references", (count, 6), np.float32),
            gpu.pooled("references", count, np.int32),
            gpu.pooled("cells of references", count, np.uint32),
        )

    @property
    def at(self) -> References:
        return References(*(one.address for one in self))


class _Grower:
    # A level's arrays are from the driver's pool, since other allocations wait for the device.

    def __init__(
        self, gpu: Gpu, triangles: Triangles, corners: DeviceArray, settings: BuildSettings
    ) -> None:
        self.gpu, self.triangles, self.corners = gpu, triangles, corners
        self.costs = as_numbers(settings.costs)
        self.max_depth = min(settings.max_depth, MAX_DEPTH)
        self.max_leaf_size = settings.max_leaf_size
        self.overlap = np.int64(settings.overlap)
        self.bound = float(triangles.max_coordinate) * BOUND
        self.room = MAX_REFERENCES * len(triangles.prim_ids) + LEAST_ROOM
        self.ids = gpu.empty("references of leaves", self.room, np.int32)

    def grow(self) -> GrownTree:
        cells, lists = self._begin()
        levels, id_count = [0, 1], 0
        made: list[tuple[DeviceArray, DeviceArray, DeviceArray]] = []
        while len(cells.boxes):
            may_split = len(made) < self.max_depth
            nodes, sizes, cells_after, lists_after, leaf_ids = self._split(
                cells, lists, levels[-1], id_count, may_split
            )
            made.append((nodes, cells.boxes, sizes))
            cells, lists = cells_after, lists_after
            id_count += leaf_ids
            levels.append(levels[-1] + len(cells.boxes))
            if levels[-1] > MAX_NODES:
                raise ValueError(f"{levels[-1]:,} nodes are more than {MAX_NODES:,}")
        levels.pop()
        nodes, boxes, sizes = (self._joined([level[k] for level in made]) for k in range(3))
        return GrownTree(nodes, boxes, sizes, self.ids.part(0, id_count), tuple(levels))

    def _begin(self) -> tuple[_Cells, _Lists]:
        """The root, and its references."""
        prim_ids = self.gpu.upload("prim_ids", self.triangles.prim_ids)
        count = len(prim_ids)
        cells, lists = _Cells.allocate(self.gpu, 1), _Lists.allocate(self.gpu, count)
        cells.boxes.fill(root_box(self.triangles).reshape(1, 6))
        cells.begins.fill(np.array([0, count], np.uint32))
        cells.bads.fill(np.zeros(1, np.uint32))
        cells.rooms.fill(np.array([self.room], np.uint64))
        given = self.corners.address, prim_ids.address, np.float32(self.bound)
        partition.make_reference.launch(self.gpu, count, (*given, lists.at))
        return cells, lists

    def _choose(self, cells: _Cells, lists: _Lists, may_split: bool) -> Choices:
        """Launch the kernels that choose the planes of a level."""
        gpu, count, all_count = self.gpu, len(cells.boxes), len(lists.boxes)
        choices = Choices(
            *(
                self._kept(gpu.pooled("choices", count, dtype))
                for dtype in (np.uint32, np.float32, np.uint32, np.uint32)
            )
        )
        cut_counts = self._scratch[-1]
        gpu.clear(cut_counts, cut_counts.stream)
        most = self.max_leaf_size if may_split else 1 << 62
        has_bins = all_count > int(MOST_EXACT)
        slots = all_count // int(MOST_EXACT) + 1 if has_bins else 0
        bins = gpu.pooled("bins", slots * BIN_BYTES, np.uint8)
        gpu.clear(bins, bins.stream)
        tried = Tried(
            self._kept(gpu.pooled("costs of planes", all_count, np.float64)),
            self._kept(gpu.pooled("planes", all_count, np.float32)),
            self._kept(gpu.pooled("axes of planes", all_count, np.uint32)),
            self._kept(bins),
        )
        shared = self.costs, np.uint64(most), tried
        planes.try_planes.launch(gpu, all_count, (lists.at, cells.at, *shared))
        planes.choose_plane.launch(gpu, count, (cells.at, *shared, choices))
        partition.count_cut.launch(gpu, all_count, (lists.at, choices))
        return choices

    def _kept(self, array: DeviceArray) -> np.uint64:
        """Keep an array alive until the level is done; returns its address."""
        self._scratch.append(array)
        return array.address

    def _split(
        self, cells: _Cells, lists: _Lists, first_row: int, id_count: int, may_split: bool
    ) -> tuple[DeviceArray, DeviceArray, _Cells, _Lists, int]:
        """Split a level; returns nodes, sizes, the next level, and references of leaves."""
        gpu = self.gpu
        cell_count, count = len(cells.boxes), len(lists.boxes)
        self._scratch: list[DeviceArray] = []
        choices = self._choose(cells, lists, may_split)
        parts = gpu.pooled("parts of references", count + 1, np.uint64)
        splits = gpu.pooled("splits", cell_count + 1, np.uint64)
        counts = Counts(parts.address, splits.address)
        partition.confirm.launch(gpu, cell_count, (cells.at, choices, counts))
        triangles = GrownTriangles(self.corners.address, np.float64(self.bound), self.overlap)
        given = choices, triangles, counts
        partition.count_parts.launch(gpu, count, (lists.at, *given))
        found, split = (scan_in_place(gpu, one, gpu.pooled) for one in (parts, splits))
        after = _Cells.allocate(gpu, 2 * (split >> 32))
        lists_after = _Lists.allocate(gpu, (found >> 32) + (found & _LOWER))
        nodes = gpu.pooled("nodes", (cell_count, 2), np.int32)
        sizes = gpu.pooled("sizes of cells", cell_count, np.uint32)
        made = Made(nodes.address, sizes.address, self.ids.address)
        first_id = np.uint64(id_count)
        rows = np.uint64(first_row), first_id
        partition.make_cells.launch(
            gpu, cell_count, (cells.at, choices, counts, made, *rows, after.at)
        )
        to = made, first_id, lists_after.at
        partition.place_parts.launch(gpu, count, (lists.at, cells.at, *given, *to))
        return nodes, sizes, after, lists_after, split & _LOWER

    def _joined(self, arrays: list[DeviceArray]) -> DeviceArray:
        """Concatenate arrays."""
        first = arrays[0]
        count = sum(map(len, arrays))
        made = self.gpu.empty("tree", (count, *first.shape[1:]), first.dtype)
        to = made.address
        for one in arrays:
            self.gpu.copy(to, one.address, one.nbytes, one.stream)
            to += np.uint64(one.nbytes)
        return made
