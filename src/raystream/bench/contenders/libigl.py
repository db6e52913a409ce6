"""libigl's tree of boxes, as a contender for points."""

from __future__ import annotations

import importlib.metadata
from collections.abc import Mapping
from typing import Any

import igl
import numpy as np
from numpy.typing import NDArray

from raystream.bench.contenders.base import Closest, Contender, Geometry, Points


class Libigl(Contender):
    """``AABB.squared_distance``.

    Parameters
    ----------
    threads : int
        No effect: it uses as many as there are cores.
    options : mapping
        None.
    """

    queries = frozenset(("closest",))
    notes = "computes in float64"

    def __init__(self, threads: int, options: Mapping[str, Any]) -> None:  # noqa: ARG002
        self.version = importlib.metadata.version("libigl")
        self._tree: Any = None
        self._mesh: tuple[NDArray[np.float64], NDArray[np.int64]] | None = None

    def build(self, geometry: Geometry) -> None:
        """Build the tree from arrays of the types that it takes."""
        self._mesh = geometry.vertices.astype(np.float64), geometry.faces.astype(np.int64)
        self._tree = igl.AABB()
        self._tree.init(*self._mesh)

    def release(self) -> None:
        """Free the structure."""
        self._tree = self._mesh = None

    def closest_point(self, points: Points, mode: str) -> Closest:  # noqa: ARG002
        """Find the nearest point of the triangles to each point."""
        assert self._mesh is not None, "build first"
        given = points.points.astype(np.float64)
        squared, _, positions = self._tree.squared_distance(*self._mesh, given)
        return Closest(np.sqrt(squared), positions)
