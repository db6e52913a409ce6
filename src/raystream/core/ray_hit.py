"""RayHit: what `Tracer.cast` returns, as Python numbers."""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.hits import Hits
from raystream.core.rays import RayStatus
from raystream.core.triangles import Triangles

__all__ = ["RayHit"]


class _Columns(NamedTuple):
    t: float
    u: float
    v: float
    prim_id: int


class RayHit(_Columns):
    """The nearest hit of one ray: ``t, u, v, prim_id``. It is true for a hit, false for a miss.

    Attributes
    ----------
    t : float
        Distance in direction lengths; inf for a miss.
    u, v : float
        Weights of vertices 1 and 2; vertex 0 has 1 - u - v. 0 for a miss.
    prim_id : int
        Triangle, counted over the whole scene; -1 for a miss.
    status : RayStatus
        Whether the ray was traced; not a member of the tuple.
    """

    # A tuple with attributes besides: it has no __slots__.

    status: RayStatus = RayStatus.VALID
    _triangles: Triangles

    @classmethod
    def of(cls, columns: tuple[float, float, float, int], triangles: Triangles) -> RayHit:
        """The hit of a valid ray with triangles.

        Parameters
        ----------
        columns : tuple
            t, u, v and prim_id.
        triangles : Triangles
        """
        hit = tuple.__new__(cls, columns)
        hit._triangles = triangles
        return hit

    def __bool__(self) -> bool:
        return self.prim_id >= 0

    @cached_property
    def hits(self) -> Hits:
        """The same as `Hits` of shape (), for all else that they know: materials, `spawn`."""
        t, u, v = (np.array(one, np.float32) for one in self[:3])
        prim_id, status = np.array(self.prim_id, np.int32), np.array(self.status, np.uint8)
        return Hits(t, u, v, prim_id, status, self._triangles)

    @property
    def position(self) -> NDArray[np.float64]:
        """Point on the triangle, shape (3,), float64, world space; NaN for a miss."""
        return self.hits.positions

    @property
    def normal(self) -> NDArray[np.float32]:
        """Unit normal of the triangle's plane, shape (3,), float32; see `Hits.normals`."""
        return self.hits.normals
