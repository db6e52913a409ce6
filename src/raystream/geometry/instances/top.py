"""The tree over the instances of a scene: boxes that hold every hit of an instance.

A ray is tested in object space, with float32 numbers there. The boxes are tested in world space,
with a ray that is rounded in another way. They are grown by a bound of all that the two may differ
by, so that the tree leaves out no instance in which the ray finds a hit.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.instanced_triangles import InstancedTriangles
from raystream.core.instances import Instances
from raystream.core.triangles import Triangles, local_frame
from raystream.geometry.instances.grouped_trees import grouped_trees
from raystream.kernels.aligned import aligned_array
from raystream.structures.bvh.build import build_arrays, triangles_of_boxes
from raystream.structures.bvh.layout import NODE_FLOATS

#: In object space a hit is within the padding of its triangle's box: `kernels.ray.PAD` of the sum
#: of the object's and the origin's largest coordinates, where the origin's is at most
#: `kernels.ray.FAR` + 2 times the object's. Seven units of 2**-20, doubled.
OBJECT_MARGIN = 14.0 * 2.0**-20

#: In world space the ray's origin and direction are rounded to float32: over a way of at most 12
#: times the scene's largest coordinate, that moves it by less than 32 units of 2**-24 of that
#: coordinate, which is doubled; and t is rounded as it is reported, by no more.
WORLD_MARGIN = 2.0**-18

#: Moving points to object space and back rounds in float64: by a few units of 2**-52 of their
#: coordinates, times the transform's condition number.
FAR_UNIT = 2.0**-48


def _rows(points: NDArray[Any]) -> NDArray[Any]:
    """Coordinates by axis, of which NumPy finds the extremes fast."""
    return np.ascontiguousarray(points.T)


def largest_of(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """The largest of three numbers in each row; NumPy's max along a short axis is slow."""
    return np.maximum(np.maximum(rows[:, 0], rows[:, 1]), rows[:, 2])


def world_boxes(
    triangles: InstancedTriangles,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """Boxes that hold the hits of each instance, and which have none; see `world_frame`."""
    low, high, is_empty = triangles.boxes(OBJECT_MARGIN)
    shift = np.abs(triangles.instances.transforms[:, :, 3])
    reach = largest_of(np.maximum(np.abs(low), np.abs(high)) + shift)
    slack = (FAR_UNIT * triangles.instances.conditions * reach)[:, None]
    return low - slack, high + slack, is_empty


def world_frame(triangles: InstancedTriangles) -> Triangles:
    """The boxes of the instances as triangles that span them, in a local frame of the scene."""
    low, high, is_empty = world_boxes(triangles)
    if is_empty.all():
        center, scale = np.zeros(3), 1.0
    else:
        held_low, held_high = (
            (low, high) if not is_empty.any() else (low[~is_empty], high[~is_empty])
        )
        center, scale = local_frame(_rows(held_low).min(axis=1), _rows(held_high).max(axis=1))
    low, high = (low - center) * scale, (high - center) * scale
    low[is_empty] = high[is_empty] = 0.0
    margin = WORLD_MARGIN * max(np.abs(low).max(initial=0.0), np.abs(high).max(initial=0.0))
    boxes = np.stack([low - margin, high + margin], axis=1)
    return triangles_of_boxes(boxes, ~is_empty, center, scale)


class TopTrees(NamedTuple):
    """Trees over the boxes of instances, whose leaves have one instance each.

    Attributes
    ----------
    nodes : ndarray of shape (M, 64), float32
    order : ndarray of shape (N,), int32
        The instance of each leaf.
    first_nodes, first_leaves : ndarray of shape (W + 2,), int64
        Where the trees of the worlds begin, and the last one: that of all worlds. There is one
        world without any.
    """

    nodes: NDArray[np.float32]
    order: NDArray[np.int32]
    first_nodes: NDArray[np.int64]
    first_leaves: NDArray[np.int64]

    @classmethod
    def of(cls, boxes: Triangles, instances: Instances) -> TopTrees:
        """Build the trees over the boxes of `world_frame`."""
        given = instances.worlds
        if given is None or not instances.world_count:  # also if all instances are in all worlds
            tree = build_arrays(boxes, "balanced", 1)
            order = np.ascontiguousarray(tree.prim_ids[:, 0])
            ends = np.array([[0, len(tree.nodes)], [0, len(order)]])[:, [0, 1, 1]]
            return cls(tree.nodes, order, *ends)
        count, held = instances.world_count, boxes.prim_ids
        inside, shared = held[given[held] >= 0], held[given[held] < 0]
        corners, worlds = boxes.corners, given[inside].astype(np.int64)
        grouped = grouped_trees(corners[inside, 0], corners[inside, 1], worlds, count)
        common = build_arrays(_some(boxes, shared), "balanced", 1)
        nodes = aligned_array(len(grouped.nodes) + len(common.nodes), NODE_FLOATS)
        nodes[: len(grouped.nodes)], nodes[len(grouped.nodes) :] = grouped.nodes, common.nodes
        order = np.concatenate([inside[grouped.order], shared[common.prim_ids[:, 0]]])
        return cls(
            nodes,
            order.astype(np.int32),
            np.append(grouped.first_nodes, len(nodes)),
            np.append(grouped.first_leaves, len(order)),
        )


def _some(boxes: Triangles, chosen: NDArray[np.int32]) -> Triangles:
    """A store of some of the boxes, in the same frame."""
    splits, solid = np.array([0, len(chosen)], np.int64), np.ones(len(chosen), np.bool_)
    return Triangles.from_solid(
        boxes.corners[chosen], splits, boxes.center, boxes.scale, solid, 0, boxes.bounds
    )
