"""DeviceBvh: a bounding volume hierarchy built on a device and kept in its memory."""

from __future__ import annotations

import dataclasses
import time
from functools import cached_property
from typing import Any

from raystream.core.triangles import Triangles
from raystream.cuda.builders.binary_tree import Nodes, make_leaves
from raystream.cuda.builders.clusters import merge_clusters
from raystream.cuda.builders.device_resident import DeviceResident, Resident
from raystream.cuda.builders.refit import cost_of, refit
from raystream.cuda.builders.wide import TooDeepError, WideTree, make_wide
from raystream.cuda.bvh.binary import unfold_on_device
from raystream.jit.cuda import DeviceArray, Gpu
from raystream.jit.threads import Progress
from raystream.kernels.aligned import aligned_array
from raystream.structures.base import Structure, UpdateReport
from raystream.structures.bvh.layout import BvhArrays, TreeAddresses
from raystream.structures.bvh.options import Bvh
from raystream.structures.bvh.structure import BvhStructure, hittable_corners


class DeviceBvh(DeviceResident, BvhStructure):
    """A BVH in device memory, copied to the host when first needed there.

    Its options have ``quality="fast"``, which applies if the CPU rebuilds it.

    Parameters
    ----------
    gpu, triangles, options, started
        See `DeviceResident`.
    wide : WideTree
    """

    _host_class = BvhStructure
    _host_names = ("tree", "view", "arrays")

    def __init__(
        self, gpu: Gpu, triangles: Triangles, options: Bvh, wide: WideTree, started: float
    ) -> None:
        tree = TreeAddresses(wide.nodes.address, wide.leaves.address)
        super().__init__(gpu, triangles, options, Resident(tree, wide[:2]), started)
        self.wide, self._held_ids = wide, triangles.prim_ids

    @property
    def laid_out(self) -> Resident:
        """New binary nodes of the tree as it is now."""
        nodes, leaves, levels = self.wide
        arrays = unfold_on_device(self.gpu, nodes, leaves, len(levels) - 1)
        return Resident(TreeAddresses(*(one.address for one in arrays)), arrays)

    def _host_arguments(self) -> tuple[BvhArrays]:
        return (BvhArrays(*(_aligned(one) for one in self.wide[:2])),)

    @cached_property
    def cost_when_built(self) -> float:
        """Cost of tracing the tree before it was refitted; see `UpdateReport`."""
        return cost_of(self.gpu, self.wide)

    def updated(
        self, triangles: Triangles, max_cost_growth: float, progress: Progress | None = None
    ) -> tuple[Structure, UpdateReport]:
        """Refit the tree to moved triangles, or rebuild it, on the device; see `Bvh.updated`."""
        del progress
        started = time.perf_counter()
        old_cost = self.cost_when_built
        if self._holds(triangles):
            try:
                cost = self._refit(triangles)
            except BaseException:  # an interrupt: this structure stays as it was
                self._refit(self.triangles)
                raise
            if cost <= max_cost_growth * old_cost:
                moved = DeviceBvh(self.gpu, triangles, self.options, self.wide, started)
                moved._held_ids, moved.cost_when_built = self._held_ids, old_cost
                self.is_outdated = True
                return moved, UpdateReport(False, moved.report.seconds, cost, old_cost)
        rebuilt = build_bvh(self.gpu, triangles, self.options)
        cost = rebuilt.cost_when_built
        return rebuilt, UpdateReport(True, time.perf_counter() - started, cost, cost)

    def _refit(self, triangles: Triangles) -> float:
        """Refit the tree; returns its tracing cost."""
        corners = self.gpu.upload("corners", hittable_corners(triangles))
        refit(self.gpu, self.wide, corners)
        self.__dict__.pop("_on_host", None)
        return cost_of(self.gpu, self.wide)


def _aligned(array: DeviceArray) -> Any:
    copy = aligned_array(*array.shape)
    copy[:] = array.host()
    return copy


def build_bvh(gpu: Gpu, triangles: Triangles, options: Bvh) -> BvhStructure:
    """Build a BVH on a device.

    Parameters
    ----------
    gpu : Gpu
    triangles : Triangles
    options : Bvh
        `quality` applies to CPU builds.

    Returns
    -------
    BvhStructure
        Deterministic. Neighbours in Morton order whose common box is small are merged; the binary
        tree is collapsed to wide nodes as on the CPU. The CPU builds it if that tree is too deep.

    Raises
    ------
    ValueError
        If the tree would be too large.
    CudaError
        If device memory runs out: building takes about 300 bytes per triangle.
    """
    options = dataclasses.replace(options, quality="fast")
    if len(triangles.prim_ids) == 0:
        return BvhStructure(triangles, options)
    started = time.perf_counter()
    corners = gpu.upload("corners", triangles.corners)
    nodes = Nodes.allocate(gpu, len(triangles.prim_ids), options.max_leaf_size)
    make_leaves(gpu, triangles, corners, nodes)
    try:
        wide = make_wide(gpu, nodes, merge_clusters(gpu, nodes), corners)
    except TooDeepError:
        return BvhStructure(triangles, options)
    return DeviceBvh(gpu, triangles, options, wide, started)
