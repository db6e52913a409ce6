"""Float64Structure: triangles with vertices in float64, in a BVH or not."""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray

from raystream.core.float64_triangles import Float64Triangles
from raystream.core.scene_kinds import REFUSALS
from raystream.geometry.float64.batches import BATCH_KERNELS
from raystream.geometry.float64.block import BLOCK_NUMBERS
from raystream.geometry.float64.nearest import AMONG_ALL, find_among_all, find_in_tree
from raystream.geometry.float64.queries import MEMORY_BYTES, float64_searches
from raystream.geometry.float64.ray import LEAST
from raystream.geometry.float64.ray_batch import Float64Rays
from raystream.geometry.float64.traversal import Float64Tree, all_blocks, tree_blocks
from raystream.jit.threads import Progress
from raystream.kernels.aligned import aligned_array
from raystream.structures.base import BuildReport, Structure
from raystream.structures.brute.options import Brute
from raystream.structures.bvh.build import build_arrays
from raystream.structures.bvh.layout import CHILDREN_AT, MAX_BLOCKS, WIDTH
from raystream.structures.bvh.options import Bvh

#: Kernels of a BVH that trace in float64.
_KERNELS = ("auto", "packet", "groups", "single")

#: Blocks that are filled at a time.
_ROWS = 1 << 16

_PRIM_IDS_AT = 36


class Float64Structure(Structure):
    """Triangles in blocks of float64 numbers; see `geometry.float64.block`.

    `traverse` makes traversals; see `geometry.float64.traversal`.
    """

    precision = "float64"
    ray_batch = Float64Rays
    least_rays = 64
    stack_bytes = MEMORY_BYTES
    make_searches = staticmethod(float64_searches)
    triangles: Float64Triangles

    def _set(self, nodes: NDArray[np.float32], prim_ids: NDArray[np.int32], started: float) -> None:
        blocks = _filled_blocks(self.triangles, prim_ids)
        self.arrays = {"nodes": nodes, "leaves": blocks}
        at = [np.uint64(one.ctypes.data if len(one) else 0) for one in (nodes, blocks)]
        self.view = Float64Tree(at[0], at[1], np.uint64(len(blocks)))
        if len(nodes) == 0:
            self.many_ray_kernels = {}
        self.report = BuildReport(
            seconds=time.perf_counter() - started,
            byte_count=sum(array.nbytes for array in self.arrays.values()),
        )


class Float64Bvh(Float64Structure):
    """A BVH with boxes in float32 around triangles in float64.

    Parameters
    ----------
    triangles : Float64Triangles
    options : Bvh
    progress : callable, optional
        Called with (triangles placed, triangles).
    """

    traverse = staticmethod(tree_blocks)
    point_loop = staticmethod(find_in_tree)
    many_ray_kernels = BATCH_KERNELS

    def __init__(
        self, triangles: Float64Triangles, options: Bvh, *, progress: Progress | None = None
    ) -> None:
        started = time.perf_counter()
        if options.kernel not in _KERNELS:
            known = ", ".join(map(repr, _KERNELS))
            raise ValueError(
                f"kernel: {options.kernel!r} is {REFUSALS['float64']}; expected one of {known}"
            )
        self.triangles, self.options = triangles, options
        tree = build_arrays(triangles, options.quality, options.max_leaf_size, progress)
        triangles.release()
        if 2 * len(tree.leaves) > MAX_BLOCKS:
            raise ValueError(
                f"{len(tree.leaves):,} leaf blocks are more than {MAX_BLOCKS // 2:,}, the most "
                "with precision='float64'"
            )
        _round_outward(tree.nodes[:, : CHILDREN_AT // 4].reshape(-1, 3, 2, WIDTH))
        links = tree.children
        is_leaf = links < 0
        first, rest = ~links[is_leaf] >> 3, ~links[is_leaf] & 7
        links[is_leaf] = ~(first << 4 | rest)
        self._set(tree.nodes, np.array(tree.prim_ids), started)


class Float64Brute(Float64Structure):
    """All triangles, without boxes.

    Parameters
    ----------
    triangles : Float64Triangles
    options : Brute
    progress : callable, optional
        Called once: there is nothing to build.
    """

    traverse = staticmethod(all_blocks)
    point_loop = staticmethod(find_among_all)
    point_search = AMONG_ALL

    def __init__(
        self, triangles: Float64Triangles, options: Brute, *, progress: Progress | None = None
    ) -> None:
        started = time.perf_counter()
        self.triangles, self.options = triangles, options
        triangles.release()
        ids = triangles.prim_ids
        blocks = np.full((-(-len(ids) // 4), 4), -1, np.int32)
        blocks.reshape(-1)[: len(ids)] = ids
        self._set(np.zeros((0, 64), np.float32), blocks, started)
        if progress:
            progress(len(ids), len(ids))

    @property
    def tests_per_ray(self) -> int:
        """All triangles, each of which takes as long as two in float32."""
        return 2 * len(self.triangles.prim_ids)


#: By name.
STRUCTURES = {"bvh": Float64Bvh, "brute": Float64Brute}


def _round_outward(planes: NDArray[np.float32]) -> None:
    """Move low and high planes by a step: corners were rounded to nearest.

    Absent boxes stay empty.
    """
    moved = np.nextafter(planes, np.array([[-np.inf], [np.inf]], np.float32))
    planes[...] = np.where(np.isfinite(planes), moved, planes)


def _filled_blocks(triangles: Float64Triangles, prim_ids: NDArray[np.int32]) -> NDArray[np.float64]:
    """The blocks of triangles, by their prim_ids of shape (B, 4); -1 for an unused lane."""
    blocks = aligned_array(len(prim_ids), 2 * BLOCK_NUMBERS).view(np.float64)
    for first in range(0, len(prim_ids), _ROWS):
        ids = prim_ids[first : first + _ROWS]
        part = blocks[first : first + _ROWS]
        corners = triangles.vertices[triangles.faces[np.maximum(ids, 0)]]
        corners[np.abs(corners) < LEAST] = 0.0
        corners[ids < 0] = np.nan
        part[:, :_PRIM_IDS_AT] = corners.transpose(0, 2, 3, 1).reshape(len(ids), _PRIM_IDS_AT)
        part[:, _PRIM_IDS_AT:] = 0.0
        part.view(np.int32)[:, 2 * _PRIM_IDS_AT : 2 * _PRIM_IDS_AT + 4] = ids
    return blocks
