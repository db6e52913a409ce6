"""The compute machine: one ray from start to end in each invocation of a compute shader."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.graphics.adapters import OpenDevice
from raystream.graphics.dispatches import Dispatches, Task
from raystream.graphics.queries import RAYS_AT_ONCE, GraphicsQueries
from raystream.graphics.records import ROW, Query, packed_rays
from raystream.kernels.queries import LocalRays
from raystream.structures import Structure

__all__ = ["Compute"]


class Compute(GraphicsQueries):
    """Traces rays with compute shaders.

    Parameters
    ----------
    structure : Structure
        Built on the CPU; its arrays are copied to the device.
    opened : OpenDevice
    rays_at_once : int
        Most rays of a dispatch.

    Raises
    ------
    GraphicsError
        If there are no shaders for the structure, they do not compile, or it is too large for
        the device.
    """

    is_paced = True

    def __init__(
        self, structure: Structure, opened: OpenDevice, *, rays_at_once: int = RAYS_AT_ONCE
    ) -> None:
        super().__init__(structure, opened, rays_at_once)
        self._dispatches = Dispatches(self._form, opened, structure.triangles.extreme)
        self._found: NDArray[Any] = np.empty(0, ROW)
        self._dispatches.pipeline(Task(Query.FIRST_HIT))  # whatever is wrong is said now

    def _run(
        self,
        query: Query,
        surfaces: bool,
        rays: LocalRays,
        chunk: slice,
        wanted: NDArray[np.uint32],
        row_count: int,  # noqa: ARG002 - as the others have it
        tallies: NDArray[np.uint32] | None,
    ) -> NDArray[np.uint32]:
        task = Task(query, surfaces, tallies is not None)
        is_multi = query == Query.MULTI_HIT
        capacity = 0 if is_multi else int(wanted[0, 1])
        found = self._dispatches.run(
            task, packed_rays(rays, chunk), capacity, wanted if is_multi else None
        )
        self._found = found.rows
        if tallies is not None:
            tallies[chunk] += found.tallies
        return found.counts

    def _rows(self, count: int) -> NDArray[Any]:
        return self._found[:count]
