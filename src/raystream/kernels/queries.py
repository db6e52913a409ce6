"""The four queries as loops over rays, around any structure's traversal."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.jit.cpu import device, kernel
from raystream.kernels.collect import HitArrays, sort_hits
from raystream.kernels.ray import set_up

__all__ = ["UNLIMITED", "LocalRays", "RayQueries", "TraversalStack", "ray_queries"]

_INF = np.float32(np.inf)
_ZERO = np.float32(0.0)
_MISS = np.int32(-1)

#: A limit for `count_hits` that no scene reaches.
UNLIMITED = 2**62


class LocalRays(NamedTuple):
    """Rays in the local frame of a scene, ready to trace.

    Attributes
    ----------
    origins, directions : ndarray of shape (N, 3), float32
        The largest component of each direction is in [1, 2).
    t_min, t_max : ndarray of shape (N,), float32
        Closed interval in local direction lengths; empty for a ray that cannot hit.
    """

    origins: NDArray[np.float32]
    directions: NDArray[np.float32]
    t_min: NDArray[np.float32]
    t_max: NDArray[np.float32]

    @classmethod
    def empty(cls, count: int) -> LocalRays:
        """Make arrays for `count` rays, not initialised."""
        origins, directions = (np.empty((count, 3), np.float32) for _ in range(2))
        return cls(origins, directions, np.empty(count, np.float32), np.empty(count, np.float32))


class RayQueries(NamedTuple):
    """Compiled loops over the rays begin to end; all share one traversal.

    Attributes
    ----------
    first_hit : (begin, end, arrays, extreme, rays, out)
        Writes row i of `out` (HitArrays) for ray i.
    any_hit : (begin, end, arrays, extreme, rays, seen)
        Writes `seen`, of shape (N,), bool.
    count_hits : (begin, end, arrays, extreme, rays, surfaces, limit, counts)
        Writes `counts`, of shape (N,), int64: the number of hits, at most `limit`.
    multi_hit : (begin, end, arrays, extreme, rays, surfaces, splits, out)
        Writes the nearest splits[i + 1] - splits[i] hits of ray i, sorted, from row
        splits[i] of `out`.
    """

    first_hit: Callable[..., None]
    any_hit: Callable[..., None]
    count_hits: Callable[..., None]
    multi_hit: Callable[..., None]


class TraversalStack(NamedTuple):
    """Nodes still to be visited by one ray, with the distances at which it enters them.

    Attributes
    ----------
    node, leaf_count : ndarray of shape (S,), int32
    t_in : ndarray of shape (S,), float32
    """

    node: NDArray[np.int32]
    leaf_count: NDArray[np.int32]
    t_in: NDArray[np.float32]


@device
def _make_stack(size):
    return TraversalStack(
        np.empty(size, np.int32), np.empty(size, np.int32), np.empty(size, np.float32)
    )


@device
def _no_hits():
    return HitArrays(
        np.empty(0, np.float32),
        np.empty(0, np.float32),
        np.empty(0, np.float32),
        np.empty(0, np.int32),
    )


def ray_queries(traverse: Callable[..., Any], stack_size: int) -> RayQueries:
    """Make the queries of a structure.

    Parameters
    ----------
    traverse : device function
        ``traverse(arrays, ray, t_min, t_max, surfaces, keep, capacity, first, out, stack)``
        visits every triangle of `arrays` whose hit with `ray` may be wanted, gives it to
        `kernels.leaf.test_triangles`, and returns the number of hits kept or counted. It
        may stop once it has counted `capacity` of them.
    stack_size : int
        Entries of the stack that `traverse` is given; it is made once for many rays.

    Returns
    -------
    RayQueries
    """

    @kernel
    def first_hit(begin, end, arrays, extreme, rays, out):
        stack = _make_stack(stack_size)
        for i in range(np.uint64(begin), np.uint64(end)):
            ray = set_up(rays.origins[i], rays.directions[i], extreme)
            t_min, t_max = rays.t_min[i], rays.t_max[i]
            count = traverse(arrays, ray, t_min, t_max, False, True, 1, i, out, stack)
            if count == 0:
                out.t[i] = _INF
                out.u[i] = _ZERO
                out.v[i] = _ZERO
                out.prim_id[i] = _MISS

    @kernel
    def any_hit(begin, end, arrays, extreme, rays, seen):
        stack = _make_stack(stack_size)
        nowhere = _no_hits()
        for i in range(np.uint64(begin), np.uint64(end)):
            ray = set_up(rays.origins[i], rays.directions[i], extreme)
            t_min, t_max = rays.t_min[i], rays.t_max[i]
            count = traverse(
                arrays, ray, t_min, t_max, False, False, 1, np.uint64(0), nowhere, stack
            )
            seen[i] = count != 0

    @kernel
    def count_hits(begin, end, arrays, extreme, rays, surfaces, limit, counts):
        stack = _make_stack(stack_size)
        nowhere = _no_hits()
        for i in range(np.uint64(begin), np.uint64(end)):
            ray = set_up(rays.origins[i], rays.directions[i], extreme)
            t_min, t_max = rays.t_min[i], rays.t_max[i]
            counts[i] = traverse(
                arrays, ray, t_min, t_max, surfaces, False, limit, np.uint64(0), nowhere, stack
            )

    @kernel
    def multi_hit(begin, end, arrays, extreme, rays, surfaces, splits, out):
        stack = _make_stack(stack_size)
        for i in range(np.uint64(begin), np.uint64(end)):
            first = np.uint64(splits[i])
            capacity = splits[i + np.uint64(1)] - splits[i]
            if capacity == 0:
                continue
            ray = set_up(rays.origins[i], rays.directions[i], extreme)
            t_min, t_max = rays.t_min[i], rays.t_max[i]
            count = traverse(arrays, ray, t_min, t_max, surfaces, True, capacity, first, out, stack)
            sort_hits(out, first, count)

    return RayQueries(first_hit, any_hit, count_hits, multi_hit)
