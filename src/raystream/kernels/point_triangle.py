"""The distance from a point to a triangle in float64: the definition that every structure shares.

A triangle has seven features: its face, three edges and three vertices. Each that the point
projects onto gives a candidate, and the least is the distance, so that no case depends on a sign
that rounding can turn: a wrong one costs no more than the rounding itself. Triangles that share an
edge or a vertex compute its distance from the same numbers in an order that does not depend on the
triangle, so the distances have equal bits, and the lowest prim_id can win.

The corners are float32 in the scene's local frame, the point is float64 in the same frame.
Differences of corners are exact but for extreme ratios, and the normal is within a few roundings,
which needles need. Each function takes numbers, or vectors for triangles side by side, with the
same bits; nothing else here may be fused, or reordered.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.jit.constants import INF_F64, ONE_F64, ZERO_F64
from raystream.jit.cpu import device
from raystream.jit.simd import absolute, fma, minimum, select
from raystream.kernels.vectors import cross, dot, minus

_QUARTER = np.float64(0.25)
_HALF = np.float64(0.5)


class Features(NamedTuple):
    """Squared distances to the features of a triangle; inf for those that are not projected onto.

    Attributes
    ----------
    squared : float64
        The least of them: the triangle's distance. NaN where a corner is NaN.
    vertices, edges : triple of float64
        Of a, b, c; and of ab, bc, ca without their ends.
    along : triple of float64
        Places on the edges, from -1 at their first to 1 at their second end.
    weights : triple of float64
        Areas opposite to a, b, c, to a common scale.
    """

    squared: object
    vertices: tuple[object, object, object]
    edges: tuple[object, object, object]
    along: tuple[object, object, object]
    weights: tuple[object, object, object]


class Foot(NamedTuple):
    """The point of a triangle nearest to another point.

    Attributes
    ----------
    squared : float64
        Squared distance, see `Features`.
    x, y, z : float64
    u, v : float64
        Weights of vertices 1 and 2.
    """

    squared: float
    x: float
    y: float
    z: float
    u: float
    v: float


@device
def _products(a, b, c, d):
    """``a * b - c * d``, within two roundings of itself however the products cancel.

    Jeannerod, Louvet and Muller, "Further analysis of Kahan's algorithm for the accurate
    computation of 2 x 2 determinants", Mathematics of Computation 82, 2013.
    """
    product = c * d
    error = fma(-c, d, product)
    return fma(a, b, -product) + error


@device
def _normal(p, q):
    """The cross product, accurate also of vectors that are almost parallel, as a needle's sides."""
    return (
        _products(p[1], q[2], p[2], q[1]),
        _products(p[2], q[0], p[0], q[2]),
        _products(p[0], q[1], p[1], q[0]),
    )


@device
def _edge(to_p, to_q, edge):
    """Squared distance to the inside of an edge pq, and the place on it.

    Parameters
    ----------
    to_p, to_q : triple of float64
        From its ends to the point.
    edge : triple of float64
        From p to q.

    Notes
    -----
    Twice the vector from the middle to the point is ``to_p + to_q``. Exchanging the ends changes
    no more than signs.
    """
    twice = to_p[0] + to_q[0], to_p[1] + to_q[1], to_p[2] + to_q[2]
    product, length = dot(twice, edge), dot(edge, edge)
    along = product / length
    off = twice[0] - along * edge[0], twice[1] - along * edge[1], twice[2] - along * edge[2]
    return select(absolute(product) < length, _QUARTER * dot(off, off), INF_F64), along


@device
def triangle_features(point, a, b, c):
    """How far a point is from a triangle, or from several side by side, and from its features.

    Parameters
    ----------
    point : triple of float64
    a, b, c : triple of float64, or of float64 vectors
        The corners.

    Returns
    -------
    Features
        Of numbers, or vectors.
    """
    to_a, to_b, to_c = minus(point, a), minus(point, b), minus(point, c)
    ab, bc, ca = minus(b, a), minus(c, b), minus(a, c)
    at_a, at_b, at_c = dot(to_a, to_a), dot(to_b, to_b), dot(to_c, to_c)
    on_ab, along_ab = _edge(to_a, to_b, ab)
    on_bc, along_bc = _edge(to_b, to_c, bc)
    on_ca, along_ca = _edge(to_c, to_a, ca)
    # The plane is measured from the nearest vertex, the one with the least rounding.
    normal = _normal(ca, ab)
    b_is_nearer = at_b < at_a
    c_is_nearest = at_c < minimum(at_a, at_b)
    height = dot(
        normal,
        (
            select(c_is_nearest, to_c[0], select(b_is_nearer, to_b[0], to_a[0])),
            select(c_is_nearest, to_c[1], select(b_is_nearer, to_b[1], to_a[1])),
            select(c_is_nearest, to_c[2], select(b_is_nearer, to_b[2], to_a[2])),
        ),
    )
    from_a, from_b = cross(to_a, normal), cross(to_b, normal)
    of_a, of_b, of_c = dot(bc, from_b), dot(ca, from_a), dot(ab, from_a)
    is_inside = (of_a > ZERO_F64) & (of_b > ZERO_F64) & (of_c > ZERO_F64)
    face = select(is_inside, height * height / dot(normal, normal), INF_F64)
    nearest = minimum(face, minimum(on_ab, minimum(on_bc, on_ca)))
    # In this order a triangle with a NaN has NaN.
    squared = minimum(nearest, minimum(at_a, minimum(at_b, at_c)))
    edges, along = (on_ab, on_bc, on_ca), (along_ab, along_bc, along_ca)
    return Features(squared, (at_a, at_b, at_c), edges, along, (of_a, of_b, of_c))


@device
def _between(along):
    """Weights of an edge's ends at a place on it."""
    return _HALF * (ONE_F64 - along), _HALF * (ONE_F64 + along)


@device
def _nearest_weights(features):
    """The weights of a, b and c at the nearest point: of the first of the nearest features."""
    least, at, on = features.squared, features.vertices, features.edges
    if at[0] == least:
        return ONE_F64, ZERO_F64, ZERO_F64
    if at[1] == least:
        return ZERO_F64, ONE_F64, ZERO_F64
    if at[2] == least:
        return ZERO_F64, ZERO_F64, ONE_F64
    if on[0] == least:
        p, q = _between(features.along[0])
        return p, q, ZERO_F64
    if on[1] == least:
        p, q = _between(features.along[1])
        return ZERO_F64, p, q
    if on[2] == least:
        p, q = _between(features.along[2])
        return q, ZERO_F64, p
    areas = features.weights
    total = areas[0] + areas[1] + areas[2]
    return areas[0] / total, areas[1] / total, areas[2] / total


@device
def foot_of(features, a, b, c):
    """The nearest point of a triangle, of its features and its corners.

    Parameters
    ----------
    features : Features
        Of numbers.
    a, b, c : triple of float64

    Returns
    -------
    Foot
        Exactly a vertex, or with a weight of exactly 0 on an edge, where that is nearest.
    """
    of_a, of_b, of_c = _nearest_weights(features)
    x = of_a * a[0] + of_b * b[0] + of_c * c[0]
    y = of_a * a[1] + of_b * b[1] + of_c * c[1]
    z = of_a * a[2] + of_b * b[2] + of_c * c[2]
    return Foot(features.squared, x, y, z, of_b, of_c)
