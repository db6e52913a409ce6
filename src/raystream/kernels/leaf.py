"""Testing a run of triangles and keeping or counting the hits: the leaf of every traversal."""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device
from raystream.kernels.collect import keep_hit
from raystream.kernels.tally import TESTS, add_to
from raystream.kernels.triangle import intersect

__all__ = ["test_triangles"]

_ONE = np.uint64(1)


@device
def test_triangles(
    ray,
    corners,
    prim_ids,
    begin,
    end,
    t_min,
    t_far,
    surfaces,
    keep,
    count,
    capacity,
    first,
    out,
    tally,
):
    """Test triangles begin to end against a ray.

    Parameters
    ----------
    ray : Ray
    corners, prim_ids : arrays of shape (A, 3, 3), float32, and (A,), int32
        The triangles, and their numbers in the scene.
    begin, end : int
        Rows of `corners`.
    t_min, t_far : float32
        Closed interval in which a hit is wanted.
    surfaces : bool
        The rule at edges and vertices, see `intersect`.
    keep : bool
        Keep the nearest hits in `out`, else only count them.
    count, capacity : uint64
        Hits so far, and how many are wanted at most.
    first, out : uint64, HitAddresses
        Where hits are kept.
    tally : uint64 or None
        See `kernels.tally`.

    Returns
    -------
    count : uint64
    t_far : float32
        Hits beyond are no longer wanted.
    """
    for i in range(begin, end):
        add_to(tally, TESTS, _ONE)
        hit, t, u, v = intersect(ray, corners, i, surfaces)
        # Written so that a NaN would fail.
        if hit and t >= t_min and t <= t_far:
            if keep:
                count, t_far = keep_hit(out, first, count, capacity, t, u, v, prim_ids[i], t_far)
            else:
                count += _ONE
                if count == capacity:
                    break
    return count, t_far
