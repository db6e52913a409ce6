"""Integer hashes for the keys of samplers, and floats from their bits.

For numbers and, lane by lane, for vectors.
"""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device
from raystream.jit.simd import as_float32, as_uint32

# The multipliers and shifts come from a search for the least bias: Wellons,
# "Prospecting for Hash Functions", 2018, and the threads that followed it.
_FIRST, _SECOND = np.uint32(0x21F0AAAD), np.uint32(0xD35A2D97)
_15, _16 = np.uint32(15), np.uint32(16)

# Odd fractions of the golden ratio and of a square root: they keep arguments of 0 from the hash's
# only fixed point, 0.
_OF_SEED, _OF_DIMENSION = np.uint32(0x9E3779B9), np.uint32(0x6A09E667)

_8 = np.uint32(8)
_ULP = np.float32(2.0**-24)


@device
def mix(x):
    """Hash a uint32 bijectively: each input bit flips about half of the output bits."""
    x = as_uint32(x)
    x = as_uint32(as_uint32(x ^ (x >> _16)) * _FIRST)
    x = as_uint32(as_uint32(x ^ (x >> _15)) * _SECOND)
    return as_uint32(x ^ (x >> _15))


@device
def stream_key(seed, pixel, dimension):
    """The key of a pixel's numbers in a dimension or a group of them, uint32.

    Parameters
    ----------
    seed, pixel, dimension : int
        Only the lower 32 bits count. Different pixels, dimensions or seeds never have the same
        key if the other two arguments are equal.
    """
    # Seed and pixel come first: compilers hoist their hash out of loops.
    at_pixel = mix(mix(as_uint32(seed) + _OF_SEED) ^ as_uint32(pixel))
    return mix(at_pixel ^ mix(as_uint32(dimension) + _OF_DIMENSION))


@device
def as_float(bits):
    """The upper 24 bits of a uint32 as a fraction, float32: 0 to 1 - 2**-24, never 1."""
    return as_float32(as_uint32(as_uint32(bits) >> _8)) * _ULP
