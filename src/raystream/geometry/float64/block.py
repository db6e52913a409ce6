"""The leaf block of float64: four triangles side by side, and its test in float64.

The test decides by signs and distances with bounds of their rounding: what it calls a miss is one,
what it calls a sure hit is one, at a distance within the interval that it gives. The others are
decided by `exact.solve_exactly`.

With A = vertex 0 - origin, p and q the two edges at vertex 0 and d the direction, the weights of
vertices 1 and 2 are in proportion to q . (A x d) and -p . (A x d), that of all three to
d . (p x q), and the distance is A . (p x q) / d . (p x q). (Moeller and Trumbore, "Fast, Minimum
Storage Ray-Triangle Intersection", Journal of Graphics Tools 2(1), 1997.)

The bounds: let M be the largest component of A and h that of p and q. Differences are rounded
once, the components of d are below 2, and each product and sum is rounded once. First-order bounds
in units of 2**-53, of terms as they stand in the code: 66 M h for the two weights, 66 h h for the
sum of the three, and 90 h h + 168 M h for the third; 39 M h h for the distance's numerator.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from raystream.jit.constants import INF_F64, ONE_U64, SHIFT_32, SHIFT_64, ZERO_U64
from raystream.jit.cpu import device
from raystream.jit.simd import (
    absolute,
    any_lane,
    count_trailing_zeros,
    fma,
    load,
    mask_bits,
    maximum,
    minimum,
    select,
    store,
)
from raystream.kernels.ray import largest

#: A block: 36 float64 numbers, x, y, z of vertex 0, of vertex 1, then of vertex 2, for four
#: triangles each; then their four prim_ids, int32, and 16 bytes that are unused. Unused lanes have
#: prim_id -1 and coordinates NaN. Twice the size of a block of float32, so that links to leaves of
#: twice the block's number serve for both.
BLOCK_NUMBERS = 40
BLOCK = np.uint64(8 * BLOCK_NUMBERS)
AXIS = np.uint64(32)
SECOND = np.uint64(96)
THIRD = np.uint64(192)
PRIM_IDS = np.uint64(288)

#: Where `block_test` writes the upper bounds of distances, behind the lower ones.
_HIGH = np.uint64(32)

_UNIT = 2.0**-53

#: Bounds of rounding, see above, with a margin for terms of second order.
_SIGN_ERROR = np.float64(192.0 * _UNIT)
_TOP_ERROR = np.float64(48.0 * _UNIT)
_BASE_ERROR = np.float64(80.0 * _UNIT)
_RATIO_ERROR = np.float64(4.0 * _UNIT)

#: The divisor is known well enough for a distance if it is this many times its bound.
_CLEAR = np.float64(4.0)

_BLOCK_BITS = np.int32(7)


@device
def leaf_end(first, child):
    """Address after the last block of a leaf, the first of which is at `first`."""
    return first + (np.uint64(np.int32(~child) & _BLOCK_BITS) + ONE_U64) * BLOCK


@device
def _load_corner(number, at):
    return load(number, at), load(number, at + AXIS), load(number, at + (AXIS + AXIS))


@device
def load_corners(number, at):
    """The vertices of a triangle (of float64), or of the four of a block (f64x4)."""
    b, c = _load_corner(number, at + SECOND), _load_corner(number, at + THIRD)
    return _load_corner(number, at), b, c


@device
def load_edges(number, at):
    """What tests need of a triangle, or of four; see `load_corners`.

    Returns
    -------
    a : triple
        Vertex 0.
    p, q, n : triple
        The edges at vertex 0, and their cross product.
    h : number or vector
        The largest component of the edges.
    """
    a, b, c = load_corners(number, at)
    px, py, pz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    qx, qy, qz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    n = fma(py, qz, -(pz * qy)), fma(pz, qx, -(px * qz)), fma(px, qy, -(py * qx))
    p, q = (px, py, pz), (qx, qy, qz)
    return a, p, q, n, maximum(largest(p), largest(q))


@device
def _dot(x, y):
    return fma(x[2], y[2], fma(x[1], y[1], x[0] * y[0]))


class PossibleHits(NamedTuple):
    """What float64 says of rays and triangles, a lane for each pair.

    Attributes
    ----------
    found : mask
        Those that may meet, within the intervals wanted.
    sure : mask
        Of these, those that meet for sure.
    low, high : float64 vector
        The distance lies between.
    """

    found: Any
    sure: Any
    low: Any
    high: Any


@device
def _both(first, second):
    return second if first is None else first & second


@device
def test_lanes(edges, origin, direction, t_min, t_far, allowed):
    """Test rays against triangles: a ray against four, or 16 rays against one.

    Parameters
    ----------
    edges : tuple
        See `load_edges`.
    origin, direction : triple of float64 numbers or vectors
    t_min, t_far : float64 number or vector
        Hits are wanted in this interval.
    allowed : mask or None
        The lanes to test [None: all].

    Returns
    -------
    PossibleHits
    """
    a, p, q, n, h = edges
    dx, dy, dz = direction
    # Step 1: three numbers in proportion to the weights, and their sum with a smaller error.
    ax, ay, az = corner = a[0] - origin[0], a[1] - origin[1], a[2] - origin[2]
    moment = (
        fma(ay, dz, -(az * dy)),
        fma(az, dx, -(ax * dz)),
        fma(ax, dy, -(ay * dx)),
    )
    v, w, base = _dot(q, moment), -_dot(p, moment), _dot(n, direction)
    u = (base - v) - w
    low, high = minimum(minimum(u, v), w), maximum(maximum(u, v), w)
    reach = largest(corner)
    error = h * (reach + h) * _SIGN_ERROR
    # Most pairs end here: two weights have different signs for sure.
    found = _both(allowed, (low >= -error) | (high <= error))
    if not any_lane(found):
        return PossibleHits(found, found, base, base)
    # Step 2: the interval in which the distance lies: everything if the sum may be 0.
    is_clear = absolute(base) > error * _CLEAR
    t, relative = _dot(corner, n) / base, h * h / absolute(base)
    size = absolute(t)
    slack = relative * (size * _BASE_ERROR + reach * _TOP_ERROR) + size * _RATIO_ERROR
    least, most = select(is_clear, t - slack, -INF_F64), select(is_clear, t + slack, INF_F64)
    found = found & (least <= t_far) & (most >= t_min)
    # Step 3: the others' signs are equal for sure, or in doubt.
    return PossibleHits(found, is_clear & ((low > error) | (high < -error)), least, most)


def block_test(take: Callable[..., Any]) -> Callable[..., Any]:
    """Make the test of a block's triangles against a ray, for what becomes of its hits.

    Parameters
    ----------
    take : device function
        ``take(search, line, span, triangle, prim_id) -> (search, is_over)`` offers a triangle that
        the ray may hit to a search; see `search.offer` for the arguments. Hits beyond the search's
        ``t_far`` are not wanted.

    Returns
    -------
    device function
        ``test(search, line, edges, block, spans) -> (search, is_over)``: the search and the `Line`
        of a ray, the four triangles, see `load_edges`, of the block at an address, and the address
        of 64 bytes.
    """

    @device
    def test(search, line, edges, block, spans):
        hits = test_lanes(edges, line.origin, line.direction, line.t_min, search.t_far, None)
        found, sure = mask_bits(hits.found), mask_bits(hits.sure)
        if found != ZERO_U64:
            store(spans, hits.low)
            store(spans + _HIGH, hits.high)
        while found != ZERO_U64:
            lane = count_trailing_zeros(found)
            found &= found - ONE_U64
            prim_id = load(np.int32, block + PRIM_IDS + (lane << SHIFT_32))
            span, triangle = span_of(spans, _HIGH, lane, sure), block + (lane << SHIFT_64)
            search, is_over = take(search, line, span, triangle, prim_id)
            if is_over:
                return search, True
        return search, False

    return test


@device
def span_of(spans, high_at, lane, sure):
    """The interval of a lane in memory, and whether the triangle is hit for sure."""
    at, is_sure = spans + (lane << SHIFT_64), (sure >> lane) & ONE_U64 != ZERO_U64
    return load(np.float64, at), load(np.float64, at + high_at), is_sure
