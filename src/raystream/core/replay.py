"""The crossing of a ray with a triangle that is known: formulas for libraries with gradients.

Each is written once, with operators and ``where`` alone, for NumPy, PyTorch and JAX.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.hits import MultiHits
from raystream.core.triangles import Triangles

__all__ = ["Crossing", "PaddedHits", "corners_of", "pad", "points_at", "replay"]

#: What a miss is replaced by, so that its numbers and gradients are finite: a triangle, and a ray
#: that crosses it.
_CORNERS = ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
_ORIGIN, _DIRECTION = (0.0, 0.0, 1.0), (0.0, 0.0, -1.0)


class Crossing(NamedTuple):
    """Where rays cross the planes of triangles: ``t``, ``u`` and ``v``, of the rays' shape."""

    t: Any
    u: Any
    v: Any


class PaddedHits(NamedTuple):
    """The nearest hits of each ray, as NumPy arrays of shape S + (max_hits,); see `pad`."""

    t: NDArray[np.float32]
    u: NDArray[np.float32]
    v: NDArray[np.float32]
    prim_id: NDArray[np.int32]


def replay(library: Any, origins: Any, directions: Any, corners: Any, is_hit: Any) -> Crossing:
    """t, u and v of rays and the triangles that they hit, as functions of their coordinates.

    Parameters
    ----------
    library : module
        `numpy`, `torch` or `jax.numpy`, whose arrays the others are.
    origins, directions : array of shape S + (3,), float
        They broadcast.
    corners : array of shape S + (3, 3), float
        Vertices 0, 1 and 2 of the triangle of each ray.
    is_hit : array of shape S, bool
        Where it is false, the results are 0 and have no gradient, whatever the numbers are.

    Returns
    -------
    Crossing
        0, without a gradient, also where the ray lies in the triangle's plane as far as the
        arrays' precision can tell.

    References
    ----------
    .. [1] Möller and Trumbore, "Fast, Minimum Storage Ray/Triangle Intersection", Journal of
       Graphics Tools 2(1), 1997.
    """
    where = library.where
    origin = _components(where, is_hit, origins, _ORIGIN)
    direction = _components(where, is_hit, directions, _DIRECTION)
    first, second, third = (
        _components(where, is_hit, corners[..., k, :], _CORNERS[k]) for k in range(3)
    )
    along_u, along_v = _minus(second, first), _minus(third, first)
    offset = _minus(origin, first)
    across = _cross(direction, along_v)
    volume = _dot(along_u, across)
    is_sound = is_hit & (volume != 0.0)
    inverse = 1.0 / where(is_sound, volume, 1.0)
    turned = _cross(offset, along_u)
    u = _dot(offset, across) * inverse
    v = _dot(direction, turned) * inverse
    t = _dot(along_v, turned) * inverse
    return Crossing(*(where(is_sound, value, 0.0) for value in (t, u, v)))


def points_at(library: Any, corners: Any, u: Any, v: Any, is_hit: Any) -> tuple[Any, Any, Any]:
    """The points of triangles with these weights of vertices 1 and 2; a miss has NaN.

    Parameters
    ----------
    library : module
    corners : array of shape S + (3, 3), float
    u, v : array of shape S, float
    is_hit : array of shape S, bool

    Returns
    -------
    x, y, z : arrays of shape S
    """
    first, second, third = (
        _components(library.where, is_hit, corners[..., k, :], _CORNERS[k]) for k in range(3)
    )
    x, y, z = (
        library.where(is_hit, a + u * (b - a) + v * (c - a), np.nan)
        for a, b, c in zip(first, second, third, strict=True)
    )
    return x, y, z


def _components(where: Any, is_hit: Any, vectors: Any, instead: tuple[float, ...]) -> list[Any]:
    return [where(is_hit, vectors[..., k], instead[k]) for k in range(3)]


def _minus(a: Any, b: Any) -> list[Any]:
    return [p - q for p, q in zip(a, b, strict=True)]


def _dot(a: Any, b: Any) -> Any:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a: Any, b: Any) -> tuple[Any, Any, Any]:
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


def corners_of(triangles: Triangles, prim_id: NDArray[np.int32]) -> NDArray[np.float64]:
    """Vertices 0, 1 and 2 of triangles, shape S + (3, 3), float64, world space; any for -1."""
    if not len(triangles):
        return np.zeros((*prim_id.shape, 3, 3))
    return triangles.to_world(triangles.corners[np.maximum(prim_id, 0)])


def pad(found: MultiHits, max_hits: int) -> PaddedHits:
    """Hits of each ray in rows of one length, after the last one as for a miss.

    Parameters
    ----------
    found : MultiHits
        At most `max_hits` of each ray.
    max_hits : int

    Returns
    -------
    PaddedHits
        Of the rays' shape + (max_hits,). Without a hit ``t`` is inf, ``u`` and ``v`` are 0 and
        ``prim_id`` is -1.
    """
    shape = (*found.status.shape, max_hits)
    rank = np.arange(len(found.t)) - found.ray_splits[found.ray_id]
    place = found.ray_id * max_hits + rank
    columns = []
    for values, missing in ((found.t, np.inf), (found.u, 0), (found.v, 0), (found.prim_id, -1)):
        padded = np.full(shape, missing, values.dtype)
        padded.reshape(-1)[place] = values
        columns.append(padded)
    return PaddedHits(*columns)
