"""What a machine whose device has memory of its own answers there."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol, cast

import numpy as np
from numpy.typing import NDArray

from raystream.core.arrays import is_on_gpu
from raystream.core.rays import RayBatch
from raystream.jit.threads import Progress
from raystream.kernels.collect import HitArrays
from raystream.programs.filters import Filter

__all__ = ["OnDevice", "ProgramsThere", "on_device", "programs_there"]


class OnDevice(Protocol):
    """Answers for certain rays; what is returned stays on their device, see `Tracer`."""

    def first_hit(self, progress: Progress | None) -> Any:
        """Find the nearest triangle along each ray."""
        ...

    def any_hit(self, progress: Progress | None) -> Any:
        """Find whether anything is in each ray's way."""
        ...

    def count_hits(self, surfaces: bool, progress: Progress | None) -> Any:
        """Count what lies along each ray."""
        ...

    def multi_hit(self, surfaces: bool, limit: int, progress: Progress | None) -> Any:
        """Find the nearest hits of each ray."""
        ...

    def trace(self, function: Any, payload: Any, surfaces: bool, progress: Progress | None) -> Any:
        """Run a program at the hits of each ray."""
        ...


class ProgramsThere(Protocol):
    """Programs on a device, for rays of the host's; None, or False, for what has to run here."""

    def first_hit(
        self,
        filter_: Filter,
        batch: RayBatch,
        status: NDArray[np.uint8],
        progress: Progress | None,
    ) -> HitArrays | None:
        """Find the nearest hit of each ray that exists."""
        ...

    def count_hits(
        self, filter_: Filter, batch: RayBatch, surfaces: bool, progress: Progress | None
    ) -> NDArray[np.int64] | None:
        """Count the hits of each ray that exist."""
        ...

    def multi_hit(
        self,
        filter_: Filter,
        batch: RayBatch,
        surfaces: bool,
        limit: int,
        status: NDArray[np.uint8],
        progress: Progress | None,
    ) -> tuple[NDArray[np.int64], HitArrays] | None:
        """Find the nearest hits of each ray that exist."""
        ...

    def trace(
        self,
        batch: RayBatch,
        function: Callable[..., Any],
        records: NDArray[Any] | None,
        surfaces: bool,
        progress: Progress | None,
    ) -> bool:
        """Run a program at the hits of each ray."""
        ...


class _DeviceMachine(Protocol):
    def on_device(
        self, on_hit: Any, skip_prim_ids: Any, origins: Any, directions: Any, t_min: Any, t_max: Any
    ) -> OnDevice:
        """Answer for rays of which at least one array is on a GPU."""
        ...

    @property
    def programs_there(self) -> ProgramsThere | None:
        """What runs programs for rays of the host's, if the device does."""
        ...


def on_device(machine: object, on_hit: Any, skip_prim_ids: Any, *rays: Any) -> OnDevice | None:
    """Who answers for rays on a GPU; None if they are on the host, or the machine is.

    Parameters
    ----------
    machine : object
        One whose device has memory of its own has a method `on_device`.
    on_hit, skip_prim_ids
        As a tracer's queries take them.
    *rays
        Origins, directions, t_min and t_max, as a tracer is given them.
    """
    if not hasattr(machine, "on_device") or not any(map(is_on_gpu, rays)):
        return None
    return cast("_DeviceMachine", machine).on_device(on_hit, skip_prim_ids, *rays)


def programs_there(machine: object) -> ProgramsThere | None:
    """What runs programs on a machine's device; None if the CPU does."""
    if not hasattr(machine, "programs_there"):
        return None
    return cast("_DeviceMachine", machine).programs_there
