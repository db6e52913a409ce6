"""ClosestPoints: the result of the queries for the nearest points of a scene's surface."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from raystream.core.hits import HitColumns
from raystream.core.store import Store


class ClosestPoints(HitColumns):
    """The point of the scene's surfaces nearest to each point of a query, or the nearest few.

    Attributes
    ----------
    distance : ndarray of shape S or S + (k,), float64
        World units; inf where nothing is within the greatest distance.
    positions : ndarray of shape S + (3,) or S + (k, 3), float64
        The nearest point of the triangle, world space; NaN where nothing was found. Shape S is
        the leading shape of the query's points; k is the number of triangles per point.
    prim_id : ndarray of shape S or S + (k,), int32
        Triangle or sphere, counted over the whole scene; -1 where nothing was found.
    u, v : ndarray of shape S or S + (k,), float32
        Weights of vertices 1 and 2 at the nearest point; vertex 0 has 1 - u - v. Exactly 0 or 1
        at a vertex. 0 where nothing was found. Of a sphere, where the point is on it, as in
        `Hits`.
    status : ndarray of shape S, uint8
        A `RayStatus` for each point: INVALID if a coordinate is NaN, infinite, or beyond 2**200 or
        2**240 times the scene's size. Such a point has no nearest point.
    """

    distance: NDArray[np.float64]
    positions: NDArray[np.float64]
    status: NDArray[np.uint8]

    def __init__(
        self,
        distance: NDArray[np.float64],
        positions: NDArray[np.float64],
        weights: tuple[NDArray[np.float32], NDArray[np.float32]],
        ids: tuple[NDArray[np.int32], NDArray[np.int32] | None],
        status: NDArray[np.uint8],
        triangles: Store,
    ) -> None:
        self.distance, self.positions = distance, positions
        self.u, self.v = weights
        (self.prim_id, self._instance_id), self.status = ids, status
        self._triangles = triangles

    @property
    def is_found(self) -> NDArray[np.bool_]:
        """Whether there is a triangle within the greatest distance, shape S or S + (k,), bool."""
        return self.prim_id >= 0

    def __repr__(self) -> str:
        found = int(np.count_nonzero(self.is_found))
        return (
            f"ClosestPoints(shape={self.prim_id.shape}, {found:,} of {self.prim_id.size:,} found)"
        )
