"""Walks of rays to the sectors in which they start, by route."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.jit.cpu import kernel
from raystream.jit.simd import address
from raystream.kernels.local_frame import LocalRays
from raystream.kernels.ray import prepare_ray
from raystream.structures.graph.steps import (
    MAX_WALK,
    clip_to_scene,
    sector_ray,
    start_sector_cached,
)
from raystream.structures.graph.structure import GraphStructure

__all__ = ["Walks", "start_walks"]


class Walks(NamedTuple):
    """Sectors that each ray leaves on the way to its start; -1 for rays outside the scene.

    Attributes
    ----------
    bins : ndarray of shape (N,), int32
        From the sector of the ray's bin.
    cached : ndarray of shape (N,), int32
        From that of the previous ray, if it began in the same bin: the engine's route.
    displaced : ndarray of shape (N,), int32
        From the sector of the hit that the ray leaves.
    fallback_share : float
        Share of displaced rays that were not nearer than 16 sectors and used the bins.
    """

    bins: NDArray[np.int32]
    cached: NDArray[np.int32]
    displaced: NDArray[np.int32]
    fallback_share: float


def start_walks(graph: GraphStructure, rays: LocalRays, sectors: NDArray[np.int64]) -> Walks:
    """Walk to the start of each ray on three routes.

    Parameters
    ----------
    graph : GraphStructure
    rays : LocalRays
        In the order in which they are traced.
    sectors : ndarray of shape (N,), int64
        Rows of the sectors of the hits that they leave.

    Raises
    ------
    RuntimeError
        If two routes end in different sectors.
    """
    bins, displaced = graph.start_sectors(rays), graph.start_sectors(rays, near=sectors)
    count = len(rays.t_min)
    rows, steps = np.empty(count, np.int64), np.empty(count, np.int32)
    max_coordinate = np.float32(graph.triangles.max_coordinate)
    _walk_in_turn(0, count, graph.arrays, max_coordinate, rays, np.zeros(2, np.uint64), rows, steps)
    if not (np.array_equal(rows, bins.rows) and np.array_equal(rows, displaced.rows)):
        raise RuntimeError("routes to a start sector end in different sectors")
    is_out = bins.rows < 0
    by_bins, cached, near = (
        np.where(is_out, -1, one) for one in (bins.step_counts, steps, displaced.step_counts)
    )
    beyond = displaced.step_counts[~is_out] >= MAX_WALK
    return Walks(by_bins, cached, near, float(np.mean(beyond)) if beyond.size else 0.0)


@kernel
def _walk_in_turn(begin, end, graph, max_coordinate, rays, last, rows, steps):
    """Walk as one thread of the engine does, ray after ray."""
    o, d = rays.origins, rays.directions
    for i in range(np.uint64(begin), np.uint64(end)):
        rows[i], steps[i] = -1, 0
        ray = prepare_ray(o[i, 0], o[i, 1], o[i, 2], d[i, 0], d[i, 1], d[i, 2], max_coordinate)
        is_active, t_in, _ = clip_to_scene(graph, ray, rays.t_min[i], rays.t_max[i])
        if is_active:
            at = address(last)
            sector, count = start_sector_cached(graph, sector_ray(ray), ray, t_in, at)
            rows[i] = np.int64((sector - graph.rows) >> np.uint64(4))
            steps[i] = np.int32(count)
