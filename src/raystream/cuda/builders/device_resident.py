"""Base classes of structures built on a device and kept in its memory."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from raystream.core.triangles import Triangles
from raystream.jit.cuda import Gpu
from raystream.jit.threads import Progress
from raystream.structures.base import BuildReport, Structure, UpdateReport
from raystream.structures.registry import form_of


class DeviceResident:
    """A structure with arrays on a device, copied to the host on first use.

    A subclass lists the attributes of the host's structure in ``_host_names`` and makes that
    structure in ``_on_host``.
    """

    _host_names: ClassVar[tuple[str, ...]]

    if TYPE_CHECKING:  # subclasses define it
        _on_host: Any

    @property
    def on_host(self) -> Structure:
        """The host's structure, copied on first use."""
        return self._on_host

    def __getattr__(self, name: str) -> Any:
        # Attributes that only queries and reports on the host need.
        if name in self._host_names:
            return getattr(self._on_host, name)
        raise AttributeError(name)

    def __reduce__(self) -> tuple[Any, ...]:
        """Copies and pickles are structures of the host."""
        return self._on_host.__reduce__()


class RebuiltOnDevice(DeviceResident):
    """A structure that is rebuilt for moved triangles."""

    def updated(
        self, triangles: Triangles, max_cost_growth: float, progress: Progress | None = None
    ) -> tuple[Structure, UpdateReport]:
        """Rebuild it on the device; see `Structure.updated`. Costs are NaN."""
        del max_cost_growth, progress
        own: Any = self
        rebuilt: Structure = form_of(own.name, "cuda build")(own.gpu, triangles, own.options)
        return rebuilt, UpdateReport(True, rebuilt.report.seconds, np.nan, np.nan)


def finish(gpu: Gpu, byte_count: int, started: float) -> BuildReport:
    """Wait for a build to end, and report it; `started` is when it began (`time.perf_counter`).

    Raises
    ------
    CudaError
        If the build failed.
    """
    gpu.wait()
    return BuildReport(time.perf_counter() - started, byte_count)
