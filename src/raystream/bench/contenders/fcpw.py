"""FCPW, as a contender."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.metadata import version
from typing import Any

import fcpw
import numpy as np
from numpy.typing import NDArray

from raystream.bench.contenders.base import MISS_T, Contender, FirstHits, Geometry, Rays

__all__ = ["Fcpw"]


class Fcpw(Contender):
    """``scene_3D.intersect`` for many rays, on a vectorized tree."""

    queries = frozenset(("first", "any"))
    notes = (
        "hits are returned as a list of objects and read one by one; its occlusion queries do not "
        "report which rays are occluded, so first hits are used instead"
    )

    def __init__(self, threads: int, options: Mapping[str, Any]) -> None:  # noqa: ARG002
        self._scene: Any = None

    @property
    def version(self) -> str:
        """The package's version."""
        return version("fcpw")

    def build(self, geometry: Geometry) -> None:
        """Build the tree recommended by FCPW's documentation for ray queries."""
        scene = fcpw.scene_3D()
        scene.set_object_count(1)
        scene.set_object_vertices(np.asfortranarray(geometry.vertices), 0)
        scene.set_object_triangles(np.asfortranarray(geometry.faces), 0)
        scene.build(fcpw.aggregate_type.bvh_surface_area, True)
        self._scene = scene

    def release(self) -> None:
        """Free the structure."""
        self._scene = None

    def first_hit(self, rays: Rays, mode: str) -> FirstHits:  # noqa: ARG002
        """Find the nearest hit of each ray."""
        found = self._intersect(rays)
        return FirstHits(
            np.fromiter((hit.d for hit in found), np.float32, len(rays)),
            np.fromiter((hit.primitive_index for hit in found), np.int32, len(rays)),
        )

    def any_hit(self, rays: Rays, mode: str) -> NDArray[np.bool_]:  # noqa: ARG002
        """Test whether each ray hits anything."""
        found = self._intersect(rays)
        return np.fromiter((hit.d for hit in found), np.float32, len(rays)) < MISS_T

    def _intersect(self, rays: Rays) -> Any:
        origins, directions = rays.rows()
        found = fcpw.interaction_3D_list()
        limit = min(rays.t_max, float(np.finfo(np.float32).max))
        self._scene.intersect(
            np.asfortranarray(origins),
            np.asfortranarray(directions),
            np.full(len(rays), limit, np.float32),
            found,
        )
        return found
