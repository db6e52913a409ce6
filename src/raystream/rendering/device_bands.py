"""DeviceBands: rendering samples on a device, or in loops of a machine, without queries."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from raystream.jit.threads import Progress


class DeviceBands(Protocol):
    """A renderer of samples on a tracer's device or machine; see `contexts.with_bands`.

    Attributes
    ----------
    is_serial : bool
        Whether bands are rendered one after another, each on all threads and with progress.
    """

    is_serial: bool

    def pixels_at_once(self, stages: Sequence[Callable[..., Any]], rays_per_pixel: int) -> int:
        """Upper bound for a band, for the rays that its stages make of a pixel at once."""
        ...

    def takes(self, stages: Sequence[Callable[..., Any]]) -> bool:
        """Whether it implements all of an integrator's stages."""
        ...

    def trace(
        self,
        stages: Sequence[Callable[..., Any]],
        rows: range,
        sample: int,
        progress: Progress | None = None,
    ) -> NDArray[np.float32]:
        """Render one sample of each pixel of some rows; see `Integrator.trace`."""
        ...

    def start(self) -> None:
        """Begin an image: `figures` are of what follows."""
        ...

    def figures(self) -> Mapping[str, Any]:
        """Figures of the samples since `start`, for `Image.figures`."""
        ...
