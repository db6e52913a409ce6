"""The order in which points are searched for: along a Morton curve, so that neighbours follow.

The triangle nearest to the previous point is near the next one, too: a good limit from the start,
and the nodes that the search visits are in the cache.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.jit.constants import NULL, ONE_U64, SHIFT_32, ZERO_U64
from raystream.jit.cpu import device
from raystream.jit.simd import load, store
from raystream.kernels.morton import spread_bits

#: Bits of a key along each axis; two passes sort 22 bits.
_SIDE_BITS = 7
_DIGIT_BITS = np.uint64(11)
_DIGITS = np.uint64(1 << 11)
_DIGIT_MASK = np.uint64((1 << 11) - 1)

#: uint32 that `order_points` needs for each point, and besides.
_WORDS_PER_POINT = 3
_ORDER_WORDS = 2 * (1 << 11)

_DOUBLE, _VECTOR = np.uint64(8), np.uint64(24)  # bytes
_LAST_CELL = 2.0**_SIDE_BITS - 1.0

#: Coordinates beyond this do not count: points there may be in any order.
_FARTHEST = 2.0**200


class PointOrder(NamedTuple):
    """The points of a call, which are answered in an order of their own.

    Attributes
    ----------
    first, end : uint64
        Its points.
    memory : uint64
        Address of `order_bytes` bytes; 0 to answer them as they come.
    """

    first: np.uint64
    end: np.uint64
    memory: np.uint64


def order_bytes(count: int) -> int:
    """Bytes of memory that the order of `count` points needs."""
    return 4 * (_WORDS_PER_POINT * count + _ORDER_WORDS)


@device
def begin_order(order, points, i):
    """Sort the points of a call, if i is its first one; `order` may be None."""
    if order is None:
        return
    if i == order.first and order.memory != NULL:
        order_points(points, order.first, order.end, order.memory)


@device
def point_at(order, i):
    """The point that is answered as the i-th; i if `order` is None."""
    if order is None or order.memory == NULL:
        return i
    # The numbers of the points follow two arrays of as many.
    count, number = order.end - order.first, i - order.first
    at = order.memory + ((count + count + number) << SHIFT_32)
    return order.first + np.uint64(load(np.uint32, at))


@device
def _cell(x, low, scale):
    inside = (x - low) * scale
    # NaN becomes 0.
    return np.uint64(min(inside, _LAST_CELL)) if inside > 0.0 else ZERO_U64


@device
def _widened(x, low, high):
    """The interval with a number, unless that is too far away or NaN."""
    if abs(x) <= _FARTHEST:
        return min(low, x), max(high, x)
    return low, high


@device
def load_point(points, i):
    """Three float64 of point i."""
    at = points + i * _VECTOR
    return (
        load(np.float64, at),
        load(np.float64, at + _DOUBLE),
        load(np.float64, at + (_DOUBLE + _DOUBLE)),
    )


@device
def _bounds(points, begin, end):
    low_x, low_y, low_z = _FARTHEST, _FARTHEST, _FARTHEST
    high_x, high_y, high_z = -_FARTHEST, -_FARTHEST, -_FARTHEST
    for i in range(begin, end):
        x, y, z = load_point(points, i)
        low_x, high_x = _widened(x, low_x, high_x)
        low_y, high_y = _widened(y, low_y, high_y)
        low_z, high_z = _widened(z, low_z, high_z)
    size = max(max(high_x - low_x, high_y - low_y), high_z - low_z)
    return (low_x, low_y, low_z), ((_LAST_CELL + 1.0) / size if size > 0.0 else 0.0)


@device
def order_points(points, begin, end, words):
    """Sort points begin to end by their cell, cells along a Morton curve.

    Parameters
    ----------
    points : uint64
        Address of three float64 a point.
    begin, end : uint64
    words : uint64
        Address of `order_bytes` bytes.

    Returns
    -------
    uint64
        Address of ``end - begin`` uint32, behind twice as many: the points less `begin`, in order.
    """
    count = end - begin
    keys, numbers = words, words + (count << SHIFT_32)
    sorted_ = numbers + (count << SHIFT_32)
    places = sorted_ + (count << SHIFT_32)
    seconds = places + (_DIGITS << SHIFT_32)
    for k in range(_DIGITS + _DIGITS):
        store(places + (k << SHIFT_32), np.uint32(0))
    low, scale = _bounds(points, begin, end)
    for k in range(count):
        x, y, z = load_point(points, begin + k)
        key = (
            spread_bits(_cell(x, low[0], scale))
            | (spread_bits(_cell(y, low[1], scale)) << ONE_U64)
            | (spread_bits(_cell(z, low[2], scale)) << (ONE_U64 + ONE_U64))
        )
        store(keys + (k << SHIFT_32), np.uint32(key))
        _count(places, key & _DIGIT_MASK)
        _count(seconds, key >> _DIGIT_BITS)
    _add_up(places)
    _add_up(seconds)
    for k in range(count):
        key = np.uint64(load(np.uint32, keys + (k << SHIFT_32)))
        store(numbers + (_take(places, key & _DIGIT_MASK) << SHIFT_32), np.uint32(k))
    for k in range(count):
        number = load(np.uint32, numbers + (k << SHIFT_32))
        key = np.uint64(load(np.uint32, keys + (np.uint64(number) << SHIFT_32)))
        store(sorted_ + (_take(seconds, key >> _DIGIT_BITS) << SHIFT_32), number)
    return sorted_


@device
def _count(counts, digit):
    at = counts + (digit << SHIFT_32)
    store(at, np.uint32(load(np.uint32, at) + np.uint32(1)))


@device
def _add_up(counts):
    """Replace the number of points of each digit by the place of its first one."""
    place = np.uint32(0)
    for k in range(_DIGITS):
        at = counts + (k << SHIFT_32)
        here = load(np.uint32, at)
        store(at, place)
        place = np.uint32(place + here)


@device
def _take(places, digit):
    """The next place of a digit."""
    at = places + (digit << SHIFT_32)
    place = load(np.uint32, at)
    store(at, np.uint32(place + np.uint32(1)))
    return np.uint64(place)
