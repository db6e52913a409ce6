"""Base classes of structures built on a device and kept in its memory."""

from __future__ import annotations

import time
from functools import cached_property
from typing import Any, ClassVar, NamedTuple

import numpy as np

from raystream.core.triangles import Triangles
from raystream.cuda.nested import SharedAllocation
from raystream.jit.cuda import DeviceArray, Gpu
from raystream.jit.threads import Progress
from raystream.structures.base import BuildReport, Structure, UpdateReport
from raystream.structures.registry import form_of


class Resident(NamedTuple):
    """A structure in GPU memory.

    Attributes
    ----------
    tree : NamedTuple
        As `Structure.view`, with addresses on the device.
    arrays : tuple of DeviceArray
        The memory; keep it as long as the tree is used.
    nested : SharedAllocation or None
        And that of `Structure.nested`.
    """

    tree: Any
    arrays: tuple[DeviceArray, ...]
    nested: SharedAllocation | None = None


class DeviceResident:
    """A structure with arrays on a device, copied to the host on first use.

    A subclass lists the attributes of the host's structure in ``_host_names``, and its class in
    ``_host_class``.

    Parameters
    ----------
    gpu : Gpu
    triangles : Triangles
    options : StructureOptions
    resident : Resident
    started : float
        When the build began, by `time.perf_counter`.

    Raises
    ------
    CudaError
        If the build failed: it waits for its end.
    """

    _host_class: ClassVar[Any]
    _host_names: ClassVar[tuple[str, ...]]

    def __init__(
        self, gpu: Gpu, triangles: Triangles, options: Any, resident: Resident, started: float
    ) -> None:
        self.gpu, self.resident = gpu, resident
        self.triangles: Any = triangles
        self.options: Any = options
        gpu.wait()
        self.report = BuildReport(time.perf_counter() - started, self._byte_count)

    @property
    def _byte_count(self) -> int:
        return sum(one.nbytes for one in self.resident.arrays)

    @property
    def laid_out(self) -> Resident:
        """As the device's kernels read it."""
        return self.resident

    def _host_arguments(self) -> tuple[Any, ...]:
        """What ``_set`` of the host's class takes between triangles and options."""
        raise NotImplementedError

    @cached_property
    def _on_host(self) -> Any:
        made = self._host_class.__new__(self._host_class)
        made._set(self.triangles, *self._host_arguments(), self.options, 0.0)
        return made

    @property
    def on_host(self) -> Structure:
        """The host's structure, copied on first use."""
        held: Structure = self._on_host
        return held

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
