"""Rays against triangles in exact rational arithmetic: what tracers in float64 must answer.

Independent of the kernels: the determinants are those of Cramer's rule, in Python's fractions.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["ExactHit", "hit_of", "hits_of", "nearest_of"]

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
