"""Numbers beside a number."""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device
from raystream.jit.simd.lanes import bits_as_float, float_as_bits

__all__ = ["next_float_up"]

_ONE = np.int32(1)
_ZERO = np.float32(0.0)
_INF = np.float32(np.inf)
_LEAST = np.float32(2.0**-149)


@device
def next_float_up(x):
    """The smallest float32 that is larger than x; of infinity itself."""
    if not x < _INF:
        return x
    if x == _ZERO:
        return _LEAST
    step = _ONE if x > _ZERO else -_ONE
    return bits_as_float(np.int32(float_as_bits(x) + step))
