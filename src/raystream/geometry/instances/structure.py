"""InstancedStructure: the structures of a scene's objects, and the tree over their instances."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.instanced_triangles import InstancedTriangles
from raystream.core.query import Kind, Query
from raystream.core.rays import RayBatch
from raystream.core.triangles import Triangles
from raystream.geometry.float64.ray_batch import Float64Rays
from raystream.geometry.instances.batches import BATCH_KERNELS
from raystream.geometry.instances.float64 import (
    MEMORY_BYTES,
    float64_instance_searches,
    traverse_all_float64,
    traverse_top_float64,
)
from raystream.geometry.instances.nearest import (
    AMONG_ALL,
    PlacedInstances,
    find_among_all,
    find_in_trees,
    placed_records,
    placed_view,
)
from raystream.geometry.instances.records import (
    INSTANCE_BYTES,
    OBJECT_ADDRESSES,
    TREE,
    instance_records,
    object_records,
)
from raystream.geometry.instances.top import (
    FAR_UNIT,
    OBJECT_MARGIN,
    TopTrees,
    world_frame,
)
from raystream.geometry.instances.traversal import (
    STACK_BYTES,
    TopAddresses,
    instance_searches,
    traverse_all,
    traverse_all_primitives,
    traverse_top,
    traverse_top_primitives,
)
from raystream.geometry.primitives.traversal import STACK_BYTES as PRIMITIVE_BYTES
from raystream.jit.threads import Progress, part_of
from raystream.kernels.hits import Sink
from raystream.kernels.ray import PAD, SceneFrame
from raystream.structures.base import BuildReport, Nested, Structure
from raystream.structures.batch_kernels import BatchKernels, Calls
from raystream.structures.bvh.layout import NODE_BYTES
from raystream.structures.registry import StructureOptions, builder_for

_NO_NODES = np.zeros((0, 64), np.float32)


class InstancedStructure(Structure):
    """The objects of a scene, each with a structure of its own, and its instances.

    Parameters
    ----------
    triangles : InstancedTriangles
    objects : sequence of Structure
        One for each of the triangles' objects.
    options : StructureOptions
        Of the objects' structures.

    Attributes
    ----------
    objects : tuple of Structure
    trees : TopTrees
        Over the instances.
    """

    make_searches = staticmethod(instance_searches)
    triangles: InstancedTriangles  # type: ignore[assignment]
    _name: str  # of the objects' structures
    _of_primitives: type[InstancedStructure]
    _of_float64: type[InstancedStructure]

    def __init__(
        self, triangles: InstancedTriangles, objects: Sequence[Structure], options: StructureOptions
    ) -> None:
        started = time.perf_counter()
        self.triangles, self.objects, self.options = triangles, tuple(objects), options
        boxes = world_frame(triangles)
        self.frame = SceneFrame.of(boxes)
        self.trees = trees = self._trees(boxes)
        if len(trees.nodes) == 0:
            self.many_ray_kernels = {}
        order = trees.order
        leaves = instance_records(triangles, order)
        self.arrays = {
            "nodes": trees.nodes,
            "leaves": leaves,
            "objects": object_records(self.objects),
            "trees": _tree_records(trees, leaves),
        }
        at = {n: np.uint64(a.ctypes.data if len(a) else 0) for n, a in self.arrays.items()}
        shared = at["trees"] + np.uint64((len(self.arrays["trees"]) - 1) * TREE.itemsize)
        worst = triangles.instances.conditions[order].max(initial=1.0)
        far_unit = np.float64(FAR_UNIT * worst / float(PAD))
        self.view = TopAddresses(
            at["trees"],
            shared,
            at["leaves"],
            at["objects"],
            np.uint64(len(order)),
            np.uint64(0),
            far_unit,
        )
        self.report = BuildReport(
            seconds=time.perf_counter() - started + sum(one.report.seconds for one in self.objects),
            byte_count=sum(array.nbytes for array in self.arrays.values())
            + sum(one.report.byte_count for one in self.objects),
        )

    @classmethod
    def build(
        cls,
        triangles: InstancedTriangles,
        options: StructureOptions,
        *,
        progress: Progress | None = None,
    ) -> InstancedStructure:
        """Build the structures of a scene's objects, and the tree over their instances.

        Parameters
        ----------
        triangles : InstancedTriangles
        options : StructureOptions
        progress : callable, optional
            Called with (triangles placed, triangles).
        """
        objects, placed = [], 0
        for one in triangles.objects:
            part = part_of(progress, placed, len(one), len(triangles))
            objects.append(builder_for(cls._name, one)(one, options, progress=part))
            placed += len(one)
        made = cls._of_primitives if triangles.has_primitives else cls
        made = cls._of_float64 if triangles.number_type is np.float64 else made
        return made(triangles, objects, options)

    def _trees(self, boxes: Triangles) -> TopTrees:
        """The trees over the boxes."""
        ends = np.array([[0, 0, 0], [0, len(boxes.prim_ids), len(boxes.prim_ids)]])
        return TopTrees(_NO_NODES, boxes.prim_ids, *ends)

    def view_for(
        self,
        query: Query,  # noqa: ARG002
        rays: RayBatch,
        sink: Sink,  # noqa: ARG002
    ) -> TopAddresses:
        """The view for rays that have worlds."""
        if rays.worlds is None:
            return self.view
        return self.view._replace(worlds=np.uint64(rays.worlds.ctypes.data))

    @cached_property
    def placed(self) -> NDArray[np.void]:
        """The `PlacedRecord` of each leaf."""
        return placed_records(self.triangles, self.objects, self.trees.order, self.frame.scale)

    @property
    def point_view(self) -> PlacedInstances:
        """The instances for points, made once."""
        return placed_view(self.trees.nodes, self.placed)

    def around_calls(
        self, points: NDArray[np.float64], numbers: NDArray[np.float64]
    ) -> Calls | None:
        """See `Structure.around_calls`: each instance, for the points in its box."""
        held = self.triangles
        low, high, _ = held.boxes(OBJECT_MARGIN)
        ids = held.instances.object_ids.tolist()
        has_spheres = [one.part_counts[2] > 0 for one in held.objects]
        chosen = [k for k, object_id in enumerate(ids) if has_spheres[object_id]]

        def count(begin: int, end: int) -> None:
            some = points[begin:end]
            for k in chosen:
                rows = np.flatnonzero(((some >= low[k]) & (some <= high[k])).all(axis=1))
                inverse, found = held.instances.inverses[k], np.zeros(len(rows))
                own = np.ascontiguousarray(some[rows] @ inverse[:, :3].T + inverse[:, 3])
                calls: Any = self.objects[ids[k]].around_calls(own, found)
                calls[0](0, len(rows), *calls[1])
                numbers[begin + rows] += found

        return (count, ()) if chosen else None

    def moved(self, triangles: InstancedTriangles) -> InstancedStructure:
        """The same objects, with instances elsewhere."""
        moved = type(self)(triangles, self.objects, self.options)
        moved.kernel_times = self.kernel_times
        return moved

    @property
    def nested(self) -> Nested:
        """The objects' arrays, to which records point."""
        objects = tuple(array for one in self.objects for array in one.arrays.values())
        fields = {"objects": OBJECT_ADDRESSES, "trees": TREE.names or ()}
        return Nested(objects, fields, ("shared",))

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the objects; addresses are those of the copy's own arrays."""
        return type(self), (self.triangles, self.objects, self.options)

    def __deepcopy__(self, memo: dict[int, Any]) -> InstancedStructure:
        """A copy that shares the objects, which never change."""
        return type(self)(self.triangles, self.objects, self.options)

    def quality(self) -> dict[str, float]:
        """Numbers of objects and instances."""
        counts = len(self.objects), len(self.triangles.instances)
        return dict(zip(("objects", "instances"), map(float, counts), strict=True))


class InstancedBvh(InstancedStructure):
    """A BVH over instances, and one for each object."""

    _name = "bvh"
    traverse = staticmethod(traverse_top)
    point_loop = staticmethod(find_in_trees)
    stack_bytes = 2 * STACK_BYTES
    many_ray_kernels: Mapping[Kind, BatchKernels] = BATCH_KERNELS

    def _trees(self, boxes: Triangles) -> TopTrees:
        return TopTrees.of(boxes, self.triangles.instances)


class PlacedPrimitivesBvh(InstancedBvh):
    """The same where objects have spheres or height fields: rays are traced one by one."""

    traverse = staticmethod(traverse_top_primitives)
    stack_bytes = STACK_BYTES + PRIMITIVE_BYTES
    many_ray_kernels: Mapping[Kind, BatchKernels] = MappingProxyType({})


class InstancedBrute(InstancedStructure):
    """Every instance, and every triangle of its object."""

    _name = "brute"
    traverse = staticmethod(traverse_all)
    point_loop = staticmethod(find_among_all)
    point_search = AMONG_ALL

    @property
    def tests_per_ray(self) -> int:
        """All instances, and the triangles of each."""
        return int(self.triangles.first_ids[-1]) + len(self.triangles.instances)


class PlacedPrimitivesBrute(InstancedBrute):
    """The same where objects have spheres or height fields."""

    traverse = staticmethod(traverse_all_primitives)
    stack_bytes = PRIMITIVE_BYTES


class PlacedFloat64Bvh(InstancedBvh):
    """The same where objects are in float64."""

    precision = "float64"
    ray_batch = Float64Rays
    make_searches = staticmethod(float64_instance_searches)
    traverse = staticmethod(traverse_top_float64)
    stack_bytes = MEMORY_BYTES
    many_ray_kernels: Mapping[Kind, BatchKernels] = MappingProxyType({})


class PlacedFloat64Brute(InstancedBrute):
    """The same where objects are in float64."""

    precision = "float64"
    ray_batch = Float64Rays
    make_searches = staticmethod(float64_instance_searches)
    traverse = staticmethod(traverse_all_float64)
    stack_bytes = MEMORY_BYTES


InstancedBvh._of_float64, InstancedBrute._of_float64 = PlacedFloat64Bvh, PlacedFloat64Brute
InstancedBvh._of_primitives = PlacedPrimitivesBvh
InstancedBrute._of_primitives = PlacedPrimitivesBrute


def _tree_records(trees: TopTrees, leaves: NDArray[np.void]) -> NDArray[np.void]:
    """The record of each world's tree, and that of all worlds."""
    records = np.zeros(len(trees.first_nodes) - 1, TREE)
    has_nodes = np.diff(trees.first_nodes) > 0
    records["nodes"] = trees.nodes.ctypes.data + NODE_BYTES * trees.first_nodes[:-1]
    records["nodes"][~has_nodes] = 0
    records["leaves"] = leaves.ctypes.data + INSTANCE_BYTES * trees.first_leaves[:-1]
    return records


#: What builds them, by name.
STRUCTURES = {"bvh": InstancedBvh.build, "brute": InstancedBrute.build}
