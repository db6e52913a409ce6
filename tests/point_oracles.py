"""Independent answers for points: nearest triangles in float64 and in rationals, and insides."""

from __future__ import annotations

from fractions import Fraction

import numpy as np

#: Errors of raystream's distances, in units of the distance and the triangle's size together:
#: 2**-48 as stated, and as much again for the oracle's.
TOLERANCE = 2.0**-47


def distances(points, corners):
    """Distances of (N, 3) points from (F, 3, 3) triangles, shape (N, F), in long double.

    The height over the plane where the point is within the three planes through the edges that
    are perpendicular to it, else the nearest of three clamped segments.
    """
    points, corners = np.asarray(points, np.longdouble), np.asarray(corners, np.longdouble)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.sqrt((normal**2).sum(axis=-1))[:, None]
    inside, best = True, np.inf
    for k in range(3):
        start = corners[:, k]
        along = corners[:, (k + 1) % 3] - start
        off = points[:, None] - start
        inside = inside & (np.einsum("nfk,fk->nf", off, np.cross(normal, along)) >= 0)
        t = np.einsum("nfk,fk->nf", off, along) / (along**2).sum(axis=-1)
        gap = off - np.clip(t, 0, 1)[..., None] * along
        best = np.minimum(best, np.sqrt((gap**2).sum(axis=-1)))
    height = np.abs(np.einsum("nfk,fk->nf", points[:, None] - corners[:, 0], normal))
    return np.where(inside, np.minimum(height, best), best).astype(np.float64)


def _minus(p, q):
    return tuple(x - y for x, y in zip(p, q, strict=True))


def _dot(p, q):
    return sum(x * y for x, y in zip(p, q, strict=True))


def _cross(p, q):
    return (
        p[1] * q[2] - p[2] * q[1],
        p[2] * q[0] - p[0] * q[2],
        p[0] * q[1] - p[1] * q[0],
    )


def exact_square(point, triangle):
    """The squared distance as a fraction: no rounding at all."""
    p = tuple(map(Fraction, map(float, point)))
    a, b, c = (tuple(map(Fraction, map(float, corner))) for corner in triangle)
    normal = _cross(_minus(b, a), _minus(c, a))
    edges = ((a, b), (b, c), (c, a))
    if all(_dot(_cross(_minus(q, o), _minus(p, o)), normal) >= 0 for o, q in edges):
        return _dot(normal, _minus(p, a)) ** 2 / _dot(normal, normal)
    squares = []
    for o, q in edges:
        along = _minus(q, o)
        t = min(max(_dot(_minus(p, o), along) / _dot(along, along), Fraction(0)), Fraction(1))
        off = _minus(p, tuple(x + t * y for x, y in zip(o, along, strict=True)))
        squares.append(_dot(off, off))
    return min(squares)


def local_scene(tracer):
    """The float32 corners of a tracer's triangles that count, in float64, and their prim_ids."""
    triangles = tracer.structure.triangles
    ids = np.asarray(triangles.prim_ids)
    return triangles.corners[ids].astype(np.float64), ids


def to_local(tracer, points):
    triangles = tracer.structure.triangles
    return (np.asarray(points, np.float64) - triangles.center) * triangles.scale


def check_nearest(tracer, points, found, rows_at_once=1 << 20):
    """Compare `closest_point` with the oracle; returns the number of points compared."""
    corners, ids = local_scene(tracer)
    scale = tracer.structure.triangles.scale
    size = np.ptp(corners, axis=1).max(axis=-1)
    local = to_local(tracer, points).reshape(-1, 3)
    distance, prim_id = found.distance.reshape(-1) * scale, found.prim_id.reshape(-1)
    places = np.searchsorted(ids, prim_id)
    step = max(rows_at_once // len(corners), 1)
    for first in range(0, len(local), step):
        rows = slice(first, first + step)
        expected = distances(local[rows], corners)
        tolerance = TOLERANCE * (expected + size)
        n = np.arange(len(expected))
        assert (ids[places[rows]] == prim_id[rows]).all()
        chosen = expected[n, places[rows]]
        error = np.abs(distance[rows] - chosen)
        assert (error <= tolerance[n, places[rows]]).all(), error.max()
        # No other triangle is nearer for sure.
        nearer = (expected + tolerance).min(axis=1)
        assert (distance[rows] <= nearer).all()
    return len(local)


def check_feet(tracer, points, found):
    """Positions lie on their triangles, as far away as stated, with the weights stated."""
    triangles = tracer.structure.triangles
    is_found = found.prim_id >= 0
    foot, given = (
        found.positions[is_found],
        np.broadcast_to(points, found.positions.shape)[is_found],
    )
    corners = triangles.corners[found.prim_id[is_found]].astype(np.float64)
    world = triangles.to_world(corners)
    reach = np.abs(world).max() + np.abs(given).max()
    gap = np.linalg.norm(given - foot, axis=-1)
    assert np.allclose(gap, found.distance[is_found], rtol=1e-9, atol=2.0**-40 * reach)
    u, v = (one[is_found].astype(np.float64)[:, None] for one in (found.u, found.v))
    assert (u >= 0).all()
    assert (v >= 0).all()
    assert (u + v <= 1 + 2.0**-22).all()
    blend = (1 - u - v) * world[:, 0] + u * world[:, 1] + v * world[:, 2]
    size = np.ptp(world, axis=1).max()
    assert np.abs(blend - foot).max(initial=0) <= 2.0**-20 * size + 2.0**-40 * reach
