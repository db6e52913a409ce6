"""embreex, the Embree binding used by trimesh, as a contender."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import version
from typing import Any

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray

from raystream.bench.contenders.base import (
    MISS_T,
    AllHits,
    Contender,
    FirstHits,
    Geometry,
    Rays,
)

#: Rays per call, small enough for load balance.
_CHUNK = 1 << 15

#: Offset of the next ray behind a hit, relative to t and to the scene's size; trimesh also uses
#: 1e-6 of the size.
_STEP = 1e-6


class Embreex(Contender):
    """``EmbreeScene.run`` on blocks of rays, from several Python threads.

    Parameters
    ----------
    threads : int
    options : mapping
        Of the scene: ``robust``, whether Embree's tests let no ray through an edge (embreex's
        default: False).
    """

    notes = (
        "a call runs on one thread but releases the GIL, so it is called from several threads "
        "here; all hits are found by restarting behind each hit, as in trimesh, which can miss "
        "hits that are close together"
    )

    def __init__(self, threads: int, options: Mapping[str, Any]) -> None:
        self._options = dict(options)
        self.is_watertight = bool(options.get("robust"))
        self._threads = threads
        self._pool = ThreadPoolExecutor(threads)
        self.version = version("embreex")
        self._step = 0.0

    def build(self, geometry: Geometry) -> None:
        """Add the triangles; the first ray triggers the build."""
        scene = EmbreeScene(**self._options)
        TriangleMesh(scene=scene, vertices=geometry.vertices, indices=geometry.faces)
        one = np.ones((1, 3), np.float32)
        scene.run(one, one)
        self._built = scene
        size = geometry.vertices.max(axis=0) - geometry.vertices.min(axis=0)
        self._step = _STEP * float(np.linalg.norm(size))

    def first_hit(self, rays: Rays, mode: str) -> FirstHits:  # noqa: ARG002
        """Find the nearest hit of each ray."""
        return self._first(*rays.rows(), rays.t_max)

    def any_hit(self, rays: Rays, mode: str) -> NDArray[np.bool_]:  # noqa: ARG002
        """Test whether each ray hits anything."""
        origins, directions = rays.rows()
        seen = np.empty(len(origins), np.bool_)
        limit = _limit(rays.t_max)

        def run(rows: slice) -> None:
            found = self._built.run(origins[rows], directions[rows], dists=limit, query="OCCLUDED")
            np.equal(found, 0, out=seen[rows])

        self._spread(run, len(origins))
        return seen

    def multi_hit(self, rays: Rays, mode: str) -> AllHits:  # noqa: ARG002
        """Find all hits of each ray, sorted."""
        origins, directions = rays.rows()
        live = np.arange(len(origins))
        starts, along = origins, directions
        last = np.full(len(origins), -1, np.int32)
        reached = np.zeros(len(origins), np.float32)
        steps = self._step / np.linalg.norm(directions, axis=1).astype(np.float32)
        found: list[tuple[NDArray[Any], ...]] = []
        while len(live):
            t, prim_id = self._first(starts, along, np.inf)
            hit = t < MISS_T
            live, along, steps = live[hit], along[hit], steps[hit]
            t = reached[hit] + t[hit]
            is_new = prim_id[hit] != last[hit]  # otherwise the ray hit the same triangle again
            last = prim_id[hit]
            found.append((live[is_new], t[is_new], last[is_new]))
            reached = t * np.float32(1.0 + _STEP) + steps
            starts = origins[live] + reached[:, None] * along
        ray_id, t, prim_id = (np.concatenate(parts) for parts in zip(*found, strict=True))
        order = np.argsort(ray_id, kind="stable")
        splits = np.zeros(len(origins) + 1, np.int64)
        np.cumsum(np.bincount(ray_id, minlength=len(origins)), out=splits[1:])
        return AllHits(splits, t[order], prim_id[order])

    def _first(
        self, origins: NDArray[np.float32], directions: NDArray[np.float32], t_max: float
    ) -> FirstHits:
        t = np.empty(len(origins), np.float32)
        prim_id = np.empty(len(origins), np.int32)
        limit = _limit(t_max)

        def run(rows: slice) -> None:
            found = self._built.run(origins[rows], directions[rows], dists=limit, output=True)
            t[rows], prim_id[rows] = found["tfar"], found["primID"]

        self._spread(run, len(origins))
        return FirstHits(t, prim_id)

    def _spread(self, run: Callable[[slice], None], count: int) -> None:
        chunk = min(_CHUNK, max(1, -(-count // self._threads)))
        list(self._pool.map(run, [slice(first, first + chunk) for first in range(0, count, chunk)]))


def _limit(t_max: float) -> float | None:
    """Convert t_max for ``dists``: None is its default, 1e37."""
    return t_max if np.isfinite(t_max) else None
