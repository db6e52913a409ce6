"""The compute machine: each invocation of a compute shader traces one ray."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.query import Kind
from raystream.graphics.adapters import OpenDevice
from raystream.graphics.backend import RAYS_AT_ONCE, Chunk, GraphicsBackend
from raystream.graphics.dispatches import Dispatcher, ShaderVariant
from raystream.graphics.packing import LOCAL_RAYS, ROW
from raystream.machines.backend import Capabilities
from raystream.structures import Structure

if TYPE_CHECKING:
    from raystream.graphics.rendering import ComputeBands
    from raystream.rendering.integrator import RenderContext


class ComputeBackend(GraphicsBackend):
    """Traces rays by compute shaders.

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

    adapts_size = True
    capabilities = Capabilities(shading=True)

    def __init__(
        self, structure: Structure, opened: OpenDevice, *, rays_at_once: int = RAYS_AT_ONCE
    ) -> None:
        super().__init__(structure, opened, rays_at_once)
        self.ray_block = self._shaders.rays.block
        self._dispatcher = Dispatcher(self._shaders, opened, structure.triangles.max_coordinate)
        self._found: NDArray[Any] = np.empty(0, ROW)
        self._dispatcher.pipeline(
            ShaderVariant(Kind.FIRST_HIT)
        )  # raises for a shader that does not compile

    def bands_on_device(self, context: RenderContext) -> ComputeBands | None:
        """Render samples of an image by compute shaders; see `Tracer.bands_on_device`.

        With instances the CPU shades what queries find.
        """
        if self._shaders.rays is not LOCAL_RAYS:
            return None
        from raystream.graphics.rendering import ComputeBands

        arrays = self._dispatcher.arrays
        return ComputeBands(context, self.opened, self._shaders, arrays, self.rays_at_once)

    def _run(self, chunk: Chunk) -> NDArray[np.uint32]:
        wanted, tallies = chunk.wanted, chunk.tallies
        variant = ShaderVariant(chunk.kind, chunk.surfaces, tallies is not None)
        is_multi = chunk.kind is Kind.MULTI_HIT
        capacity = 0 if is_multi else int(wanted[0, 1])
        rays = self._shaders.rays.packed(chunk.rays, chunk.rows)
        found = self._dispatcher.run(
            variant, rays, capacity, wanted if is_multi else None, chunk.row_count
        )
        self._found = found.rows
        if tallies is not None:
            tallies[chunk.rows] += found.tallies
        return found.counts

    def working_bytes(self, kind: Kind, ray_count: int, hit_count: int) -> int:
        """See `Backend.working_bytes`."""
        packed = self._shaders.rays.own_bytes * min(ray_count, self.rays_at_once)
        return packed + super().working_bytes(kind, ray_count, hit_count)

    def _rows(self, count: int) -> NDArray[Any]:
        return self._found[:count]
