"""Rows of streams: gathered and scattered by index, or appended without gaps."""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device
from raystream.jit.simd import (
    as_int32,
    compress,
    gather,
    i32x16,
    lanes_from_bits,
    mask8,
    mask_bits,
    permutation,
    popcount,
    scatter,
    store,
    store_triples,
)

_1, _2, _3 = np.int32(1), np.int32(2), np.int32(3)

# Bytes of a float32, of a float64, and of three of each.
_WORD, _LONG, _3_WORDS, _3_LONGS = np.uint64(4), np.uint64(8), np.uint64(12), np.uint64(24)

_LOW, _HIGH = permutation(*range(8)), permutation(*range(8, 16))


@device
def floats_at(base, k):
    """Gather float32 numbers k, k + 1 and k + 2 at an address."""
    return (
        gather(np.float32, base, k),
        gather(np.float32, base, k + _1),
        gather(np.float32, base, k + _2),
    )


@device
def vector_at(base, row):
    """Gather vectors of three float32 from rows of an array of shape (N, 3), by its address."""
    return floats_at(base, row * _3)


@device
def put_vectors(base, row, vector, mask):
    """Scatter vectors to rows of an array of shape (N, 3), where a mask is set."""
    at = row * _3
    scatter(base, at, vector[0], mask)
    scatter(base, at + _1, vector[1], mask)
    scatter(base, at + _2, vector[2], mask)


# Rows of a mask are compressed and stored as whole vectors, with garbage behind them: about two
# thirds of the time of scattering them.


@device
def append_numbers(base, first, number, mask):
    """Append float32 of masked lanes from a row on."""
    store(base + first * _WORD, compress(mask, number))


@device
def append_pixels(base, first, pixel, mask):
    """Append int64 of masked lanes from a row on."""
    low, high = _halves(mask)
    store(base + first * _LONG, compress(low, _LOW(pixel)))
    second = first + popcount(mask_bits(low))
    store(base + second * _LONG, compress(high, _HIGH(pixel)))


@device
def append_vectors(base, first, vector, mask):
    """Append three float32 of masked lanes from a row on."""
    x, y, z = vector
    at = base + first * _3_WORDS
    store_triples(at, compress(mask, x), compress(mask, y), compress(mask, z))


@device
def append_positions(base, first, position, mask):
    """Append three float64 of masked lanes from a row on."""
    x, y, z = position
    low, high = _halves(mask)
    at = base + first * _3_LONGS
    store_triples(at, compress(low, _LOW(x)), compress(low, _LOW(y)), compress(low, _LOW(z)))
    at += popcount(mask_bits(low)) * _3_LONGS
    store_triples(at, compress(high, _HIGH(x)), compress(high, _HIGH(y)), compress(high, _HIGH(z)))


@device
def _halves(mask):
    """Lanes 0 to 7 of a mask, and 8 to 15."""
    bits = mask_bits(mask)
    return lanes_from_bits(mask8, bits), lanes_from_bits(mask8, bits >> np.uint64(8))


# A thread with one lane writes to its own row, if the lane is masked.


@device
def _put_number(base, first, number, mask):
    scatter(base, i32x16(as_int32(first)), number, mask)


@device
def _put_pixel(base, first, pixel, mask):
    scatter(base, i32x16(as_int32(first)), pixel, mask)


@device
def _put_vector(base, first, vector, mask):
    put_vectors(base, i32x16(as_int32(first)), vector, mask)


#: For `single_lane`: functions that write one row, in place of those that append 16.
SINGLE_ROWS = {
    append_numbers: _put_number,
    append_pixels: _put_pixel,
    append_vectors: _put_vector,
    append_positions: _put_vector,
}
