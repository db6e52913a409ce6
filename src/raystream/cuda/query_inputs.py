"""QueryInputs: the arguments that kernels of all queries share, of rays on the device."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from raystream.cuda.device_rays import DeviceRays
from raystream.cuda.ray_order import sort_rays
from raystream.jit.cuda import DeviceArray, StreamScope

if TYPE_CHECKING:
    from raystream.cuda.device_queries import DeviceScene

__all__ = ["QueryInputs"]


class QueryInputs:
    """Rays of one query, in the order in which its kernels take them.

    Parameters
    ----------
    work : StreamScope
        Keeps the order.
    scene : DeviceScene
    rays : DeviceRays
    """

    def __init__(self, work: StreamScope, scene: DeviceScene, rays: DeviceRays) -> None:
        self.work, self.scene, self.rays = work, scene, rays
        self._orders: dict[tuple[int, int], DeviceArray] = {}

    def __len__(self) -> int:
        return len(self.rays)

    def shared(self, first: int, count: int) -> tuple[Any, ...]:
        """Arguments for some of the rays: their order, if they are sorted, and where they lie.

        Raises
        ------
        CudaError
            If there is no memory for the order.
        """
        scene, source = self.scene, self.rays.source_from(first)
        shared = source, scene.frame, scene.resident.tree, None
        if not scene.is_sorted:
            return shared
        if (first, count) not in self._orders:  # else they were sorted before
            work = self.work
            order = sort_rays(work.gpu, source, count, scene.frame, work.ready, work.stream)
            self._orders[first, count] = order
        return self._orders[first, count].address, *shared
