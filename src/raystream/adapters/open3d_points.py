"""Open3D's queries of points: the nearest surface, and whether they are inside."""

from __future__ import annotations

import operator
from abc import abstractmethod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.adapters.open3d_arrays import as_points, hit_columns, results_like
from raystream.scene.mesh import Mesh
from raystream.tracer import Tracer

#: The first of the directions in which crossings are counted; later ones are turned about it.
_DIRECTION = np.array([0.5377, 0.8339, -0.1259])


class PointMethods:
    """The methods of `RaycastingScene` that take points."""

    _meshes: list[Mesh]

    @abstractmethod
    def _tracer(self) -> Tracer: ...

    @abstractmethod
    def _normals_of(self, tracer: Tracer) -> NDArray[np.float32]: ...

    def compute_closest_points(self, query_points: Any, nthreads: int = 0) -> dict[str, Any]:
        """Find the nearest point on the surface for each point.

        Parameters
        ----------
        query_points : array_like or tensor of shape S + (3,), real
        nthreads : int
            No effect.

        Returns
        -------
        dict
            - ``"points"`` : shape S + (3,), float32; NaN for a query point that is not finite, or
              in an empty scene.
            - ``"geometry_ids"``, ``"primitive_ids"`` : shape S, uint32; the mesh, and the triangle
              within it, or ``INVALID_ID``. Of equally near triangles, the first added.
            - ``"primitive_uvs"`` : shape S + (2,), float32; weights of vertices 1 and 2.
            - ``"primitive_normals"`` : shape S + (3,), float32; unit normals.

        Raises
        ------
        ValueError, TypeError
            If the points are not real numbers of shape (..., 3), or the scene has a structure or
            device on which `Tracer.closest_point` is not supported.
        """
        operator.index(nthreads)
        tracer = self._tracer()
        near = tracer.closest_point(as_points(query_points))
        like = results_like(query_points)
        columns = {
            "points": near.positions.astype(np.float32),
            **hit_columns(near, len(self._meshes)),
            "primitive_normals": self._normals_of(tracer)[near.prim_id],
        }
        return {name: like(column) for name, column in columns.items()}

    def compute_distance(self, query_points: Any, nthreads: int = 0) -> Any:
        """Compute the distance of each point from the surface.

        Parameters
        ----------
        query_points : array_like or tensor of shape S + (3,), real
        nthreads : int
            No effect.

        Returns
        -------
        array or tensor of shape S, float32
            inf for a point that is not finite, or in an empty scene.

        Raises
        ------
        ValueError, TypeError
            See `compute_closest_points`.
        """
        operator.index(nthreads)
        return results_like(query_points)(self._distance(as_points(query_points)))

    def compute_signed_distance(
        self, query_points: Any, nthreads: int = 0, nsamples: int = 1
    ) -> Any:
        """Compute the distance of each point from the surface, negative inside.

        Parameters
        ----------
        query_points, nthreads, nsamples
            See `compute_occupancy`.

        Returns
        -------
        array or tensor of shape S, float32

        Raises
        ------
        ValueError, TypeError
            See `compute_closest_points` and `compute_occupancy`.
        """
        operator.index(nthreads)
        points = as_points(query_points)
        inside = self._is_inside(points, nsamples)
        distance = self._distance(points)
        return results_like(query_points)(np.where(inside, -distance, distance))

    def compute_occupancy(self, query_points: Any, nthreads: int = 0, nsamples: int = 1) -> Any:
        """Find which points are inside, by counting how often rays cross the surface.

        Parameters
        ----------
        query_points : array_like or tensor of shape S + (3,), real
        nthreads : int
            No effect.
        nsamples : int
            Rays per point, an odd number; the majority decides. One is enough for closed meshes:
            crossings are also counted correctly at edges and vertices.

        Returns
        -------
        array or tensor of shape S, float32
            1 inside, else 0.

        Raises
        ------
        ValueError, TypeError
            If the points are not real numbers of shape (..., 3), or `nsamples` is not odd.
        """
        operator.index(nthreads)
        inside = self._is_inside(as_points(query_points), nsamples)
        return results_like(query_points)(np.asarray(inside, np.float32))

    def _distance(self, points: NDArray[Any]) -> NDArray[np.float32]:
        distance = self._tracer().closest_point(points).distance
        with np.errstate(over="ignore"):
            return np.asarray(distance, np.float32)

    def _is_inside(self, points: NDArray[Any], nsamples: int) -> NDArray[np.bool_]:
        count = operator.index(nsamples)
        if count < 1 or count % 2 == 0:
            raise ValueError(f"nsamples: expected an odd number, 1 or more, got {count}")
        tracer = self._tracer()
        votes = np.zeros(points.shape[:-1], np.int32)
        directions = np.random.default_rng(0).normal(size=(count, 3))
        directions[0] = _DIRECTION
        for direction in directions:
            votes += tracer.count_hits(points, direction, crossings="surfaces") % 2 == 1
        return votes * 2 > count
