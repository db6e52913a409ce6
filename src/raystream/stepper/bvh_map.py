"""Interpret BVH records: nodes by row, leaves by first block."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from raystream.kernels.leaf_block import BLOCK_BYTES
from raystream.stepper.structure_map import BlockMap, LocalSpot, Records, to_world
from raystream.structures.bvh.layout import WIDTH
from raystream.structures.bvh.structure import BvhStructure

#: Low bits of a key, with its lane.
_LANE_BITS = 7

#: Above a leaf's number of blocks, its link has its first block.
_BLOCK_SHIFT = 3


class BvhMap(BlockMap):
    """Nodes of a BVH by row, followed by leaves by first block."""

    def __init__(self, bvh: BvhStructure) -> None:
        self._bvh, self._tree = bvh, bvh.tree
        self._block_rows, self._blocks = bvh.tree.prim_ids, bvh.tree.leaves
        self._node_count = len(bvh.tree.nodes)

    @cached_property
    def _slots(self) -> NDArray[np.int64]:
        """Slot of each number in its parent: row times eight plus lane; -1 if unused."""
        links = self._tree.children.ravel()
        slots = np.full(self._node_count + len(self._blocks), -1)
        at = np.flatnonzero(links)  # 0 is no link: the root has no parent
        slots[self._numbers(links[at])] = at
        return slots

    def _numbers(self, links: NDArray[np.int32]) -> NDArray[np.int64]:
        """Numbers of children."""
        blocks = self._node_count + (~links >> _BLOCK_SHIFT)
        return np.where(links < 0, blocks, links).astype(np.int64)

    def kind(self, number: int) -> str:
        """See `StructureMap.kind`."""
        return "node" if number < self._node_count else "leaf"

    def box(self, number: int) -> NDArray[np.float64]:
        """See `StructureMap.box`."""
        return to_world(self._bvh, self._local_box(number))

    def _local_box(self, number: int) -> NDArray[np.float64]:
        if number == 0:
            return self._bvh.triangles.bounds.astype(np.float64)
        row, lane = divmod(int(self._slots[number]), WIDTH)
        planes = self._tree.nodes[row, : 6 * WIDTH].reshape(3, 2, WIDTH)[:, :, lane]
        return planes.T.astype(np.float64)

    def spot(self, records: Records) -> LocalSpot | None:
        """See `StructureMap.spot`."""
        place = records.place
        if place["block"] < place["end"]:
            row = (int(place["block"]) - self._blocks.ctypes.data) // BLOCK_BYTES
            while self._slots[self._node_count + row] < 0:  # back to the leaf's first block
                row -= 1
            return self._local_spot(self._node_count + row, records)
        entries = self._entries(records)
        return self._local_spot(entries[0], records) if entries else None

    def stack(self, records: Records) -> tuple[LocalSpot, ...]:
        """See `StructureMap.stack`."""
        is_in_leaf = records.place["block"] < records.place["end"]
        entries = self._entries(records)
        waiting = entries if is_in_leaf else entries[1:]
        return tuple(self._local_spot(number, records) for number in waiting)

    def _entries(self, records: Records) -> list[int]:
        """Numbers of the stack's entries that are still near enough, top first."""
        top, half = int(records.place["top"]), self._bvh.stack_half
        keys = records.memory[:top].view(np.int32)
        links = records.memory[half : half + top].view(np.int32)
        limit = int(np.float32(records.t_far).view(np.int32)) | _LANE_BITS
        return self._numbers(links)[keys <= limit][::-1].tolist()

    def _local_spot(self, number: int, records: Records) -> LocalSpot:
        """The ray's interval in a box, up to rounding; empty if it misses the root."""
        low, high = self._local_box(number)
        origin = records.ray["origin"].astype(np.float64)
        way = records.ray["direction"].astype(np.float64)
        t_in, t_out = float(records.ray["t_min"]), float(records.ray["t_max"])
        for axis in np.flatnonzero(way):
            ends = sorted((plane[axis] - origin[axis]) / way[axis] for plane in (low, high))
            t_in, t_out = max(t_in, float(ends[0])), min(t_out, float(ends[1]))
        return LocalSpot(number, t_in, t_out)
