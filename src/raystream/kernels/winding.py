"""Generalised winding numbers: the solid angle of a surface as seen from a point.

The sum over all triangles of their signed solid angles, by the formula of Van Oosterom and
Strackee [1]_, divided by 4 pi (Jacobson et al. [2]_). Half of a triangle's solid angle is the
argument of a complex number; the numbers are multiplied and full turns counted, so that a triangle
takes no arctangent. Eight points are computed side by side.

References
----------
.. [1] Van Oosterom and Strackee, "The Solid Angle of a Plane Triangle", IEEE Transactions on
   Biomedical Engineering 30(2), 1983.
.. [2] Jacobson, Kavan and Sorkine-Hornung, "Robust Inside-Outside Segmentation using Generalized
   Winding Numbers", ACM Transactions on Graphics 32(4), 2013.
"""

from __future__ import annotations

import math

import numpy as np

from raystream.jit.constants import ONE_U64, SHIFT_64
from raystream.jit.cpu import device, kernel
from raystream.jit.simd import absolute, f64x8, load, scratch, select, square_root, store
from raystream.kernels.vectors import corner_of, cross, dot, minus

#: Points side by side.
LANES = 8

_U8 = np.uint64(LANES)
_0, _1, _MINUS_1 = np.float64(0.0), np.float64(1.0), np.float64(-1.0)
_X, _Y, _Z = np.uint64(0), np.uint64(64), np.uint64(128)


@device
def _half_angle(a, b, c):
    """Real and imaginary part of a number whose argument is half of the solid angle."""
    of_a, of_b, of_c = square_root(dot(a, a)), square_root(dot(b, b)), square_root(dot(c, c))
    real = of_a * of_b * of_c + dot(a, b) * of_c + dot(b, c) * of_a + dot(c, a) * of_b
    return real, dot(a, cross(b, c))


@device
def _turned(angle, by):
    """Multiply two numbers and count the turns: arguments are above -pi, and at most pi.

    Parameters
    ----------
    angle : tuple of three f64x8
        Real part, imaginary part and turns.
    by : tuple of two f64x8
        Only the argument counts. Zero, for a point on an edge or a vertex, changes nothing.
    """
    p, q, turns = angle
    r, s = by
    real, imaginary = p * r - q * s, p * s + q * r
    size = absolute(real) + absolute(imaginary)
    real, imaginary = real / size, imaginary / size
    over = (s > _0) & (q >= _0) & (imaginary < _0)
    from_lower = (q < _0) | ((q == _0) & (p > _0))
    to_upper = (imaginary > _0) | ((imaginary == _0) & (real < _0))
    under = (s < _0) & from_lower & to_upper
    turns = turns + select(over, f64x8(_1), select(under, f64x8(_MINUS_1), f64x8(_0)))
    counts = size > _0
    return select(counts, real, p), select(counts, imaginary, q), turns


@device
def add_triangle(angle, corners, prim_id, point):
    """Add a triangle's solid angle, as seen from eight points, to a sum; see `_turned`."""
    a = minus(corner_of(corners, prim_id, 0), point)
    b = minus(corner_of(corners, prim_id, 1), point)
    c = minus(corner_of(corners, prim_id, 2), point)
    return _turned(angle, _half_angle(a, b, c))


@kernel
def winding_numbers(begin, end, points, corners, prim_ids, numbers):
    """Compute the winding numbers of points begin to end.

    Parameters
    ----------
    begin, end : int
    points : ndarray of shape (N, 3), float64
        Local frame, finite.
    corners : ndarray of shape (F, 3, 3), float32
    prim_ids : ndarray of shape (A,), int32
        The triangles that count.
    numbers : ndarray of shape (N,), float64
        Written.
    """
    lanes = scratch(192)
    first, last = np.uint64(begin), np.uint64(end)
    while first < last:
        for k in range(_U8):
            i = min(first + k, last - ONE_U64)
            at = lanes + (k << SHIFT_64)
            store(at + _X, points[i, 0])
            store(at + _Y, points[i, 1])
            store(at + _Z, points[i, 2])
        point = load(f64x8, lanes + _X), load(f64x8, lanes + _Y), load(f64x8, lanes + _Z)
        angle = f64x8(_1), f64x8(_0), f64x8(_0)
        for k in range(np.uint64(len(prim_ids))):
            angle = add_triangle(angle, corners, prim_ids[k], point)
        store(lanes + _X, angle[0])
        store(lanes + _Y, angle[1])
        store(lanes + _Z, angle[2])
        for k in range(min(_U8, last - first)):
            at = lanes + (k << SHIFT_64)
            # Adding zero turns -0 into 0: the argument of a negative number is pi.
            imaginary = load(np.float64, at + _Y) + _0
            part = math.atan2(imaginary, load(np.float64, at + _X)) / (2.0 * math.pi)
            numbers[first + k] = part + load(np.float64, at + _Z)
        first += _U8
