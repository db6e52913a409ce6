"""Open3D's RaycastingScene (Embree within), as a contender."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import open3d
from numpy.typing import NDArray

from raystream.bench.contenders.base import (
    AllHits,
    Closest,
    Contender,
    FirstHits,
    Geometry,
    Points,
    Rays,
)


class Open3D(Contender):
    """``cast_rays``, ``test_occlusions``, ``list_intersections``, ``compute_closest_points``."""

    queries = frozenset(("first", "any", "multi", "closest"))
    is_watertight = True
    notes = (
        "cast_rays also returns weights and normals, and takes no t_max; list_intersections "
        "does not sort, so its hits are sorted here with NumPy"
    )

    def __init__(self, threads: int, options: Mapping[str, Any]) -> None:  # noqa: ARG002
        self._threads = threads
        self.version = str(open3d.__version__)

    def build(self, geometry: Geometry) -> None:
        """Add the triangles; the first rays trigger the build."""
        tensor = open3d.core.Tensor.from_numpy
        scene = open3d.t.geometry.RaycastingScene(nthreads=self._threads)
        scene.add_triangles(tensor(geometry.vertices), tensor(geometry.faces.view(np.uint32)))
        scene.cast_rays(tensor(np.ones((1, 6), np.float32)))
        self._built = scene

    def first_hit(self, rays: Rays, mode: str) -> FirstHits:  # noqa: ARG002
        """Find the nearest hit of each ray."""
        found = self._built.cast_rays(_tensor(rays), nthreads=self._threads)
        return FirstHits(found["t_hit"].numpy(), found["primitive_ids"].numpy())

    def any_hit(self, rays: Rays, mode: str) -> NDArray[np.bool_]:  # noqa: ARG002
        """Test whether each ray hits anything."""
        seen: NDArray[np.bool_] = self._built.test_occlusions(
            _tensor(rays), tfar=rays.t_max, nthreads=self._threads
        ).numpy()
        return seen

    def multi_hit(self, rays: Rays, mode: str) -> AllHits:  # noqa: ARG002
        """Find all hits of each ray, sorted."""
        found = self._built.list_intersections(_tensor(rays), nthreads=self._threads)
        t = found["t_hit"].numpy()
        # Positive floats sort like their bits: one key for ray and t, one fast sort.
        key = found["ray_ids"].numpy().astype(np.uint64)
        key <<= np.uint64(32)
        key |= t.view(np.uint32)
        order = np.argsort(key)
        return AllHits(found["ray_splits"].numpy(), t[order], found["primitive_ids"].numpy()[order])

    def closest_point(self, points: Points, mode: str) -> Closest:  # noqa: ARG002
        """Find the nearest point of the triangles to each point; it gives no distances."""
        given = open3d.core.Tensor.from_numpy(points.points)
        found = self._built.compute_closest_points(given, nthreads=self._threads)
        return Closest(None, found["points"].numpy())


def _tensor(rays: Rays) -> Any:
    """Pack six numbers per ray, as Open3D expects; the tensor shares the array's memory."""
    together = np.empty((*rays.origins.shape[:-1], 6), np.float32)
    together[..., :3] = rays.origins
    together[..., 3:] = rays.directions
    return open3d.core.Tensor.from_numpy(together)
