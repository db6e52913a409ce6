"""Growth of a kd-tree level by level: all cells of a level are split in parallel."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from raystream.core.triangles import Triangles
from raystream.cuda.builders.kdtree import partition, planes
from raystream.cuda.builders.kdtree.partition import Counts, GrownTriangles, Made
from raystream.cuda.builders.kdtree.planes import Choices, Level, References, Tried
from raystream.jit.cuda import DeviceArray, Gpu, RangeKernel
from raystream.jit.cuda.scan import scan_in_place
from raystream.structures.clip import BOUND
from raystream.structures.kdtree.build import LEAST_ROOM, MAX_REFERENCES, root_box
from raystream.structures.kdtree.layout import MAX_NODES
from raystream.structures.kdtree.split import Costs
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

    def launch_by_level(
        self, gpu: Gpu, *launches: tuple[RangeKernel, tuple[Any, ...]], upward: bool = False
    ) -> None:
        """Launch kernels for one level after another, from the root down, or from the leaves up.

        They take the number of a node in its level, the level's first node, and the arguments.
        """
        levels = list(zip(self.levels, self.levels[1:], strict=False))
        for first, end in reversed(levels) if upward else levels:
            for kernel, arguments in launches:
                kernel.launch(gpu, end - first, (np.uint64(first), *arguments))


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


class _Grower:
    # A level's arrays are from the driver's pool, since other allocations wait for the device.

    def __init__(
        self, gpu: Gpu, triangles: Triangles, corners: DeviceArray, settings: BuildSettings
    ) -> None:
        self.gpu, self.triangles, self.corners = gpu, triangles, corners
        self.costs = Costs(*map(float, settings.costs))
        self.max_depth = settings.max_depth
        self.max_leaf_size = settings.max_leaf_size
        self.bound = float(triangles.max_coordinate) * BOUND
        self.grown = GrownTriangles(corners, np.float64(self.bound), np.int64(settings.overlap))
        self.room = MAX_REFERENCES * len(triangles.prim_ids) + LEAST_ROOM
        self.ids = gpu.empty("references of leaves", self.room, np.int32)

    def grow(self) -> GrownTree:
        cells, refs = self._begin()
        levels, id_count = [0, 1], 0
        finished: list[tuple[DeviceArray, DeviceArray, DeviceArray]] = []
        while len(cells.boxes):
            may_split, boxes = len(finished) < self.max_depth, cells.boxes
            made, cells, refs, leaf_ids = self._split(cells, refs, levels[-1], id_count, may_split)
            finished.append((made.nodes, boxes, made.sizes))
            id_count += leaf_ids
            levels.append(levels[-1] + len(cells.boxes))
            if levels[-1] > MAX_NODES:
                raise ValueError(f"{levels[-1]:,} nodes are more than {MAX_NODES:,}")
        levels.pop()
        nodes, boxes, sizes = (self._joined(list(one)) for one in zip(*finished, strict=True))
        return GrownTree(nodes, boxes, sizes, self.ids.part(0, id_count), tuple(levels))

    def _begin(self) -> tuple[Level, References]:
        """The root, and its references."""
        prim_ids = self.gpu.upload("prim_ids", self.triangles.prim_ids)
        count = len(prim_ids)
        cells, refs = Level.allocate(self.gpu, 1), References.allocate(self.gpu, count)
        cells.boxes.fill(root_box(self.triangles).reshape(1, 6))
        cells.begins.fill(np.array([0, count], np.uint32))
        cells.bads.fill(np.zeros(1, np.uint32))
        cells.rooms.fill(np.array([self.room], np.uint64))
        given = self.corners, prim_ids, np.float32(self.bound), refs
        partition.make_reference.launch(self.gpu, count, given)
        return cells, refs

    def _choose(self, cells: Level, refs: References, may_split: bool) -> Choices:
        """Launch the kernels that choose the planes of a level."""
        gpu, count, all_count = self.gpu, len(cells.boxes), len(refs.boxes)
        choices, tried = Choices.allocate(gpu, count), Tried.allocate(gpu, all_count)
        most = np.uint64(self.max_leaf_size if may_split else 1 << 62)
        shared = cells, self.costs, most, tried
        planes.try_planes.launch(gpu, all_count, (refs, *shared))
        planes.choose_plane.launch(gpu, count, (*shared, choices))
        partition.count_cut.launch(gpu, all_count, (refs, choices))
        return choices

    def _split(
        self, cells: Level, refs: References, first_row: int, id_count: int, may_split: bool
    ) -> tuple[Made, Level, References, int]:
        """Split a level; returns nodes, the next level, and the number of references of leaves."""
        gpu = self.gpu
        cell_count, count = len(cells.boxes), len(refs.boxes)
        choices = self._choose(cells, refs, may_split)
        counts = Counts(
            gpu.pooled("parts of references", count + 1, np.uint64),
            gpu.pooled("splits", cell_count + 1, np.uint64),
        )
        partition.confirm.launch(gpu, cell_count, (cells, choices, counts))
        given = choices, self.grown, counts
        partition.count_parts.launch(gpu, count, (refs, *given))
        found, split = (scan_in_place(gpu, one, gpu.pooled) for one in counts)
        after = Level.allocate(gpu, 2 * (split >> 32))
        refs_after = References.allocate(gpu, (found >> 32) + (found & _LOWER))
        made = Made(
            gpu.pooled("nodes", (cell_count, 2), np.int32),
            gpu.pooled("sizes of cells", cell_count, np.uint32),
            self.ids,
        )
        first_id = np.uint64(id_count)
        to_cells = choices, counts, made, np.uint64(first_row), first_id, after
        partition.make_cells.launch(gpu, cell_count, (cells, *to_cells))
        to_refs = made, first_id, refs_after
        partition.place_parts.launch(gpu, count, (refs, cells, *given, *to_refs))
        return made, after, refs_after, split & _LOWER

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
