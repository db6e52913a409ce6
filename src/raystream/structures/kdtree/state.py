"""The state of a search in a kd-tree, and the ray as it sees it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.jit.cpu import device
from raystream.structures.kdtree.options import MAX_DEPTH

#: How a search continues after a leaf.
STACK, RESTART, BACKTRACK, SHORT_STACK = np.arange(4, dtype=np.uint64)

#: Bytes of a stack: a node and the end of its interval for each split on a path.
STACK_BYTES = 8 * (MAX_DEPTH + 1)

#: Bytes of a short stack: the restart node, and a ring of `traversals.short_stack.PLACES`.
SHORT_STACK_BYTES = 40

_HALF = np.float32(0.5)


class SplitRay(NamedTuple):
    """A ray as the steps use it: the constants of its distances to split planes.

    Attributes
    ----------
    inv_x, inv_y, inv_z, middle_x, middle_y, middle_z : float32
    """

    inv_x: np.float32
    inv_y: np.float32
    inv_z: np.float32
    middle_x: np.float32
    middle_y: np.float32
    middle_z: np.float32


class KdState(NamedTuple):
    """The state of a ray's search.

    Attributes
    ----------
    node : uint64
        See `nodes`.
    t_in, t_out : float32
        The part of the ray in the node: t_in <= t < t_out.
    t_end : float32
        End of the search: the next float32 after the last t wanted.
    top : uint64
        Bytes on the stack; for a short one see `traversals.short_stack`.
    is_backtracking : bool
        The search continues above the node: `backtrack` is next.
    """

    node: np.uint64
    t_in: np.float32
    t_out: np.float32
    t_end: np.float32
    top: np.uint64
    is_backtracking: bool


@device
def split_ray(ray):
    """A `kernels.ray.Ray` as a `SplitRay`.

    ``middle`` is the mean of the slab constants of both paddings: that of an unpadded plane, to
    within two roundings.
    """
    return SplitRay(
        ray.inv_x,
        ray.inv_y,
        ray.inv_z,
        (ray.near_x + ray.far_x) * _HALF,
        (ray.near_y + ray.far_y) * _HALF,
        (ray.near_z + ray.far_z) * _HALF,
    )
