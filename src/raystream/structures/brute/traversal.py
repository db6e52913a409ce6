"""Brute-force traversal: all triangles in order."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.jit.cpu import device
from raystream.kernels.leaf import test_triangles

__all__ = ["BruteArrays", "traverse"]


class BruteArrays(NamedTuple):
    """What the traversal reads.

    Attributes
    ----------
    corners : ndarray of shape (A, 3, 3), float32
    prim_ids : ndarray of shape (A,), int32
    """

    corners: NDArray[np.float32]
    prim_ids: NDArray[np.int32]


@device
def traverse(arrays, ray, t_min, t_max, surfaces, keep, capacity, first, out, stack, seen, tally):
    """Test every triangle; see `kernels.queries.ray_queries` for the arguments."""
    count = np.uint64(0)
    if t_min <= t_max:
        count, _ = test_triangles(
            ray,
            arrays.corners,
            arrays.prim_ids,
            np.uint64(0),
            np.uint64(len(arrays.prim_ids)),
            t_min,
            t_max,
            surfaces,
            keep,
            count,
            capacity,
            first,
            out,
            tally,
        )
    return count
