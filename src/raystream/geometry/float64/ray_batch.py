"""Float64Rays: rays with limits in float64."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.rays import RayBatch


class Float64Rays(RayBatch):
    """Rays with limits in float64.

    Attributes
    ----------
    limits : tuple of two ndarray, float32
        Rounded outward.
    float64_limits : tuple of two ndarray of shape (N,) or (1,), float64
        Contiguous.
    """

    copied_bytes = 8

    def __init__(
        self, origins: Any, directions: Any, t_min: Any = 0.0, t_max: Any = np.inf
    ) -> None:
        super().__init__(origins, directions, t_min, t_max)
        low, high = map(np.ascontiguousarray, self._limits(t_min, t_max, np.float64))
        self.float64_limits = low, high
        near, far = self.limits
        self.limits = _moved(near, near > low, -np.inf), _moved(far, far < high, np.inf)

    @property
    def exact_limits(self) -> Sequence[NDArray[Any]]:
        """See `RayBatch.exact_limits`."""
        return self.float64_limits


def _moved(limit: NDArray[Any], is_short: NDArray[np.bool_], toward: float) -> NDArray[Any]:
    """Move some limits by a step: they were rounded to nearest."""
    if not is_short.any():
        return limit
    with np.errstate(over="ignore"):
        return np.where(is_short, np.nextafter(limit, np.float32(toward)), limit)
