"""Float64Rays: rays with limits in float64."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.rays import RayBatch, as_real_array


class Float64Rays(RayBatch):
    """Rays with limits in float64.

    Attributes
    ----------
    limits : tuple of two ndarray, float32
        Rounded outward.
    float64_limits : tuple of two ndarray of shape (N,) or (1,), float64
    """

    copied_bytes = 8

    def __init__(self, origins: Any, directions: Any, t_min: Any, t_max: Any) -> None:
        low, high = _number("t_min", t_min), _number("t_max", t_max)
        super().__init__(origins, directions, _rounded(low, -np.inf), _rounded(high, np.inf))
        self.float64_limits = self._spread(low), self._spread(high)

    @property
    def exact_limits(self) -> Sequence[NDArray[Any]]:
        """See `RayBatch.exact_limits`."""
        return self.float64_limits

    def _spread(self, limit: NDArray[np.float64]) -> NDArray[np.float64]:
        if limit.ndim == 0:
            return limit.reshape(1)
        return np.ascontiguousarray(np.broadcast_to(limit, self.shape).reshape(-1))


def _number(name: str, values: Any) -> NDArray[np.float64]:
    return as_real_array(name, values).astype(np.float64)


def _rounded(limit: NDArray[np.float64], toward: float) -> Any:
    with np.errstate(over="ignore"):
        near = limit.astype(np.float32)
    is_short = near > limit if toward < 0.0 else near < limit
    return np.where(is_short, np.nextafter(near, np.float32(toward)), near)
