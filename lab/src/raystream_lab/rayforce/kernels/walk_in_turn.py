"""Walks to start sectors as one thread of the engine takes them: ray after ray."""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import kernel
from raystream.jit.simd import address
from raystream.kernels.ray import prepare_ray
from raystream.structures.graph.steps import (
    clip_to_scene,
    sector_number,
    sector_ray,
    start_sector_cached,
)


@kernel
def walk_in_turn(begin, end, graph, max_coordinate, rays, last, sectors, steps):
    """Find the start sectors of rays begin to end, from bins and the ray before.

    Parameters
    ----------
    begin, end : int
    graph : GraphAddresses
    max_coordinate : float32
    rays : LocalRays
    last : ndarray of shape (2,), uint64
        What `start_sector_cached` keeps; zeros before the first ray.
    sectors : ndarray of shape (N,), int64
        Written: their numbers, -1 outside the scene.
    steps : ndarray of shape (N,), int32
        Written: sectors left on the way.
    """
    o, d = rays.origins, rays.directions
    for i in range(np.uint64(begin), np.uint64(end)):
        sectors[i], steps[i] = -1, 0
        ray = prepare_ray(o[i], d[i], max_coordinate)
        is_active, t_in, _ = clip_to_scene(graph, ray, rays.t_min[i], rays.t_max[i])
        if is_active:
            at = address(last)
            sector, count = start_sector_cached(graph, sector_ray(ray), ray, t_in, at)
            sectors[i] = np.int64(sector_number(graph, sector))
            steps[i] = np.int32(count)
