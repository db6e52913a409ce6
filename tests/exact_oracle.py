"""Rays against triangles in exact rational arithmetic: what tracers in float64 must answer.

Independent of the kernels: the determinants are those of Cramer's rule, in Python's fractions.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

_Vector = tuple[Fraction, Fraction, Fraction]


class ExactHit(NamedTuple):
    """A hit: the distance as a rational, and rounded to nearest; weights as rationals."""

    exact_t: Fraction
    t: float
    u: Fraction
    v: Fraction
    prim_id: int


def _vector(numbers: Any) -> _Vector:
    x, y, z = (Fraction(float(one)) for one in numbers)
    return x, y, z


def _minus(a: _Vector, b: _Vector) -> _Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def _cross(a: _Vector, b: _Vector) -> _Vector:
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


def _dot(a: _Vector, b: _Vector) -> Fraction:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def hit_of(origin: Any, direction: Any, corners: Any, prim_id: int = 0) -> ExactHit | None:
    """The hit of a ray's line with a triangle, at any t; None for a miss, or a ray in the plane."""
    o, d = _vector(origin), _vector(direction)
    a, b, c = (_minus(_vector(corner), o) for corner in corners)
    weights = _dot(d, _cross(b, c)), _dot(d, _cross(c, a)), _dot(d, _cross(a, b))
    total = sum(weights)
    if min(weights) < 0 < max(weights) or total == 0:
        return None
    t = _dot(a, _cross(b, c)) / total
    return ExactHit(t, t.numerator / t.denominator, weights[1] / total, weights[2] / total, prim_id)


def hits_of(
    origin: Any,
    direction: Any,
    corners: NDArray[Any],
    limits: tuple[float, float] = (0.0, np.inf),
    prim_ids: Sequence[int] | None = None,
) -> list[ExactHit]:
    """All hits of a ray within closed limits of the rounded distance, by that, then prim_id."""
    found = []
    for prim_id in range(len(corners)) if prim_ids is None else prim_ids:
        hit = hit_of(origin, direction, corners[prim_id], int(prim_id))
        if hit is not None and limits[0] <= hit.t <= limits[1]:
            found.append(hit)
    return sorted(found, key=lambda hit: (hit.t, hit.prim_id))


def nearest_of(
    origin: Any,
    direction: Any,
    corners: NDArray[Any],
    limits: tuple[float, float] = (0.0, np.inf),
    prim_ids: Sequence[int] | None = None,
) -> ExactHit | None:
    """The first of `hits_of`, or None."""
    return next(iter(hits_of(origin, direction, corners, limits, prim_ids)), None)


#: Coordinates of `nearest_many` are multiples of this.
GRAIN_BITS = 34

#: Candidates are triangles whose edge functions in float64 are not this much, of their terms'
#: size, on different sides: far more than rounding.
_SLACK = 1e-11


def on_grain(numbers: NDArray[Any]) -> NDArray[np.float64]:
    """Numbers rounded to multiples of 2**-GRAIN_BITS."""
    result: NDArray[np.float64] = np.round(np.ldexp(numbers, GRAIN_BITS))
    return np.ldexp(result, -GRAIN_BITS)


def _candidates(
    origins: NDArray[Any], directions: NDArray[Any], corners: NDArray[Any]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Pairs of rays and triangles that may meet: all that do, by float64 with much slack."""
    rays, prims = [], []
    length = np.abs(directions).max(axis=1)
    for prim_id, (a, b, c) in enumerate(corners):
        start = a - origins
        reach = np.abs(start).max(axis=1)
        p, q = b - a, c - a
        size = max(np.abs(p).max(), np.abs(q).max())
        moment = np.cross(start, directions)
        v, w = moment @ q, -(moment @ p)
        u = directions @ np.cross(p, q) - v - w
        slack = _SLACK * length * size * (reach + size)
        may = ~(
            (np.minimum(np.minimum(u, v), w) < -slack) & (np.maximum(np.maximum(u, v), w) > slack)
        )
        found = np.flatnonzero(may)
        rays.append(found)
        prims.append(np.full(len(found), prim_id))
    return np.concatenate(rays), np.concatenate(prims)


def _whole(numbers: NDArray[Any]) -> NDArray[Any]:
    """Multiples of the grain as Python's integers."""
    scaled = np.ldexp(numbers, GRAIN_BITS)
    assert (scaled == np.round(scaled)).all()
    assert (np.abs(scaled) < 2.0**62).all()
    return scaled.astype(np.int64).astype(object)


def _crossed(a: NDArray[Any], b: NDArray[Any]) -> NDArray[Any]:
    (ax, ay, az), (bx, by, bz) = a.T, b.T
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=1)


def _dotted(a: NDArray[Any], b: NDArray[Any]) -> NDArray[Any]:
    result: NDArray[Any] = a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1] + a[:, 2] * b[:, 2]
    return result


def nearest_many(
    origins: NDArray[Any], directions: NDArray[Any], corners: NDArray[Any]
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """The nearest hits of many rays within [0, inf], in Python's integers.

    Parameters
    ----------
    origins, directions : ndarray of shape (N, 3)
    corners : ndarray of shape (F, 3, 3)
        All multiples of 2**-GRAIN_BITS.

    Returns
    -------
    t : ndarray of shape (N,), float64
        Rounded once, from the exact distance; inf for a miss.
    prim_id : ndarray of shape (N,), int32
    """
    ray, prim = _candidates(origins, directions, corners)
    o, d = _whole(origins)[ray], _whole(directions)[ray]
    a, b, c = (_whole(corners[:, k])[prim] - o for k in range(3))
    weights = np.stack(
        [_dotted(d, _crossed(b, c)), _dotted(d, _crossed(c, a)), _dotted(d, _crossed(a, b))]
    )
    total, low, high = weights.sum(axis=0), weights.min(axis=0), weights.max(axis=0)
    hit = ((low >= 0) | (high <= 0)) & (total != 0)
    ray, prim = ray[hit], prim[hit]
    top = _dotted(a[hit], _crossed(b[hit], c[hit]))
    t = (top / total[hit]).astype(np.float64)  # of integers: rounded once
    ray, prim, t = ray[t >= 0], prim[t >= 0], t[t >= 0]
    order = np.lexsort((prim, t, ray))
    ray, prim, t = ray[order], prim[order], t[order]
    first = np.flatnonzero(np.diff(ray, prepend=-1))
    nearest_t = np.full(len(origins), np.inf)
    nearest_id = np.full(len(origins), -1, np.int32)
    nearest_t[ray[first]], nearest_id[ray[first]] = t[first], prim[first]
    return nearest_t, nearest_id
