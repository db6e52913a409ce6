"""DeviceBvh: a bounding volume hierarchy that was built on a device, and stays there."""

from __future__ import annotations

import operator
import time
from collections.abc import Mapping
from functools import cached_property
from typing import Any

import numpy as np

from raystream.core.triangles import Triangles
from raystream.cuda.builders.clusters import merge_clusters
from raystream.cuda.builders.device_resident import DeviceResident, finish
from raystream.cuda.builders.linear import link_by_keys
from raystream.cuda.builders.moving import cost_of, refit
from raystream.cuda.builders.records import COARSE_BITS, FINE_BITS, Nodes, make_leaves
from raystream.cuda.builders.wide import TooDeepError, WideTree, make_wide
from raystream.cuda.structures import Resident
from raystream.jit.cuda import DeviceArray, Gpu
from raystream.jit.threads import Progress
from raystream.kernels.aligned import aligned_array
from raystream.structures.base import Structure, UpdateReport
from raystream.structures.bvh.layout import MAX_LEAF_SIZE, BvhArrays
from raystream.structures.bvh.steps import TreeAddresses
from raystream.structures.bvh.structure import Bvh, hittable_corners

__all__ = ["METHODS", "DeviceBvh", "build_bvh"]

#: How a device builds: by the bits of keys alone, or by merging neighbours.
METHODS = ("clusters", "linear")


class DeviceBvh(DeviceResident, Bvh):
    """A BVH in a device's memory; it is copied to the host when it is asked for there.

    Parameters
    ----------
    triangles : Triangles
    gpu : Gpu
    wide : WideTree
    method : {"clusters", "linear"}
    max_leaf_size : int
    started : float
        When the build began, by `time.perf_counter`.

    Notes
    -----
    A file of it has the option ``quality="fast"``: the CPU's, should it be built again there.
    """

    _host_names = ("tree", "_numbers")

    def __init__(
        self,
        triangles: Triangles,
        gpu: Gpu,
        wide: WideTree,
        method: str,
        max_leaf_size: int,
        started: float,
    ) -> None:
        self.triangles, self.gpu, self.wide, self.method = triangles, gpu, wide, method
        self.options = {"quality": "fast", "max_leaf_size": max_leaf_size, "kernel": "auto"}
        self.resident = Resident(TreeAddresses(wide.nodes.address, wide.leaves.address), wide[:2])
        self._held_ids, self._lists_twice = triangles.prim_ids, False
        byte_count = sum(4 * one.shape[0] * one.shape[1] for one in wide[:2])
        self.report = finish(gpu, byte_count, started)

    @cached_property
    def _on_host(self) -> Bvh:
        """The same tree, whose arrays are on the host."""
        made = Bvh.__new__(Bvh)
        tree = BvhArrays(*(_aligned(one) for one in self.wide[:2]))
        made._set(self.triangles, tree, self.options, 0.0)
        return made

    @cached_property
    def cost_when_built(self) -> float:
        """Cost of tracing the tree before it was refitted; see `UpdateReport`."""
        return cost_of(self.gpu, self.wide)

    def updated(
        self, triangles: Triangles, max_cost_growth: float, progress: Progress | None = None
    ) -> tuple[Structure, UpdateReport]:
        """Refit the tree to moved triangles, or build it anew, on the device; see `Bvh.updated`."""
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
                moved = DeviceBvh(triangles, self.gpu, self.wide, **self._options, started=started)
                moved._held_ids, moved.cost_when_built = self._held_ids, old_cost
                return moved, UpdateReport(False, moved.report.seconds, cost, old_cost)
        rebuilt = build_bvh(self.gpu, triangles, **self._options)
        cost = rebuilt.cost_when_built
        return rebuilt, UpdateReport(True, time.perf_counter() - started, cost, cost)

    @property
    def _options(self) -> Mapping[str, Any]:
        return {"method": self.method, "max_leaf_size": self.options["max_leaf_size"]}

    def _refit(self, triangles: Triangles) -> float:
        """Move the tree; returns what tracing it costs."""
        corners = self.gpu.upload("corners", hittable_corners(triangles))
        refit(self.gpu, self.wide, corners)
        self.__dict__.pop("_on_host", None)
        return cost_of(self.gpu, self.wide)


def _aligned(array: DeviceArray) -> Any:
    copy = aligned_array(*array.shape)
    copy[:] = array.host()
    return copy


def build_bvh(
    gpu: Gpu, triangles: Triangles, *, method: str = "clusters", max_leaf_size: int = 4
) -> Bvh:
    """Build a BVH on a device.

    Parameters
    ----------
    gpu : Gpu
    triangles : Triangles
    method : {"clusters", "linear"}
        ``"linear"`` takes the tree that the bits of keys along a curve make; ``"clusters"``
        merges neighbours on the curve that fit together, for a tree that is traced faster.
    max_leaf_size : int
        Most triangles in a leaf, 1 to 32.

    Returns
    -------
    Bvh
        The same one each time. Which nodes of the binary tree become wide ones is decided as on
        the CPU.

    Raises
    ------
    ValueError
        If an option is out of range, or the tree would be too large.
    TypeError
        If `max_leaf_size` is no integer.
    CudaError
        If there is no memory for it: about 300 bytes for each triangle while building.
    """
    if method not in METHODS:
        known = ", ".join(map(repr, METHODS))
        raise ValueError(f"method: expected one of {known}, got {method!r}")
    max_leaf_size = operator.index(max_leaf_size)
    if not 1 <= max_leaf_size <= MAX_LEAF_SIZE:
        raise ValueError(f"max_leaf_size: expected 1 to {MAX_LEAF_SIZE}, got {max_leaf_size}")
    if len(triangles.prim_ids) == 0:
        return Bvh(triangles, quality="fast", max_leaf_size=max_leaf_size)
    started = time.perf_counter()
    corners = gpu.upload("corners", np.ascontiguousarray(triangles.corners))
    try:
        wide = _build(gpu, triangles, corners, method, max_leaf_size, FINE_BITS)
    except TooDeepError:
        # At most 30 bits of keys and 31 of rows tell leaves apart: no path is longer.
        wide = _build(gpu, triangles, corners, "linear", max_leaf_size, COARSE_BITS)
    return DeviceBvh(triangles, gpu, wide, method, max_leaf_size, started)


def _build(
    gpu: Gpu, triangles: Triangles, corners: DeviceArray, method: str, max_leaf_size: int, bits: int
) -> WideTree:
    nodes = Nodes.allocate(gpu, len(triangles.prim_ids), max_leaf_size)
    keys = make_leaves(gpu, triangles, corners, nodes, bits)
    root = link_by_keys(gpu, keys, nodes) if method == "linear" else merge_clusters(gpu, nodes)
    return make_wide(gpu, nodes, root, corners)
