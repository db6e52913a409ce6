"""WorldTracer: a traced scene whose instances are in worlds, one world at a time."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from raystream.jit.threads import Progress, part_of
from raystream.tracer.traced_scene import TracedScene, flat_ids


class WorldTracer(TracedScene):
    """What a `Tracer` has for scenes whose instances are in worlds; see `Scene.instances`."""

    def in_world(self, world: int) -> Self:
        """Make a tracer of the instances in one world, and of those in all worlds.

        It supports all that a scene with instances does: images, visible faces, view factors. Its
        ``instance_id`` count these instances alone; see `Scene.in_world`.

        Parameters
        ----------
        world : int
            From 0; or -1 for the instances in all worlds.

        Returns
        -------
        Tracer
            With the same options. The structures of objects are shared, and the tree over the
            instances is built.

        Raises
        ------
        ValueError
            If the scene has no worlds, or not this one.

        Examples
        --------
        >>> import numpy as np
        >>> import raystream as rs
        >>> places = np.tile(np.eye(3, 4), (3, 1, 1))
        >>> tracer = rs.Tracer(rs.Scene.instances(rs.load("cornell"), places, worlds=[0, 1, 1]))
        >>> tracer.in_world(1)
        Tracer(36 triangles, 2 instances, structure='bvh')
        """
        scene = self.scene.in_world(world)
        structure: Any = self.structure
        other = type(self).__new__(type(self))
        # The structure's geometry, not the scene's: it has the objects in the tracer's precision.
        triangles = structure.triangles.moved(scene.placements)
        made = {"_scene": scene, "structure": structure.moved(triangles)}
        other.__setstate__({**self.__getstate__(), **made})
        return other

    def _world_ids(self, worlds: Any, shape: tuple[int, ...]) -> NDArray[np.int32] | None:
        """The argument `worlds` of a query, checked and flat; None in a scene without worlds."""
        if worlds is None and not self._world_count:
            return None
        self._check_for_worlds(worlds)
        return flat_ids("worlds", worlds, self._world_count, shape)

    def _by_world(
        self, ids: NDArray[np.int32], progress: Progress | None
    ) -> Iterator[tuple[NDArray[np.intp], Self, Progress | None]]:
        """The rows in each world, its tracer, and what reports the progress of these rows."""
        done = 0
        order = np.argsort(ids, kind="stable")
        firsts = np.flatnonzero(np.diff(ids[order], prepend=-2))
        for rows in np.split(order, firsts[1:]) if len(ids) else ():
            report = part_of(progress, done, len(rows), len(ids))
            yield rows, self.in_world(int(ids[rows[0]])), report
            done += len(rows)
