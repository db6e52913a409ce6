"""Float64CudaBackend: the branching machine on CUDA for tracers in float64."""

from __future__ import annotations

from typing import Any

from raystream.core.rays import RayBatch
from raystream.cuda.backend import CudaBackend
from raystream.machines.backend import Capabilities
from raystream.machines.float64 import Float64Rays


class Float64CudaBackend(CudaBackend):
    """Traces rays in float64 on a GPU, one per thread, with the CPU's functions; see the base."""

    capabilities = Capabilities(device_arrays=True, programs=False)

    def batch(self, origins: Any, directions: Any, t_min: Any, t_max: Any) -> RayBatch:
        """The rays of a query on the host, with limits in float64; see `RayBatch`."""
        rays: Any = Float64Rays(origins, directions, t_min, t_max)
        rays.limits = rays.float64_limits  # the kernels read these alone
        return rays
