"""Testing a run of triangles, one after another: the leaf of brute force."""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device
from raystream.kernels.search import is_full, offer
from raystream.kernels.tally import TESTS, add_to
from raystream.kernels.triangle import intersect

__all__ = ["test_triangles"]

_ONE = np.uint64(1)


@device
def test_triangles(ray, corners, prim_ids, begin, end, search):
    """Test triangles begin to end against a ray.

    Parameters
    ----------
    ray : Ray
    corners, prim_ids : arrays of shape (A, 3, 3), float32, and (A,), int32
        The triangles, and their numbers in the scene.
    begin, end : int
        Rows of `corners`.
    search : Search

    Returns
    -------
    Search
    """
    for i in range(begin, end):
        add_to(search.counters, TESTS, _ONE)
        hit, t, u, v = intersect(ray, corners, i, search.surfaces)
        # Written so that a NaN would fail.
        if hit and t >= search.t_min and t <= search.t_far:
            search = offer(search, t, u, v, prim_ids[i])
            if is_full(search):
                break
    return search
