"""Brute-force traversal: all triangles in order."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.jit.cpu import device
from raystream.jit.intrinsics import corners_at, int32_at
from raystream.kernels.leaf import test_triangles

__all__ = ["BruteAddresses", "traverse"]


class BruteAddresses(NamedTuple):
    """What the traversal reads; whoever calls it keeps the arrays alive.

    Attributes
    ----------
    corners, prim_ids : uint64
        Addresses of the triangles' vertices, 9 float32 each, and numbers, int32.
    triangle_count : uint64
        How many there are.
    """

    corners: np.uint64
    prim_ids: np.uint64
    triangle_count: np.uint64


@device
def traverse(tree, ray, search, stack):
    """Test every triangle; see `kernels.queries.ray_queries` for the arguments."""
    if search.t_min <= search.t_far:
        search = test_triangles(
            ray,
            corners_at(tree.corners),
            int32_at(tree.prim_ids, tree.triangle_count),
            np.uint64(0),
            tree.triangle_count,
            search,
        )
    return search
