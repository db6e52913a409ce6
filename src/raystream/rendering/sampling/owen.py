"""Sobol samples with hash-based Owen scrambling.

Dimensions form groups of four, each with its own sequence. A group has two pairs. The first pair
is Sobol's first two dimensions, a (0, 2)-sequence. The second pair is the same sequence at another
index, `quad_matrix` times the first's. That permutes indices within blocks of 2**k, so this pair is
a (0, 2)-sequence, too, and the four dimensions are stratified jointly.
"""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device
from raystream.jit.simd import address, as_uint32, gather
from raystream.rendering.sampling.hashing import as_float, mix, stream_key
from raystream.rendering.sampling.quad_matrix import byte_tables, quad_matrix

_SECOND_PAIR = byte_tables(quad_matrix())
_256, _512, _768 = np.uint32(256), np.uint32(512), np.uint32(768)

_1, _2, _3, _4 = np.uint32(1), np.uint32(2), np.uint32(3), np.uint32(4)
_8, _16, _24, _BYTE = np.uint32(8), np.uint32(16), np.uint32(24), np.uint32(0xFF)

#: The lower of each two blocks of bits, in the steps of a bit reversal or a Pascal matrix.
_BY_8, _BY_4 = np.uint32(0x00FF00FF), np.uint32(0x0F0F0F0F)
_BY_2, _BY_1 = np.uint32(0x33333333), np.uint32(0x55555555)

#: Of a group's keys: one for the order of its samples, and one for each of its dimensions.
_ORDER = np.uint32(0xB5297A4D)

# Any even factors give a scramble, but with some, flips of a bit correlate for different higher
# bits. With these and the keyed product the correlation of any two flips of the upper nine bits
# is below 0.02 over 65,536 keys, which is chance; with the four factors of Laine and Karras it is
# up to 0.6. They are Vegdahl's ("Building a Better LK Hash", 2021).
_LK_1, _LK_2, _LK_3 = np.uint32(0x3D20ADEA), np.uint32(0x05526C56), np.uint32(0x53A22864)


@device
def _reverse(x):
    """Reverse the bits of a uint32."""
    x = as_uint32((x >> _16) | (x << _16))
    x = as_uint32(((x >> _8) & _BY_8) | ((x & _BY_8) << _8))
    x = as_uint32(((x >> _4) & _BY_4) | ((x & _BY_4) << _4))
    x = as_uint32(((x >> _2) & _BY_2) | ((x & _BY_2) << _2))
    return as_uint32(((x >> _1) & _BY_1) | ((x & _BY_1) << _1))


@device
def _pascal(x):
    """Sobol's second matrix, Pascal's triangle modulo 2, times a vector of bits.

    Bit i of the product is the sum of the bits whose index has all the ones of i: five steps
    suffice, one per bit of an index.
    """
    x = as_uint32(x ^ (x >> _16))
    x = as_uint32(x ^ ((x >> _8) & _BY_8))
    x = as_uint32(x ^ ((x >> _4) & _BY_4))
    x = as_uint32(x ^ ((x >> _2) & _BY_2))
    return as_uint32(x ^ ((x >> _1) & _BY_1))


@device
def _flips(tables, place):
    return gather(np.uint32, tables, as_uint32(place))


@device
def _second_pair(x):
    """The index of a sample in a group's second pair: the matrix times x."""
    tables = address(_SECOND_PAIR)
    low = _flips(tables, x & _BYTE) ^ _flips(tables, ((x >> _8) & _BYTE) + _256)
    high = _flips(tables, ((x >> _16) & _BYTE) + _512) ^ _flips(tables, (x >> _24) + _768)
    return as_uint32(low ^ high)


@device
def _scramble(x, key):
    """Flip each bit by a hash of the bits below it and of the key.

    On a reversed fraction this is Owen scrambling: a bit's flip depends on more significant bits.
    Sums, products with odd numbers and xor with products with even numbers carry upwards only
    (Laine and Karras 2011).
    """
    x = as_uint32(x ^ as_uint32(x * _LK_1))
    x = as_uint32(x + key)
    x = as_uint32(x * ((key >> _16) | _1))
    x = as_uint32(x ^ as_uint32(x * _LK_2))
    return as_uint32(x ^ as_uint32(x * _LK_3))


@device
def _index(sample, dimension, key):
    """Index of a sample in the (0, 2)-sequence of a group's pair.

    The order of samples is scrambled, too, which makes groups independent. It is scrambled from
    the highest bit down, so that the first 2**k stay one block of 2**k.
    """
    index = _reverse(_scramble(_reverse(as_uint32(sample)), mix(key ^ _ORDER)))
    return _second_pair(index) if as_uint32(dimension) & _2 else index


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
        In [0, 1). Each interval of length 2**-k has one number of the first 2**k samples, for k
        up to 24.

    References
    ----------
    .. [1] Burley, "Practical Hash-based Owen Scrambling", Journal of Computer Graphics
       Techniques 9(4), 2020.
    .. [2] Laine and Karras, "Stratified Sampling for Stochastic Transparency", Eurographics
       Symposium on Rendering 2011.
    """
    dimension = as_uint32(dimension)
    key = stream_key(seed, pixel, dimension >> _2)
    index = _index(sample, dimension, key)
    matrix = _pascal(index) if dimension & _1 else index
    return as_float(_reverse(_scramble(matrix, mix(as_uint32(key + as_uint32(dimension & _3))))))


@device
def sample_pair(seed, pixel, sample, dimension):
    """The numbers of an even dimension and the next, which are stratified jointly.

    Parameters
    ----------
    seed, pixel, sample, dimension : int
        See `sample_number`.

    Returns
    -------
    x, y : float32
        In [0, 1). The first 2**k samples are a (0, k, 2)-net: each rectangle of 2**-i by
        2**-(k - i) has one.
    """
    dimension = as_uint32(dimension)
    key = stream_key(seed, pixel, dimension >> _2)
    index = _index(sample, dimension, key)
    in_group = as_uint32(dimension & _2)
    x = _scramble(index, mix(as_uint32(key + in_group)))
    y = _scramble(_pascal(index), mix(as_uint32(key + in_group + _1)))
    return as_float(_reverse(x)), as_float(_reverse(y))
