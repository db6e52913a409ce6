"""Locating the sectors in which rays start.

A ray's sector is found from its bin, whose low corner's sector is known, or from a nearby sector,
such as that of the hit that it leaves. Both end with the
same walk, which is exact from any start; so they find the same sector, and differ in
the length of the walk.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.jit.cpu import device, kernel
from raystream.jit.threads import parallel_for
from raystream.kernels.local_frame import LocalRays
from raystream.kernels.ray import prepare_ray
from raystream.structures.graph.steps import (
    MAX_WALK,
    GraphAddresses,
    clip_to_scene,
    sector_ray,
    start_sector,
    walk_to,
)

#: Rays per call of the kernel.
_CHUNK = 1 << 13

_LIMIT = np.uint64(MAX_WALK)
_ROW = np.uint64(4)  # a row's 16 bytes, as a shift
_NOWHERE = np.int64(-1)


class StartSectors(NamedTuple):
    """The sectors of rays.

    Attributes
    ----------
    rows : ndarray of shape (N,), int64
        Of `layout.GraphArrays`; -1 for a ray outside all of them.
    step_counts : ndarray of shape (N,), int32
        Sectors left on the way there.
    """

    rows: NDArray[np.int64]
    step_counts: NDArray[np.int32]


def find_sectors(
    graph: GraphAddresses,
    max_coordinate: np.float32,
    rays: LocalRays,
    t: NDArray[np.float32] | None = None,
    near: NDArray[np.int64] | None = None,
) -> StartSectors:
    """Find the sectors in which rays are.

    Parameters
    ----------
    graph : GraphAddresses
    max_coordinate : float32
        See `kernels.ray.prepare_ray`.
    rays : LocalRays
    t : ndarray of shape (N,), float32, optional
        Distances along the rays [default: where they enter the scene's box, or t_min].
    near : ndarray of shape (N,), int64, optional
        Rows of sectors to walk from; -1 for none. Without them, and where a walk would be longer
        than `MAX_WALK`, walks start from the bins.

    Returns
    -------
    StartSectors
    """
    count = len(rays.t_min)
    at = np.full(count, np.nan, np.float32) if t is None else t
    known = np.full(count, -1, np.int64) if near is None else near
    found = StartSectors(np.empty(count, np.int64), np.empty(count, np.int32))

    def body(begin: int, end: int) -> None:
        _find(begin, end, graph, max_coordinate, rays, at, known, found)

    parallel_for(body, count, _CHUNK)
    return found


@kernel
def _find(begin, end, graph, max_coordinate, rays, t, near, found):
    o, d = rays.origins, rays.directions
    for i in range(np.uint64(begin), np.uint64(end)):
        found.rows[i] = _NOWHERE
        found.step_counts[i] = 0
        ray = prepare_ray(o[i], d[i], max_coordinate)
        is_active, t_in, _ = clip_to_scene(graph, ray, rays.t_min[i], rays.t_max[i])
        if not is_active:
            continue
        at = t[i] if t[i] == t[i] else t_in
        sector, step_count = _walk(graph, sector_ray(ray), ray, near[i], at)
        found.rows[i] = np.int64((sector - graph.rows) >> _ROW)
        found.step_counts[i] = np.int32(step_count)


@device
def _walk(graph, line, ray, near, t):
    """Walk from the nearby sector if there is one, else from the bins."""
    if near < np.int64(0):
        return start_sector(graph, line, ray, t)
    sector = graph.rows + (np.uint64(near) << _ROW)
    sector, step_count = walk_to(graph, line, sector, t, _LIMIT)
    if step_count != _LIMIT:
        return sector, step_count
    sector, more = start_sector(graph, line, ray, t)
    return sector, step_count + more
