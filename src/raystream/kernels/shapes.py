"""Shapes of users in kernels: records, calls of their functions, and where hits are on them.

A user's function is compiled by itself, and called by its address, as filters are: kernels are
compiled once for all shapes. What is around it, such as the order of crossings, is compiled into
it (`shape_functions`) from the functions here.
"""

from __future__ import annotations

import numpy as np

from raystream.core.shapes import CODES, MOST_HITS, PLACE_STEPS, SLACK
from raystream.jit.constants import (
    BYTES_64,
    INF_F64,
    ONE_F64,
    ONE_U64,
    SHIFT_64,
    ZERO_F64,
    ZERO_U64,
)
from raystream.jit.cpu import device, kernel
from raystream.jit.intrinsics import call_filter
from raystream.jit.simd import bits_as_float, float_as_bits, load, scratch, store
from raystream.jit.views import address_of, view

#: What users' functions are for.
ROLES = ("intersect", "normal", "distance")

#: The functions of a kind of shapes: addresses of their code, 0 without one; and of two uint64 of
#: each for what goes wrong: 1 if it raises, and a fault with the record's number, see `note_fault`.
KIND = np.dtype([*((name, "u8") for name in ROLES), ("faults", "u8")])
KindRecord = view(KIND)
FAULTS = np.dtype([("raised", "u8"), ("fault", "u8")])
_OF_NORMAL, _OF_DISTANCE = np.uint64(FAULTS.itemsize), np.uint64(2 * FAULTS.itemsize)

#: A shape: addresses of its parameters and of its kind; its box, world space; the number of its
#: first crossing, see `core.primitives`; which of its kind it is; and room for parameters. As long
#: as a block of triangles, so that leaves are found and prefetched like theirs.
SHAPE = np.dtype(
    [
        ("record", "u8"),
        ("kind", "u8"),
        ("low", "f8", 3),
        ("high", "f8", 3),
        ("number", "i4"),
        ("row", "i4"),
        ("inline", "V88"),
    ]
)
ShapeRecord = view(SHAPE)

_NAN = np.float64(np.nan)

#: Bytes of the distances of a ray's crossings with a shape.
CROSSINGS_BYTES = 8 * MOST_HITS
_RAY_BYTES, _POINT_BYTES = 48, 24
_DIRECTION = np.uint64(_POINT_BYTES)

#: Faults: of a distance that is NaN, of a count beyond `hits`; the record's number is above them.
NOT_A_NUMBER, TOO_MANY = np.uint64(1), np.uint64(2)
_FAULT_BITS = np.uint64(2)

_SLACK, _STEPS = np.float64(SLACK), np.float64(PLACE_STEPS)
_LAST_STEP = np.float64(PLACE_STEPS - 1)
_CODES, _FIRST_BITS, _SIGN = np.uint64(CODES), np.uint64(2**23), np.uint64(31)
_SIZE_BITS, _STEP_BITS, _HALF = np.uint64(2**31 - 1), np.uint64(PLACE_STEPS - 1), np.float64(0.5)
_X_BITS, _Y_BITS = np.uint64(42), np.uint64(21)


@device
def load_three(at):
    """Three adjacent float64."""
    second, third = at + BYTES_64, at + (BYTES_64 + BYTES_64)
    return load(np.float64, at), load(np.float64, second), load(np.float64, third)


@device
def store_three(at, x, y, z):
    """Write three adjacent float64."""
    store(at, np.float64(x))
    store(at + BYTES_64, np.float64(y))
    store(at + (BYTES_64 + BYTES_64), np.float64(z))


@device
def note_fault(faults, fault, own):
    """Keep what went wrong with a shape, if it is the first fault."""
    at = faults + BYTES_64
    if load(np.uint64, at) == ZERO_U64:
        store(at, (np.uint64(own.row) << _FAULT_BITS) | fault)


# Within users' functions


@device
def _widened(own):
    """The slack by which a shape's box is wider for crossings."""
    (x, y, z), (a, b, c) = own.low, own.high
    return max(max(a - x, b - y), c - z) * _SLACK


@device
def _cut(low, high, origin, direction, span):
    """The part of a span of a line that is between two planes."""
    if direction == ZERO_F64:
        return span if low <= origin <= high else (INF_F64, -INF_F64)
    inverse = ONE_F64 / direction
    a, b = (low - origin) * inverse, (high - origin) * inverse
    return max(span[0], min(a, b)), min(span[1], max(a, b))  # without those that are NaN


@device
def span_of(own, origin, direction):
    """The part of a line within a shape's box: its first and last distance, or the reverse."""
    (x, y, z), (a, b, c), slack = own.low, own.high, _widened(own)
    span = _cut(x - slack, a + slack, origin[0], direction[0], (-INF_F64, INF_F64))
    span = _cut(y - slack, b + slack, origin[1], direction[1], span)
    return _cut(z - slack, c + slack, origin[2], direction[2], span)


@device
def forget(out, most):
    """Write NaN for all distances, so that those that a user's function does not write are seen."""
    for k in range(most):
        store(out + (k << SHIFT_64), _NAN)


@device
def settle(faults, own, count, most, span, out):
    """Put the crossings of a line with a shape in order, without those outside of its box.

    Parameters
    ----------
    faults : uint64
    own : ShapeRecord
    count : int64
        What the user's function returned.
    most : uint64
        Crossings that it may have.
    span : tuple of two float64
        See `span_of`.
    out : uint64
        Address of the distances; changed.

    Returns
    -------
    uint64
        Their number now.
    """
    if not (np.int64(0) <= count <= np.int64(most)):
        note_fault(faults, TOO_MANY, own)
        return ZERO_U64
    kept = ZERO_U64
    for k in range(np.uint64(count)):
        t = load(np.float64, out + (k << SHIFT_64))
        if t != t:
            note_fault(faults, NOT_A_NUMBER, own)
        elif span[0] <= t <= span[1]:
            to = out + (kept << SHIFT_64)
            while to != out and load(np.float64, to - BYTES_64) > t:
                store(to, load(np.float64, to - BYTES_64))
                to -= BYTES_64
            store(to, t)
            kept += ONE_U64
    return kept


# Calls


@device
def crossings(own, origin, direction, out):
    """The distances at which a line crosses a shape, increasing.

    Parameters
    ----------
    own : ShapeRecord
    origin, direction : tuple of three float64
        World space.
    out : uint64
        Address of `CROSSINGS_BYTES`.

    Returns
    -------
    uint64
        Their number.
    """
    kind, ray = KindRecord(own.kind), scratch(_RAY_BYTES)
    store_three(ray, *origin)
    store_three(ray + _DIRECTION, *direction)
    return call_filter(kind.intersect, (kind.faults, address_of(own), ray, out))


@device
def normal_at(own, point):
    """The unit normal of a shape at a point, world space."""
    kind, at, out = KindRecord(own.kind), scratch(_POINT_BYTES), scratch(_POINT_BYTES)
    store_three(at, *point)
    call_filter(kind.normal, (kind.faults + _OF_NORMAL, address_of(own), at, out))
    return load_three(out)


@device
def distance_at(own, point):
    """The signed distance of a point from a shape, world space."""
    kind, at, out = KindRecord(own.kind), scratch(_POINT_BYTES), scratch(_POINT_BYTES)
    store_three(at, *point)
    call_filter(kind.distance, (kind.faults + _OF_DISTANCE, address_of(own), at, out))
    return load(np.float64, out)


# Places on shapes


@device
def _step(x, low, high):
    """The step of a box along an axis that a coordinate is in."""
    at = (x - low) * _STEPS / (high - low)  # NaN where the box is flat
    return np.uint64(np.int64(min(max(at, ZERO_F64), _LAST_STEP) if at == at else ZERO_F64))


@device
def _coded(code):
    """The float32 that stands for a number below `CODES`."""
    bits = ((code >> ONE_U64) + _FIRST_BITS) | ((code & ONE_U64) << _SIGN)
    return bits_as_float(np.int32(np.uint32(bits)))


@device
def place(own, x, y, z):
    """The u and v of a point on a shape; see `core.shapes.Shapes.places_of`."""
    low, high = own.low, own.high
    number = _step(x, low[0], high[0]) << _X_BITS
    number |= _step(y, low[1], high[1]) << _Y_BITS
    number |= _step(z, low[2], high[2])
    code = number // _CODES
    return _coded(code), _coded(number - code * _CODES)


@device
def _code_of(number):
    """The number below `CODES` of a float32."""
    bits = np.uint64(np.uint32(float_as_bits(number)))
    return (((bits & _SIZE_BITS) - _FIRST_BITS) << ONE_U64) | (bits >> _SIGN)


@device
def _told(step, low, high):
    return low + (np.float64(step & _STEP_BITS) + _HALF) * ((high - low) / _STEPS)


@device
def point_at(own, u, v):
    """The point on a shape that u and v stand for; see `core.shapes.Shapes.points_at`."""
    number = _code_of(np.float32(u)) * _CODES + _code_of(np.float32(v))
    (x, y, z), (a, b, c) = own.low, own.high
    return _told(number >> _X_BITS, x, a), _told(number >> _Y_BITS, y, b), _told(number, z, c)


@device
def enters(own, u, v, direction):
    """Whether a ray of a direction enters a shape at the place of a hit."""
    x, y, z = normal_at(own, point_at(own, u, v))
    return x * direction[0] + y * direction[1] + z * direction[2] < ZERO_F64


# For the host


@kernel
def call_for_rows(begin, end, function, faults, records, given, out, counts):
    """Call a function for shapes, by address.

    Parameters
    ----------
    begin, end : int
    function, faults, records : uint64
        Addresses: of its code, its faults, and the first record.
    given, out : tuple of two uint64
        Addresses of what it is given, and of its results; bytes from a shape's to the next one's.
    counts : ndarray of shape (N,), uint64
        Written: what it returns.
    """
    for k in range(np.uint64(begin), np.uint64(end)):
        own, at, to = address_of(ShapeRecord(records, k)), given[0] + k * given[1], out[0]
        counts[k] = call_filter(function, (faults, own, at, to + k * out[1]))
