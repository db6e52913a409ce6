"""What structures have in common that were built on a device, and stay there."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from raystream.core.triangles import Triangles
from raystream.jit.cuda import Gpu
from raystream.jit.threads import Progress
from raystream.structures.base import BuildReport, Structure, UpdateReport

__all__ = ["DeviceResident", "RebuiltOnDevice", "finish"]


class DeviceResident:
    """A structure whose arrays are on a device; the host's are made when they are asked for.

    A class of these names what its host's structure has and it has not, and makes that structure
    in ``_on_host``.
    """

    _host_names: ClassVar[tuple[str, ...]]

    if TYPE_CHECKING:  # else it would be found where it is asked for
        _on_host: Any

    def __getattr__(self, name: str) -> Any:
        # What only the host's queries and figures need, when they do.
        if name in self._host_names:
            return getattr(self._on_host, name)
        raise AttributeError(name)


class RebuiltOnDevice(DeviceResident):
    """One that is built anew for triangles that have moved, by ``_rebuilt``."""

    if TYPE_CHECKING:

        def _rebuilt(self, triangles: Triangles) -> Structure:
            """Another one, on the same device, with the same options."""

    def updated(
        self, triangles: Triangles, max_cost_growth: float, progress: Progress | None = None
    ) -> tuple[Structure, UpdateReport]:
        """Build it anew, on the device; see `Structure.updated`. Costs are not said."""
        del max_cost_growth, progress
        rebuilt = self._rebuilt(triangles)
        return rebuilt, UpdateReport(True, rebuilt.report.seconds, np.nan, np.nan)


def finish(gpu: Gpu, byte_count: int, started: float) -> BuildReport:
    """Wait until all is built, and say how long it took since `time.perf_counter` was `started`.

    Raises
    ------
    CudaError
        If some of it failed.
    """
    gpu.wait()
    return BuildReport(time.perf_counter() - started, byte_count)
