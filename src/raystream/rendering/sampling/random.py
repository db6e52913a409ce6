"""Independent random numbers, by hashing: the baseline of the other samplers."""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device
from raystream.jit.simd import as_uint32
from raystream.rendering.sampling.hashing import as_float, mix, stream_key

_OF_SAMPLE = np.uint32(0xBB67AE85)
_1 = np.uint32(1)


@device
def sample_number(seed, pixel, sample, dimension):
    """One number of one sample.

    Parameters
    ----------
    seed, pixel, sample, dimension : int
        0 to 2**32 - 1. The number depends on nothing else.

    Returns
    -------
    float32
        In [0, 1).
    """
    # The sample is hashed, too: otherwise two keys that differ in low bits only would give the
    # same numbers in another order.
    key = stream_key(seed, pixel, dimension)
    return as_float(mix(key ^ mix(as_uint32(sample) + _OF_SAMPLE)))


@device
def sample_pair(seed, pixel, sample, dimension):
    """The numbers of an even dimension and the next, two float32; see `sample_number`."""
    following = as_uint32(as_uint32(dimension) + _1)
    return (
        sample_number(seed, pixel, sample, dimension),
        sample_number(seed, pixel, sample, following),
    )
