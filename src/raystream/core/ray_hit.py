"""RayHit: what `Tracer.cast` returns, as Python numbers."""

from __future__ import annotations

from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.hits import Hits
from raystream.core.rays import RayStatus
from raystream.core.store import Store


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
    _triangles: Store
    _instance_id: int | None = None

    @classmethod
    def of(
        cls,
        columns: tuple[float, float, float, int],
        triangles: Store,
        instance_id: int | None = None,
    ) -> RayHit:
        """The hit of a valid ray with triangles.

        Parameters
        ----------
        columns : tuple
            t, u, v and prim_id; without an `instance_id`, the number that kernels have for it.
        triangles : Store
        instance_id : int, optional
        """
        if instance_id is None and triangles.kinds:  # of plain triangles they are ids
            prim_id, instance = triangles.split_ids(np.array(columns[3], np.int32))
            columns = (*columns[:3], prim_id.item())
            instance_id = None if instance is None else instance.item()
        hit = tuple.__new__(cls, columns)
        hit._triangles, hit._instance_id = triangles, instance_id
        return hit

    def __bool__(self) -> bool:
        return self.prim_id >= 0

    @property
    def instance_id(self) -> int:
        """Instance that is hit; 0 in a scene without instances, -1 for a miss."""
        return min(self.prim_id, 0) if self._instance_id is None else self._instance_id

    @cached_property
    def hits(self) -> Hits:
        """The same as `Hits` of shape (), which also provides materials, `spawn` and the rest."""
        held = self._triangles
        t, u, v = (np.array(one, held.number_type) for one in self[:3])
        prim_id, status = np.array(self.prim_id, np.int32), np.array(self.status, np.uint8)
        instance_id = np.array(self.instance_id, np.int32)
        return Hits(t, u, v, prim_id, status, held, None, instance_id)

    @property
    def position(self) -> NDArray[np.float64]:
        """Point on the triangle, shape (3,), float64, world space; NaN for a miss."""
        return self.hits.positions

    @property
    def normal(self) -> NDArray[np.floating[Any]]:
        """Unit normal of the triangle's plane, shape (3,), of the type of t; see `Hits.normals`."""
        return self.hits.normals
