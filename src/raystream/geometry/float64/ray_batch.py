"""Float64Rays: rays with limits in float64."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.rays import DEFAULT_LIMITS, RayBatch, as_real_array

#: The default limits, made once, as those in float32 are.
_DEFAULTS = {value: np.array(value) for value in DEFAULT_LIMITS}


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
        low, near = _limit("t_min", t_min, -np.inf)
        high, far = _limit("t_max", t_max, np.inf)
        super().__init__(origins, directions, near, far)
        self.float64_limits = self._spread(low), self._spread(high)

    @property
    def exact_limits(self) -> Sequence[NDArray[Any]]:
        """See `RayBatch.exact_limits`."""
        return self.float64_limits

    def _spread(self, limit: NDArray[np.float64]) -> NDArray[np.float64]:
        if limit.ndim == 0:
            return limit.reshape(1)
        return np.ascontiguousarray(np.broadcast_to(limit, self.shape).reshape(-1))


def _limit(name: str, values: Any, toward: float) -> tuple[NDArray[np.float64], Any]:
    """A limit in float64, and rounded to float32; for the usual ones, without arithmetic."""
    if type(values) is float and values in _DEFAULTS:
        return _DEFAULTS[values], values
    exact = as_real_array(name, values).astype(np.float64)
    return exact, _rounded(exact, toward)


def _rounded(limit: NDArray[np.float64], toward: float) -> Any:
    with np.errstate(over="ignore"):
        near = limit.astype(np.float32)
    is_short = near > limit if toward < 0.0 else near < limit
    return np.where(is_short, np.nextafter(near, np.float32(toward)), near)
