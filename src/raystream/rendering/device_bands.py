"""DeviceBands: samples taken by a device whose memory the paths stay in."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

__all__ = ["DeviceBands"]


class DeviceBands(Protocol):
    """What a tracer's machine has that shades, too; see `Tracer.bands_on_device`.

    Attributes
    ----------
    pixels_at_once : int
        Most whose paths are followed together.
    """

    pixels_at_once: int

    def takes(self, stages: Sequence[Callable[..., Any]]) -> bool:
        """Whether it has its own way for each of a renderer's stages."""
        ...

    def trace(
        self, stages: Sequence[Callable[..., Any]], rows: range, sample: int
    ) -> NDArray[np.float32]:
        """Take one sample of each pixel of some rows; see `Integrator.trace`."""
        ...
