"""Neighbours of float32 numbers."""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import kernel
from raystream.jit.simd import next_float_up

LARGEST = np.finfo(np.float32).max
LEAST = np.float32(2.0**-149)


@kernel
def _next_above(values, out):
    for i in range(len(values)):
        out[i] = next_float_up(values[i])


def test_the_next_float_is_numpys(rng):
    special = [0.0, -0.0, 1.0, -1.0, LEAST, -LEAST, LARGEST, -LARGEST, np.inf, -np.inf, np.nan]
    bits = rng.integers(0, 2**32, 1000, dtype=np.uint32)
    values = np.concatenate([np.array(special, np.float32), bits.view(np.float32)])
    out = np.empty_like(values)
    _next_above(values, out)
    with np.errstate(all="ignore"):
        expected = np.nextafter(values, np.float32(np.inf))
    known = ~np.isnan(values)
    assert out[known].tobytes() == expected[known].tobytes()
    assert np.isnan(out[~known]).all()
