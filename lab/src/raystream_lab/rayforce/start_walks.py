"""Walks of secondary rays to the sectors in which they start: from bins, and by displacement."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.rays import RayBatch
from raystream.kernels.local_frame import LocalRays
from raystream.machines.ray_block import blocks
from raystream.rendering.ao import REACH
from raystream.structures.graph.layout import SECTOR_ROWS
from raystream.structures.graph.structure import GraphStructure
from raystream.tracer import Tracer
from raystream_lab.diffuse_bounces import cosine_directions
from raystream_lab.published import published
from raystream_lab.rayforce.kernels.walk_in_turn import walk_in_turn
from raystream_lab.views import View


class Leaving(NamedTuple):
    """Rays that leave hits.

    Attributes
    ----------
    kind : str
    origins, directions : ndarray of shape (N, 3)
    t_max : float
    sectors : ndarray of shape (N,), int32
        `Hits.sectors` of the hits.
    any_hit : bool
    """

    kind: str
    origins: NDArray[Any]
    directions: NDArray[Any]
    t_max: float
    sectors: NDArray[np.int32]
    any_hit: bool


class StartWalks(NamedTuple):
    """Sectors that rays leave on the way to their start, mean per ray inside the scene.

    Attributes
    ----------
    bins : float
        From the sector of the ray's bin.
    in_turn : float
        From that of the ray before, if it began in the same bin: the engine's way without sectors.
    displaced : float
        From the sector of the hit that the ray leaves.
    """

    bins: float
    in_turn: float
    displaced: float


def secondary_rays(tracer: Tracer, view: View, size: int) -> Iterator[Leaving]:
    """Rays of the modes ao and kajiya, in their order: 32 from each first hit, and two bounces.

    Parameters
    ----------
    tracer : Tracer
        Of a graph.
    view : View
    size : int
        Width and height of the image.
    """
    generator = np.random.default_rng(0)
    origins, directions = (np.reshape(one, (-1, 3)) for one in view.rays(size))
    low, high = view.scene.bounds
    reach = REACH * float(np.linalg.norm(np.asarray(high) - low))
    origins = np.broadcast_to(origins, directions.shape)
    count: int = published("rayforce", "figure 3").values["ao_rays"]
    for kind, copies in (("first bounce", count), ("second bounce", 0)):
        hits = tracer.first_hit(origins, directions)
        kept = np.flatnonzero(hits.is_hit)
        if copies:
            yield _leaving("ao", hits[np.repeat(kept, copies)], directions, kept, reach, generator)
        bounce = _leaving(kind, hits[kept], directions, kept, np.inf, generator)
        yield bounce
        origins, directions = bounce.origins, bounce.directions


def _leaving(
    kind: str, hits: Any, incoming: Any, kept: Any, t_max: float, generator: np.random.Generator
) -> Leaving:
    """Rays with a cosine distribution around the normals of hits."""
    copies = len(hits.t) // max(len(kept), 1)
    normals = np.asarray(hits.normals, np.float64)
    away = cosine_directions(normals, np.repeat(incoming[kept], copies, axis=0), generator)
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    origins, _ = hits.spawn(away)
    return Leaving(kind, origins, away, t_max, hits.sectors, t_max < np.inf)


def start_walks(graph: GraphStructure, rays: Leaving) -> StartWalks:
    """Walk to the start of each ray on three routes.

    Raises
    ------
    RuntimeError
        If two routes end in different sectors.
    """
    local = _local_rays(graph, rays)
    near = np.where(rays.sectors < 0, -1, SECTOR_ROWS * rays.sectors.astype(np.int64))
    bins, displaced = graph.start_sectors(local), graph.start_sectors(local, near=near)
    count = len(local.t_min)
    found, steps = np.empty(count, np.int64), np.empty(count, np.int32)
    max_coordinate, last = np.float32(graph.triangles.max_coordinate), np.zeros(2, np.uint64)
    walk_in_turn(0, count, graph.view, max_coordinate, local, last, found, steps)
    rows = np.where(found < 0, -1, SECTOR_ROWS * found)
    if not (np.array_equal(rows, bins.rows) and np.array_equal(rows, displaced.rows)):
        raise RuntimeError("routes to a start sector end in different sectors")
    inside = rows >= 0
    columns = bins.step_counts, steps, displaced.step_counts
    means = (float(one[inside].mean()) if inside.any() else 0.0 for one in columns)
    return StartWalks(*means)


def _local_rays(graph: GraphStructure, rays: Leaving) -> LocalRays:
    batch = RayBatch(rays.origins, rays.directions, 0.0, rays.t_max)
    status = np.zeros(len(batch), np.uint8)
    parts = [block.rays for block in blocks(batch, graph.frame, status, None)]
    return LocalRays(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))
