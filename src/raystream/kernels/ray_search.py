"""One ray of a query: read where the caller has it, searched, and its hits written.

The loops over rays of the CPU (`kernels.queries`) and the threads of CUDA (`cuda.threads`) are made
of these functions.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from raystream.core.rays import RayStatus
from raystream.jit.cpu import device
from raystream.jit.simd import load, store
from raystream.kernels.collect import HitAddresses, sort_hits
from raystream.kernels.local_ray import SceneFrame, world_t
from raystream.kernels.ray import prepare_ray
from raystream.kernels.ray_source import RaySource, load_ray
from raystream.kernels.search import begin_search
from raystream.kernels.seen import SeenSet

__all__ = ["Goal", "RayScene", "finish_first", "finish_rows", "ray_search"]

_NONE = np.uint64(0)
_WORD = np.uint64(2)  # a number's four bytes, as a shift
_INF = np.float32(np.inf)
_ZERO = np.float32(0.0)
_MISS = np.int32(-1)
_VALID = np.uint8(RayStatus.VALID)


class RayScene(NamedTuple):
    """What all rays of a query share.

    Attributes
    ----------
    source : RaySource
    frame : SceneFrame
    arrays : NamedTuple
        The structure's arrays.
    stack : uint64
        Address of the memory that the traversal needs.
    status : uint64 or None
        Address of the first ray's status, a byte each; written for invalid rays only.
    """

    source: RaySource
    frame: SceneFrame
    arrays: Any
    stack: np.uint64
    status: np.uint64 | None


class Goal(NamedTuple):
    """What is wanted of one ray: see `kernels.search.Search`."""

    capacity: np.uint64
    hits: HitAddresses | None
    first_row: np.uint64
    surfaces: bool
    seen: SeenSet | None
    counters: np.uint64 | None


@device
def _note_status(at, i, status):
    if at is not None and status != _VALID:
        store(at + i, status)


def ray_search(traverse: Callable[..., Any]) -> Callable[..., Any]:
    """Make the search of one ray around a structure's traversal.

    Parameters
    ----------
    traverse : device function
        See `kernels.queries.ray_queries`.

    Returns
    -------
    device function
        ``search_ray(i, scene, goal) -> (search, ray)`` for ray i of a `RayScene` and a `Goal`: the
        search when it is over, and the `LocalRay`.
    """

    @device
    def search_ray(i, scene, goal):
        frame = scene.frame
        ray = load_ray(scene.source, i, frame)
        _note_status(scene.status, i, ray.status)
        local = prepare_ray(ray.ox, ray.oy, ray.oz, ray.dx, ray.dy, ray.dz, frame.max_coordinate)
        search = begin_search(
            ray.t_min,
            ray.t_max,
            goal.capacity,
            goal.hits,
            goal.first_row,
            goal.surfaces,
            goal.seen,
            goal.counters,
        )
        return traverse(scene.arrays, local, search, scene.stack), ray

    return search_ray


@device
def finish_first(out, i, count, ray):
    """Write a miss where ray i has no hit, else its hit's distance in world direction lengths.

    Parameters
    ----------
    out : ResultAddresses or HitAddresses
    i : uint64
    count : uint64
        Hits that were found.
    ray : LocalRay
    """
    at = i << _WORD
    if count == _NONE:
        store(out.t + at, _INF)
        store(out.u + at, _ZERO)
        store(out.v + at, _ZERO)
        store(out.prim_id + at, _MISS)
    else:
        store(out.t + at, world_t(load(np.float32, out.t + at), ray.factor, ray.offset))


@device
def finish_rows(hits, first, count, ray, sorts):
    """Sort a ray's hits by t, then prim_id, if `sorts`; distances in world direction lengths."""
    if sorts:
        sort_hits(hits, first, count)
    for row in range(first, first + count):
        at = hits.t + (row << _WORD)
        store(at, world_t(load(np.float32, at), ray.factor, ray.offset))
