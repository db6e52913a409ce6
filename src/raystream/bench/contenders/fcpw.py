"""FCPW, the Fastest Closest Points in the West, as a contender for points."""

from __future__ import annotations

import importlib.metadata
from collections.abc import Mapping
from typing import Any

import fcpw
import numpy as np
from numpy.typing import NDArray

from raystream.bench.contenders.base import Closest, Contender, Geometry, Points


class _Interactions:
    """FCPW's list of results; an array of their distances when NumPy asks for one."""

    def __init__(self, found: Any) -> None:
        self._found = found

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return np.array([one.d for one in self._found], dtype or np.float64)


class Fcpw(Contender):
    """``find_closest_points`` of a vectorised BVH.

    Parameters
    ----------
    threads : int
        No effect: it uses as many as there are cores.
    options : mapping
        None.
    """

    queries = frozenset(("closest",))
    notes = "returns a list of objects, which is not converted to arrays within the time"

    def __init__(self, threads: int, options: Mapping[str, Any]) -> None:  # noqa: ARG002
        self.version = importlib.metadata.version("fcpw")

    def build(self, geometry: Geometry) -> None:
        """Build a BVH by the surface area heuristic, with vectors."""
        self._built = fcpw.scene_3D()
        self._built.set_object_count(1)
        self._built.set_object_vertices(np.asfortranarray(geometry.vertices), 0)
        self._built.set_object_triangles(np.asfortranarray(geometry.faces), 0)
        self._built.build(fcpw.aggregate_type.bvh_surface_area, True)

    def closest_point(self, points: Points, mode: str) -> Closest:  # noqa: ARG002
        """Find the nearest point of the triangles to each point."""
        found = fcpw.interaction_3D_list()
        limits = np.full(len(points), np.inf, np.float32)
        self._built.find_closest_points(np.asfortranarray(points.points), limits, found)
        return Closest(_Interactions(found))
