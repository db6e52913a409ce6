"""PrimitiveStructure: trees over the triangles, height fields, spheres and shapes of a scene."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.primitives import Primitives
from raystream.geometry.fields.levels import field_levels
from raystream.geometry.primitives.around import count_around
from raystream.geometry.primitives.batches import batch_kernels
from raystream.geometry.primitives.nearest import AMONG_ALL, find_among_all, find_in_trees
from raystream.geometry.primitives.records import (
    FIELD_ADDRESSES,
    SPHERES_PER_BLOCK,
    PrimitiveAddresses,
    field_records,
    shape_leaves,
    sphere_blocks,
)
from raystream.geometry.primitives.traversal import (
    STACK_BYTES,
    primitive_searches,
    traverse_all,
    traverse_trees,
)
from raystream.geometry.shapes.shape import reach_of
from raystream.jit.threads import Progress, part_of
from raystream.kernels.ray import SceneFrame
from raystream.structures.base import BuildReport, Nested, Structure
from raystream.structures.batch_kernels import Calls
from raystream.structures.brute.structure import BruteStructure
from raystream.structures.bvh.build import build_arrays, triangles_of_boxes
from raystream.structures.bvh.structure import BvhStructure

#: Boxes of the spheres' tree are grown by this part of (radius + centre's coordinate): twice
#: `geometry.spheres.sphere.BOX_GROWTH`, so that they hold the spheres' own boxes
#: however these round.
_BOX_GROWTH = 2.0**-21


class PrimitiveStructure(Structure):
    """Triangles in a structure of their own, and all other primitives beside it.

    Parameters
    ----------
    triangles : Primitives
    options : StructureOptions
    progress : callable, optional
        Called with (triangles and spheres placed, triangles and spheres).

    Attributes
    ----------
    levels : list of Levels
        The trees of the height fields.
    """

    make_searches = staticmethod(primitive_searches)
    triangles: Primitives  # type: ignore[assignment]
    _kind: type[Structure]

    def __init__(self, triangles: Any, options: Any, *, progress: Progress | None = None) -> None:
        started = time.perf_counter()
        self.triangles, self.options = triangles, options
        self.frame = SceneFrame.of(triangles)
        count = len(triangles.triangles)
        total = count + len(triangles.spheres)
        self._inner = self._kind(
            triangles.triangles, options, progress=part_of(progress, 0, count, total)
        )
        local = triangles.local_fields
        self.levels = [field_levels(one) for one in local]
        field_nodes, field_rows = self._tree_over(_field_boxes(triangles), 1, None)
        fields = triangles.fields, local, self.levels, triangles.first_fields
        sphere_boxes, own = _sphere_boxes(triangles), part_of(progress, count, total - count, total)
        sphere_nodes, sphere_rows = self._tree_over(sphere_boxes, SPHERES_PER_BLOCK, own)
        first = int(triangles.first_fields[-1])
        shape_nodes, shape_rows = self._tree_over(_shape_boxes(triangles), 1, None)
        self.arrays = {
            **self._inner.arrays,
            "field_nodes": field_nodes,
            "fields": field_records(*fields, field_rows[:, 0].tolist()),
            "sphere_nodes": sphere_nodes,
            "sphere_blocks": sphere_blocks(triangles.spheres, sphere_rows, first),
            "shape_nodes": shape_nodes,
            "shapes": shape_leaves(triangles, shape_rows[:, 0]),
        }
        self.view = self._make_addresses()
        field_bytes = sum(
            a.byte_count + t.ranges.nbytes for a, t in zip(local, self.levels, strict=True)
        )
        self.report = BuildReport(
            seconds=time.perf_counter() - started,
            byte_count=sum(array.nbytes for array in self.arrays.values()) + field_bytes,
        )

    def _make_addresses(self) -> PrimitiveAddresses:
        inner = self._inner.view._asdict()
        memory = self.arrays
        own = {n: np.uint64(memory[n].ctypes.data if len(memory[n]) else 0) for n in _OWN}
        counts = {
            "field_count": np.uint64(len(memory["fields"])),
            "block_count": np.uint64(len(memory["sphere_blocks"])),
            "shape_count": np.uint64(len(memory["shapes"])),
        }
        nothing = dict.fromkeys(PrimitiveAddresses._fields, np.uint64(0))
        return PrimitiveAddresses(**{**nothing, **inner, **own, **counts})

    def _tree_over(
        self,
        boxes: NDArray[np.float64],
        leaf_size: int,
        progress: Progress | None,  # noqa: ARG002
    ) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
        """Nodes over boxes of primitives, and the primitives of each leaf, -1 for unused lanes.

        Boxes have shape (N, 2, 3), in the scene's local frame.
        """
        count = len(boxes)
        rows = np.full(-(-count // leaf_size) * leaf_size, -1, np.int32)
        rows[:count] = np.arange(count)
        return np.zeros((0, 64), np.float32), rows.reshape(-1, leaf_size)

    def around_calls(
        self, points: NDArray[np.float64], numbers: NDArray[np.float64]
    ) -> Calls | None:
        """The calls that count spheres and shapes around points."""
        if not len(self.triangles.spheres) and not self.triangles.shape_count:
            return None
        return count_around, (points, self.view, self.frame, numbers)

    def raise_faults(self) -> None:
        """See `Structure.raise_faults`."""
        for one in self.triangles.shapes:
            one.functions.raise_faults()

    def checked(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """See `Structure.checked`."""

        def call(*arguments: Any) -> Any:
            found = function(*arguments)
            self.raise_faults()
            return found

        return call if self.triangles.shapes else function

    @property
    def nested(self) -> Nested:
        """The height fields' arrays, to which records point."""
        fields = (array for one in self.triangles.local_fields for array in one)
        levels = (array for one in self.levels for array in one)
        return Nested((*fields, *levels), {"fields": FIELD_ADDRESSES})

    def quality(self) -> dict[str, float]:
        """Numbers of primitives."""
        held = self.triangles
        fields = held.first_fields[-1] - held.first_fields[0]
        counts = len(held.triangles), fields, len(held.spheres)
        names = "triangles of meshes", "triangles of height fields", "spheres"
        return dict(zip(names, map(float, counts), strict=True))


#: Arrays besides those of the triangles' structure.
_OWN = ("field_nodes", "fields", "sphere_nodes", "sphere_blocks", "shape_nodes", "shapes")


class PrimitiveBvh(PrimitiveStructure):
    """A BVH of the triangles, one of the spheres, and a tree over each height field."""

    _kind = BvhStructure
    traverse = staticmethod(traverse_trees)
    point_loop = staticmethod(find_in_trees)
    stack_bytes = STACK_BYTES

    def __init__(self, triangles: Any, options: Any, *, progress: Progress | None = None) -> None:
        super().__init__(triangles, options, progress=progress)
        own = self.arrays["sphere_nodes"], self.arrays["sphere_blocks"]
        sides = [(len(one.x) - 1, len(one.y) - 1) for one in self.triangles.fields]
        only = sides[0] if len(sides) == 1 else None
        self.many_ray_kernels = batch_kernels(sum(one.nbytes for one in own), only)

    def _tree_over(
        self, boxes: NDArray[np.float64], leaf_size: int, progress: Progress | None
    ) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
        frame = self.triangles.center, self.triangles.scale
        spanning = triangles_of_boxes(boxes, np.ones(len(boxes), np.bool_), *frame)
        tree = build_arrays(spanning, "balanced", leaf_size, progress)
        return tree.nodes, np.ascontiguousarray(tree.prim_ids[:, :leaf_size])


class PrimitiveBrute(PrimitiveStructure):
    """Every primitive, one after another."""

    _kind = BruteStructure
    traverse = staticmethod(traverse_all)
    point_loop = staticmethod(find_among_all)
    point_search = AMONG_ALL
    stack_bytes = STACK_BYTES

    @property
    def tests_per_ray(self) -> int:
        """All primitives."""
        return len(self.triangles)


def _field_boxes(primitives: Primitives) -> NDArray[np.float64]:
    bounds = np.array([one.bounds for one in primitives.fields]).reshape(-1, 2, 3)
    return (bounds - primitives.center) * primitives.scale


def _sphere_boxes(primitives: Primitives) -> NDArray[np.float64]:
    spheres = primitives.spheres
    centers = (spheres.centers - primitives.center) * primitives.scale
    radii = (spheres.radii * primitives.scale)[:, None]
    reach = radii + (np.abs(centers) + radii) * _BOX_GROWTH
    return np.stack([centers - reach, centers + reach], axis=1)


def _shape_boxes(primitives: Primitives) -> NDArray[np.float64]:
    boxes = np.concatenate([np.zeros((0, 2, 3)), *(one.bounds for one in primitives.shapes)])
    low, high = ((boxes - primitives.center) * primitives.scale).swapaxes(0, 1)
    reach = reach_of((high - low).max(axis=1, initial=0.0), np.abs([low, high]).max(axis=(0, 2)))
    # Twice as much: they hold the shapes' own boxes however these round.
    reach = 2.0 * reach[:, None]
    return np.stack([low - reach, high + reach], axis=1)


#: By name.
STRUCTURES = {"bvh": PrimitiveBvh, "brute": PrimitiveBrute}
