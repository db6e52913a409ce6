"""RayCaster: a traced scene that answers for a single ray, from numbers to numbers."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable
from typing import Any

from raystream.core.hits import Hits
from raystream.core.ray_hit import RayHit
from raystream.core.rays import RayStatus, as_number, as_vector
from raystream.scene.scene import Scene
from raystream.structures import Structure
from raystream.tracer.worlds import WorldTracer


class RayCaster(WorldTracer):
    """The query of a `Tracer` for one ray; the others take arrays."""

    _cast: Callable[..., Any] | None

    def _set(self, scene: Scene | None, structure: Structure) -> None:
        super()._set(scene, structure)
        # Holds addresses of this structure: made with each new one.
        needs_queries = self._needs_queries() or self._world_count
        self._cast = None if needs_queries else self._backend.caster()

    @abstractmethod
    def _needs_queries(self) -> bool:
        """Whether `Tracer.first_hit` must see all rays: it counts, or is a subclass's."""

    def cast(
        self,
        origin: Any,
        direction: Any,
        t_min: float = 0.0,
        t_max: float = math.inf,
        mask: int | None = None,
        world: int | None = None,
    ) -> RayHit:
        """Find the nearest triangle along one ray, in a few microseconds.

        Parameters
        ----------
        origin, direction : sequence of three numbers, or array_like of shape (3,)
            World space, scene units; the direction need not be of unit length. Tuples and lists
            of floats are fastest.
        t_min, t_max : float
            Closed search interval, in direction lengths.
        mask : int, optional
            See `Tracer.first_hit`; with it, a cast takes as long as that for one ray.
        world : int, optional
            In a scene whose instances are in worlds, the ray's; it then takes as long, too.

        Returns
        -------
        RayHit
            ``t``, ``u``, ``v`` and ``prim_id`` as Python numbers, with the same bits as from
            `first_hit`; true for a hit. A miss has ``t = inf`` and ``prim_id = -1``.

        Raises
        ------
        ValueError
            If a shape is not (3,), or a limit is not a single number.
        TypeError
            If the numbers are not real, or are in arrays on a GPU.

        Notes
        -----
        For code that needs a hit before it knows its next ray; for many rays, `first_hit` takes
        less than a tenth of the time per ray. Threads may cast rays at the same time, and run in
        parallel. On GPUs, on ``machine="multipass"``, with ``counters=True`` and in subclasses
        with their own `first_hit`, it calls `first_hit` for one ray, and takes as long.

        Examples
        --------
        >>> import raystream as rs
        >>> tracer = rs.Tracer(rs.load("cornell"))
        >>> if hit := tracer.cast((278, 273, -800), (0, 0, 1)):
        ...     print(round(hit.t, 1), hit.prim_id)
        1092.0 30
        """
        origin, direction = as_vector("origin", origin), as_vector("direction", direction)
        if type(t_min) is not float:
            t_min = as_number("t_min", t_min)
        if type(t_max) is not float:
            t_max = as_number("t_max", t_max)
        if self._cast is None or mask is not None or world is not None:
            given = {"mask": mask, "worlds": world}
            given = {name: one for name, one in given.items() if one is not None}  # for subclasses
            hits = self.first_hit(origin, direction, t_min=t_min, t_max=t_max, **given)
            columns = hits.t.item(), hits.u.item(), hits.v.item(), hits.prim_id.item()
            instance_id, status = hits.instance_id.item(), hits.status.item()
        else:
            columns, status = self._cast((*origin, *direction, t_min, t_max))
            instance_id = None
        hit = RayHit.of(columns, self.structure.triangles, instance_id)
        if status:
            hit.status = RayStatus(status)
        return hit

    @abstractmethod
    def first_hit(
        self,
        origins: Any,
        directions: Any,
        *,
        t_min: Any = 0.0,
        t_max: Any = math.inf,
        worlds: Any = None,
        mask: Any = None,
    ) -> Hits:
        """See `Tracer.first_hit`."""
