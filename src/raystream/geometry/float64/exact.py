"""Whether a ray hits a triangle, and where: exactly, in as few digits as that takes.

First with numbers of twice the precision of float64, and bounds of their errors; what is still in
doubt, such as rays through edges and vertices, by exact sums of products.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from raystream.geometry.float64.block import load_corners
from raystream.geometry.float64.double_numbers import (
    add_double,
    cross_double,
    cross_with,
    difference,
    divide_double,
    dot_double,
    dot_with,
    negate_double,
)
from raystream.geometry.float64.expansions import determinant_value, rounded_ratio
from raystream.jit.constants import INF_F64, ONE_F64, ZERO_F64
from raystream.jit.cpu import device, device_call
from raystream.jit.intrinsics import no_inline
from raystream.jit.simd import absolute, maximum, minimum
from raystream.kernels.ray import largest

#: Errors of weights, as parts of h (M + h), see `geometry.float64.block`: 2**-96 with a margin.
_SIGN_ERROR = np.float64(2.0**-94)

#: Errors of the numerator of a distance, as a part of M h h, of its denominator, as a part of
#: h h, and of the division.
_TOP_ERROR = np.float64(2.0**-96)
_BASE_ERROR = np.float64(2.0**-96)
_RATIO_ERROR = np.float64(2.0**-98)

#: With a smaller sum of the weights, as a part of h (M + h), they are computed exactly.
_LEAST_BASE = np.float64(2.0**-40)


@device
def _differences(x, y):
    return difference(x[0], y[0]), difference(x[1], y[1]), difference(x[2], y[2])


@device
def _largest(x):
    return largest((x[0][0], x[1][0], x[2][0]))


class Estimate(NamedTuple):
    """A ray's hit of a triangle in numbers of twice the precision; of numbers, or of vectors.

    Attributes
    ----------
    corner, p, q : triple
        Vertex 0 from the origin, and the two edges there, exactly.
    weights : tuple
        Numbers in proportion to the weights of vertices 0, 1, 2, and the inverse of their sum.
    is_sure : bool or mask
        Whether the signs of the three are known, and the sum well enough for the quotients.
    t : number or vector
        About the distance.
    is_rounded : bool or mask
        Whether `t` is the distance, rounded to nearest, for sure. If all numbers within the bounds
        round to the same one, that is it. (Ziv, "Fast Evaluation of Elementary Mathematical
        Functions with Correctly Rounded Last Bit", ACM TOMS 17(3), 1991.)
    is_known : bool or mask
        Both: then `t`, `u` and `v` are those of `solve_exactly`.
    u, v : number or vector
        See there.
    """

    corner: Any
    p: Any
    q: Any
    weights: Any
    is_sure: Any
    t: Any
    is_rounded: Any
    is_known: Any
    u: Any
    v: Any


@device
def estimate(a, b, c, origin, direction):
    """The `Estimate` of a hit, from triples of float64 numbers or vectors."""
    corner = _differences(a, origin)
    p, q = _differences(b, a), _differences(c, a)
    reach, h = _largest(corner), maximum(_largest(p), _largest(q))
    # Step 1: the weights, as in `geometry.float64.block`.
    moment, normal = cross_with(corner, direction), cross_double(p, q)
    v, w = dot_double(q, moment), negate_double(dot_double(p, moment))
    base, top = dot_with(normal, direction), dot_double(corner, normal)
    u = add_double(add_double(base, negate_double(v)), negate_double(w))
    # Step 2: whether the errors of the weights leave their signs.
    size = h * (reach + h)
    least = minimum(minimum(absolute(u[0]), absolute(v[0])), absolute(w[0]))
    is_sure = (least > size * _SIGN_ERROR) & (absolute(base[0]) > size * _LEAST_BASE)
    # Step 3: the distance, and whether its error leaves its last digit.
    t, rest = divide_double(top, base)
    length, inverse = absolute(t), ONE_F64 / base[0]
    slack = h * h * (reach * _TOP_ERROR + length * _BASE_ERROR) * absolute(inverse)
    slack += length * _RATIO_ERROR
    is_rounded = (t + (rest + slack) == t) & (t + (rest - slack) == t)
    weights, is_known = (u[0], v[0], w[0], inverse), is_sure & is_rounded
    uv = _barycentrics(v[0], w[0], inverse)
    return Estimate(corner, p, q, weights, is_sure, t, is_rounded, is_known, *uv)


@device
def _barycentrics(weight_v, weight_w, inverse):
    """Weights u and v of a hit's vertices 1 and 2, from numbers in proportion to them."""
    u, v = absolute(weight_v * inverse), absolute(weight_w * inverse)
    return minimum(u, ONE_F64), minimum(v, ONE_F64)


@device
def _alone(x):
    """A triple of float64 numbers as sums of two."""
    return (x[0], ZERO_F64), (x[1], ZERO_F64), (x[2], ZERO_F64)


@device
def _pick(k, x):
    return x[0] if k == 0 else (x[1] if k == 1 else x[2])


@device
def _image_difference(edge, d, k, z):
    """An edge along axis k, in the frame whose z axis is the ray, times d[z]: the sign is exact."""
    # edge[k] * d[z] - edge[z] * d[k], as a determinant with a unit vector.
    zero, one = (ZERO_F64, ZERO_F64), (ONE_F64, ZERO_F64)
    first = _pick(k, edge), _pick(z, edge), zero
    second = (_pick(k, d), ZERO_F64), (_pick(z, d), ZERO_F64), zero
    return determinant_value(first, second, (zero, zero, one))


@device_call
def _moved_sign(edge, d):
    """Sign of a weight that is 0 once the ray moves by (e, e * e), e to 0: the top-left rule.

    Parameters
    ----------
    edge : triple of sums of two
        The opposite edge, in the order in which the vertices run.
    d : triple of float64
        The ray's direction. It moves along the axes of its frame, as in `kernels.triangle`.
    """
    no_inline()
    ax, ay, az = abs(d[0]), abs(d[1]), abs(d[2])
    z = 0
    if ay > ax:
        z = 1
    if az > max(ax, ay):
        z = 2
    x = z + 1 if z < 2 else 0
    y = x + 1 if x < 2 else 0
    across = _image_difference(edge, d, y, z)
    return -across if across != 0.0 else _image_difference(edge, d, x, z)


@device_call
def solve_exactly(line, triangle, surfaces):
    """Intersect a ray with a triangle.

    Parameters
    ----------
    line : Line
    triangle : uint64
        Address of the triangle's first number in a block.
    surfaces : bool
        Whether a ray exactly through an edge or a vertex hits every triangle there (False), or
        one per crossing of the surface (True).

    Returns
    -------
    hit : bool
        Whether the ray's line hits the triangle, at any t.
    t, u, v : float64
        The distance, rounded to nearest from the exact value, in lengths of the line's direction;
        weights of vertices 1 and 2, within a few units in the last place.
    """
    no_inline()
    o, d = line.origin, line.direction
    a, b, c = load_corners(np.float64, triangle)
    corner, p, q, weights, is_sure, t, is_rounded, _, _, _ = estimate(a, b, c, o, d)
    weight_u, weight_v, weight_w, inverse = weights
    if not is_sure:
        way = _alone(d)
        weight_u = determinant_value(way, _differences(b, o), _differences(c, o))
        weight_v = determinant_value(q, corner, way)
        weight_w = -determinant_value(p, corner, way)
        inverse = ONE_F64 / determinant_value(way, p, q)
    # A miss if two signs differ, or if the ray lies in the triangle's plane.
    low, high = min(weight_u, weight_v, weight_w), max(weight_u, weight_v, weight_w)
    if (low < 0.0 and high > 0.0) or (low == 0.0 and high == 0.0):
        return False, INF_F64, ZERO_F64, ZERO_F64
    # Through an edge or a vertex: of this surface's triangles, one is hit.
    if surfaces and (low == 0.0 or high == 0.0):
        sign_u = weight_u if weight_u != 0.0 else _moved_sign(_differences(c, b), d)
        sign_v = weight_v if weight_v != 0.0 else _moved_sign(_differences(a, c), d)
        sign_w = weight_w if weight_w != 0.0 else _moved_sign(p, d)
        if not (min(sign_u, sign_v, sign_w) > 0.0 or max(sign_u, sign_v, sign_w) < 0.0):
            return False, INF_F64, ZERO_F64, ZERO_F64
    if not is_rounded:
        t = rounded_ratio(corner, p, q, _alone(d))
    u, v = _barycentrics(weight_v, weight_w, inverse)
    return True, t, u, v
