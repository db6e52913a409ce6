"""BvhStructure: a built bounding volume hierarchy, and its queries."""

from __future__ import annotations

import time
from collections.abc import Mapping
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.triangles import Triangles
from raystream.jit.threads import Progress
from raystream.structures.base import BuildReport, Structure, UpdateReport
from raystream.structures.bvh.batches import BATCH_KERNELS
from raystream.structures.bvh.build import build_arrays
from raystream.structures.bvh.layout import BvhArrays, TreeAddresses, check_arrays
from raystream.structures.bvh.options import Bvh
from raystream.structures.bvh.refit import refit
from raystream.structures.bvh.statistics import statistics
from raystream.structures.bvh.steps import stack_half
from raystream.structures.bvh.traversal import traverse
from raystream.structures.bvh.walks.single import STACK_BYTES


class BvhStructure(Structure):
    """A bounding volume hierarchy that has been built; see `Bvh`.

    Parameters
    ----------
    triangles : Triangles
    options : Bvh
    progress : callable, optional
        Called with (triangles placed, triangles) while building.
    """

    traverse = staticmethod(traverse)
    stack_bytes = STACK_BYTES
    many_ray_kernels = BATCH_KERNELS
    options: Bvh

    def __init__(
        self, triangles: Triangles, options: Bvh, *, progress: Progress | None = None
    ) -> None:
        started = time.perf_counter()
        arrays = build_arrays(triangles, options.quality, options.max_leaf_size, progress)
        triangles.release()  # the leaves have them
        self._set(triangles, arrays, options, started)

    def _set(self, triangles: Triangles, tree: BvhArrays, options: Bvh, started: float) -> None:
        self.triangles = triangles
        self.tree = tree
        self.options = options
        addresses = (one.ctypes.data if len(one) else 0 for one in tree)
        self.arrays = {"nodes": tree.nodes, "leaves": tree.leaves}
        self.view = TreeAddresses._make(map(np.uint64, addresses))
        if len(tree.nodes) == 0:
            self.many_ray_kernels = {}
        held_ids = triangles.prim_ids
        is_held = tree.prim_ids >= 0
        if np.count_nonzero(is_held) != len(held_ids):
            # Some cannot be hit any more after a refit.
            held_ids = np.sort(tree.prim_ids[is_held])
        # None for all: hardly ever needed, and 4 bytes per triangle.
        self._held_ids = None if len(held_ids) == len(triangles) else held_ids
        self.report = BuildReport(
            seconds=time.perf_counter() - started,
            byte_count=sum(array.nbytes for array in tree),
        )

    @cached_property
    def cost_when_built(self) -> float:
        """Trace cost of the tree before any refit; see `UpdateReport`."""
        return trace_cost(self.tree)

    @cached_property
    def stack_half(self) -> int:
        """Bytes of half a search's stack; see `steps.begin`."""
        return stack_half(self.tree)

    def quality(self) -> dict[str, float]:
        """Counts, depth, and the expected cost of a random ray that hits the bounds."""
        return statistics(self.tree)

    def saved_arrays(self) -> dict[str, NDArray[Any]]:
        """The tree as it is traced."""
        return self.arrays

    @classmethod
    def from_arrays(
        cls, triangles: Triangles, arrays: Mapping[str, NDArray[Any]], options: Bvh
    ) -> BvhStructure:
        """Make a BVH from saved arrays; see `Structure.from_arrays`."""
        started = time.perf_counter()
        tree = check_arrays(arrays, triangles.prim_ids, triangles.corners)
        structure = cls.__new__(cls)
        structure._set(triangles, tree, options, started)
        return structure

    def updated(
        self, triangles: Triangles, max_cost_growth: float, progress: Progress | None = None
    ) -> tuple[Structure, UpdateReport]:
        """Refit the tree to moved triangles, or rebuild it; see `Structure.updated`.

        Notes
        -----
        The arrays are changed in place. A tree is rebuilt if other tracers need it as it is, if
        the local frame differs, or if it lacks a triangle that could not be hit when it was built
        and now can.
        """
        started = time.perf_counter()
        old_cost = self.cost_when_built
        if self._holds(triangles):
            try:
                refit(self.tree, hittable_corners(triangles))
                cost = trace_cost(self.tree)
            except BaseException:  # an interrupt: this structure stays as it was
                refit(self.tree, hittable_corners(self.triangles))
                raise
            if cost <= max_cost_growth * old_cost:
                moved = self._moved(triangles, started)
                return moved, UpdateReport(False, moved.report.seconds, cost, old_cost)
        rebuilt = BvhStructure(triangles, self.options, progress=progress)
        cost = rebuilt.cost_when_built
        return rebuilt, UpdateReport(True, time.perf_counter() - started, cost, cost)

    def _holds(self, triangles: Triangles) -> bool:
        """Whether it may be refitted: it has all triangles, in their frame, for one tracer."""
        if len(self.tracers) > 1 or triangles.scale != self.triangles.scale:
            return False
        if not np.array_equal(triangles.center, self.triangles.center):
            return False
        if self._held_ids is None or np.array_equal(triangles.prim_ids, self._held_ids):
            return True
        is_held = np.zeros(len(triangles), np.bool_)
        is_held[self._held_ids] = True
        return bool(is_held[triangles.prim_ids].all())

    def _moved(self, triangles: Triangles, started: float) -> BvhStructure:
        """The structure of moved triangles, with the same, refitted arrays."""
        moved = BvhStructure.__new__(BvhStructure)
        moved.__dict__.update(self.__dict__)
        for name in ("frame", "tracers"):
            moved.__dict__.pop(name, None)
        self.is_outdated = True
        moved.triangles = triangles
        seconds = time.perf_counter() - started
        moved.report = BuildReport(seconds, self.report.byte_count)
        return moved


def trace_cost(tree: BvhArrays) -> float:
    """Expected node steps and block tests of a random line through the bounds."""
    figures = statistics(tree)
    return figures["nodes per ray"] + figures["blocks per ray"]


def hittable_corners(triangles: Triangles) -> NDArray[np.float32]:
    """Corners of all triangles; NaN for those that cannot be hit."""
    if len(triangles.prim_ids) == len(triangles):
        return triangles.corners
    corners = np.full_like(triangles.corners, np.nan)
    corners[triangles.prim_ids] = triangles.corners[triangles.prim_ids]
    return corners
