"""The tree over the instances of a scene: boxes that hold every hit of an instance.

A ray is tested in object space, with float32 numbers there. The boxes are tested in world space,
with a ray that is rounded in another way. They are grown by a bound of all that the two may differ
by, so that the tree leaves out no instance in which the ray finds a hit.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from raystream.core.instanced_triangles import InstancedTriangles
from raystream.core.triangles import Triangles, local_frame
from raystream.structures.bvh.build import build_arrays
from raystream.structures.bvh.layout import BvhArrays

__all__ = ["FAR_UNIT", "build_top", "condition_numbers", "world_frame"]

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


def condition_numbers(triangles: InstancedTriangles) -> NDArray[np.float64]:
    """How much each instance's transform amplifies rounding errors, shape (K,), at least 1."""
    instances = triangles.instances
    norms = []
    for matrices in (instances.transforms, instances.inverses):
        rows = np.abs(matrices[:, :, 0]) + np.abs(matrices[:, :, 1]) + np.abs(matrices[:, :, 2])
        norms.append(largest_of(rows))
    product: NDArray[np.float64] = norms[0] * norms[1]
    return product


def largest_of(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """The largest of three numbers in each row; NumPy's max along a short axis is slow."""
    result: NDArray[np.float64] = np.maximum(np.maximum(rows[:, 0], rows[:, 1]), rows[:, 2])
    return result


def world_boxes(
    triangles: InstancedTriangles, conditions: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """Boxes that hold the hits of each instance, and which have none; see `world_frame`."""
    low, high, is_empty = triangles.boxes(OBJECT_MARGIN)
    shift = np.abs(triangles.instances.transforms[:, :, 3])
    reach = largest_of(np.maximum(np.abs(low), np.abs(high)) + shift)
    slack = (FAR_UNIT * conditions * reach)[:, None]
    return low - slack, high + slack, is_empty


def world_frame(triangles: InstancedTriangles, conditions: NDArray[np.float64]) -> Triangles:
    """The boxes of the instances as triangles that span them, in a local frame of the scene.

    A triangle with two of its vertices at a box's low and high corner has that box. For
    `conditions`, see `condition_numbers`.
    """
    low, high, is_empty = world_boxes(triangles, conditions)
    if is_empty.all():
        center, scale = np.zeros(3), 1.0
    else:
        held_low, held_high = (
            (low, high) if not is_empty.any() else (low[~is_empty], high[~is_empty])
        )
        center, scale = local_frame(held_low.T.min(axis=1), held_high.T.max(axis=1))
    low, high = (low - center) * scale, (high - center) * scale
    low[is_empty] = high[is_empty] = 0.0
    margin = WORLD_MARGIN * max(np.abs(low).max(initial=0.0), np.abs(high).max(initial=0.0))
    corners = np.empty((len(low), 3, 3), np.float32)
    corners[:, 0] = np.nextafter((low - margin).astype(np.float32), np.float32(-np.inf))
    corners[:, 1] = np.nextafter((high + margin).astype(np.float32), np.float32(np.inf))
    corners[:, 2] = corners[:, 0]
    held = corners[~is_empty]
    bounds = np.zeros((2, 3), np.float32)
    if len(held):
        bounds[:] = held[:, 0].T.min(axis=1), held[:, 1].T.max(axis=1)
    splits = np.array([0, len(low)], np.int64)
    return Triangles.from_solid(corners, splits, center, scale, ~is_empty, 0, bounds)


def build_top(boxes: Triangles) -> tuple[BvhArrays, NDArray[np.int32]]:
    """Build the tree over the boxes of `world_frame`.

    Returns
    -------
    tree : BvhArrays
        Each leaf has one block, with one instance.
    order : ndarray of shape (B,), int32
        The instance of each block.
    """
    tree = build_arrays(boxes, "balanced", 1)
    return tree, np.ascontiguousarray(tree.prim_ids[:, 0])
