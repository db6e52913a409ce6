"""DeviceBands: rendering samples on a device, without copying paths to the host."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

__all__ = ["DeviceBands"]


class DeviceBands(Protocol):
    """A renderer of samples on a tracer's device; see `Tracer.bands_on_device`.

    Attributes
    ----------
    pixels_at_once : int
        Upper bound for a band.
    """

    pixels_at_once: int

    def takes(self, stages: Sequence[Callable[..., Any]]) -> bool:
        """Whether it implements all of an integrator's stages."""
        ...

    def trace(
        self, stages: Sequence[Callable[..., Any]], rows: range, sample: int
    ) -> NDArray[np.float32]:
        """Render one sample of each pixel of some rows; see `Integrator.trace`."""
        ...
