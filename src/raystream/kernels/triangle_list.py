"""The test of a list of triangles: a cell of a grid, or a whole scene."""

from __future__ import annotations

import numpy as np

from raystream.jit.constants import ONE_U64, SHIFT_32
from raystream.jit.cpu import device
from raystream.jit.intrinsics import corners_at
from raystream.jit.simd import load
from raystream.kernels.search import is_full, offer
from raystream.kernels.tally import TESTS, add_to
from raystream.kernels.triangle import intersect


@device
def intersect_list(references, corners, begin, end, ray, search, t_in, t_out):
    """Test the triangles of a list against a ray, and offer their hits to a search.

    Parameters
    ----------
    references, corners : uint64
        Addresses of the lists (`prim_id`, int32), and of the corners of all triangles of the
        scene (9 float32 each).
    begin, end : uint64
        The list's references.
    ray : Ray
    search : Search
    t_in, t_out : float32
        A hit counts where t_in <= t < t_out: the part of the ray in the cell.

    Returns
    -------
    Search
    """
    at, stop = references + (begin << SHIFT_32), references + (end << SHIFT_32)
    triangles = corners_at(corners)
    while at != stop:
        add_to(search.counters, TESTS, ONE_U64)
        prim_id = load(np.int32, at)
        at += np.uint64(4)
        hit, t, u, v = intersect(ray, triangles, np.uint64(prim_id), search.goal.surfaces)
        # Written so that a NaN would fail.
        if hit and t >= t_in and t < t_out and t <= search.t_far:
            search = offer(search, t, u, v, prim_id)
            if is_full(search):
                break
    return search
