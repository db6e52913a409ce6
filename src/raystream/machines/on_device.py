"""OnDevice: the queries as a machine answers them for rays that are in its device's memory."""

from __future__ import annotations

from typing import Any, Protocol, cast

from raystream.core.arrays import is_on_gpu
from raystream.jit.threads import Progress

__all__ = ["OnDevice", "on_device"]


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


class _DeviceMachine(Protocol):
    def on_device(self, origins: Any, directions: Any, t_min: Any, t_max: Any) -> OnDevice:
        """Answer for rays of which at least one array is on a GPU."""
        ...


def on_device(machine: object, *rays: Any) -> OnDevice | None:
    """Who answers for rays on a GPU; None if they are on the host, or the machine is.

    Parameters
    ----------
    machine : object
        One whose device has memory of its own has a method `on_device`.
    *rays
        Origins, directions, t_min and t_max, as a tracer is given them.
    """
    if not hasattr(machine, "on_device") or not any(map(is_on_gpu, rays)):
        return None
    return cast("_DeviceMachine", machine).on_device(*rays)
