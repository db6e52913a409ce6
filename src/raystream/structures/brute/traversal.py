"""Brute-force traversal: all triangles in order."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.jit.constants import INF_F32, ZERO_U64
from raystream.jit.cpu import device
from raystream.kernels.triangle_list import intersect_list


class BruteAddresses(NamedTuple):
    """The view of the traversal; the caller keeps the arrays alive.

    Attributes
    ----------
    references, corners : uint64
        Addresses of the prim_ids, int32, of the triangles that can be hit, and of the scene's
        corners, 9 float32 per triangle.
    triangle_count : uint64
        Number of triangles that can be hit.
    """

    references: np.uint64
    corners: np.uint64
    triangle_count: np.uint64


@device
def traverse(tree, ray, search, stack):
    """Test every triangle; see `kernels.queries.ray_queries` for the arguments."""
    if search.t_min <= search.t_far:
        search = intersect_list(
            tree.references,
            tree.corners,
            ZERO_U64,
            tree.triangle_count,
            ray,
            search,
            search.t_min,
            INF_F32,
        )
    return search
