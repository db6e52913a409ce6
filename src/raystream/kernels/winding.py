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
from typing import NamedTuple

import numpy as np

from raystream.jit.constants import ONE_U64, SHIFT_32, SHIFT_64, ZERO_U64
from raystream.jit.cpu import device
from raystream.jit.intrinsics import corners_at
from raystream.jit.simd import absolute, f64x8, load, select, square_root, store
from raystream.kernels.answers import loop_of
from raystream.kernels.point_order import load_point, point_at

#: Points side by side.
LANES = 8

_U8 = np.uint64(LANES)
_0, _1, _MINUS_1 = np.float64(0.0), np.float64(1.0), np.float64(-1.0)
_X, _Y, _Z = np.uint64(0), np.uint64(64), np.uint64(128)


@device
def dot(p, q):
    """Dot product."""
    return p[0] * q[0] + p[1] * q[1] + p[2] * q[2]


@device
def _to_corner(corners, prim_id, corner, point):
    """From eight points to a corner of a triangle."""
    return (
        np.float64(corners[prim_id, corner, 0]) - point[0],
        np.float64(corners[prim_id, corner, 1]) - point[1],
        np.float64(corners[prim_id, corner, 2]) - point[2],
    )


@device
def _half_angle(a, b, c):
    """Real and imaginary part of a number whose argument is half of the solid angle."""
    x = b[1] * c[2] - b[2] * c[1]
    y = b[2] * c[0] - b[0] * c[2]
    z = b[0] * c[1] - b[1] * c[0]
    of_a, of_b, of_c = square_root(dot(a, a)), square_root(dot(b, b)), square_root(dot(c, c))
    real = of_a * of_b * of_c + dot(a, b) * of_c + dot(b, c) * of_a + dot(c, a) * of_b
    return real, a[0] * x + a[1] * y + a[2] * z


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
    a = _to_corner(corners, prim_id, 0, point)
    b = _to_corner(corners, prim_id, 1, point)
    c = _to_corner(corners, prim_id, 2, point)
    return _turned(angle, _half_angle(a, b, c))


@device
def numbers_of(angle, memory):
    """The winding numbers of eight sums; `memory` is the address of 128 bytes."""
    store(memory + _X, angle[0])
    # Adding zero turns -0 into 0: the argument of a negative number is pi.
    store(memory + _Y, angle[1] + _0)
    for k in range(_U8):
        at = memory + (k << SHIFT_64)
        part = math.atan2(load(np.float64, at + _Y), load(np.float64, at + _X))
        store(at, part / (2.0 * math.pi))
    return load(f64x8, memory) + angle[2]


@device
def load_eight(points, order, end, i, memory):
    """The eight points that are answered from the i-th on, or fewer and the last one repeatedly.

    Parameters
    ----------
    points : uint64
        Address of three float64 a point.
    order : PointOrder or None
    end, i : uint64
    memory : uint64
        Address of 192 bytes.
    """
    for k in range(_U8):
        x, y, z = load_point(points, point_at(order, min(i + k, end - ONE_U64)))
        at = memory + (k << SHIFT_64)
        store(at + _X, x)
        store(at + _Y, y)
        store(at + _Z, z)
    return load(f64x8, memory + _X), load(f64x8, memory + _Y), load(f64x8, memory + _Z)


@device
def store_eight(to, order, end, i, values, memory):
    """Write the values of these points; `to` is the address of the first point's."""
    store(memory, values)
    for k in range(min(_U8, end - i)):
        value = load(np.float64, memory + (k << SHIFT_64))
        store(to + (point_at(order, i + k) << SHIFT_64), value)


@device
def is_first_of_eight(i):
    """Whether the answer of a point is that of the next ones, too."""
    return i & (_U8 - ONE_U64) == ZERO_U64


class WindingScene(NamedTuple):
    """What exact winding numbers are computed from.

    Attributes
    ----------
    points : uint64
        Address of three float64 a point, finite: the local frame.
    corners : uint64
        Address of the triangles' corners, float32.
    prim_ids : uint64
        Address of the triangles that count, int32.
    point_count, triangle_count : uint64
    """

    points: np.uint64
    corners: np.uint64
    prim_ids: np.uint64
    point_count: np.uint64
    triangle_count: np.uint64


@device
def _answer(i, scene, numbers, memory):
    """Write the winding numbers of eight points; see `kernels.answers`."""
    if is_first_of_eight(i):
        points, corners, prim_ids, end, triangle_count = scene
        point = load_eight(points, None, end, i, memory)
        angle = f64x8(_1), f64x8(_0), f64x8(_0)
        for k in range(triangle_count):
            prim_id = load(np.int32, prim_ids + (k << SHIFT_32))
            angle = add_triangle(angle, corners_at(corners), prim_id, point)
        store_eight(numbers, None, end, i, numbers_of(angle, memory), memory)


#: The loop of exact sums: calls begin at multiples of `LANES`.
winding_numbers = loop_of(_answer, 192)
