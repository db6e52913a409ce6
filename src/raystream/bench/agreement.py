"""Agreement: how many rays get the same result from two contenders."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.bench.contenders.base import (
    MISS_T,
    AllHits,
    Closest,
    FirstHits,
    Points,
    Query,
    Rays,
    Result,
)

#: Relative difference of t below which two hits agree.
T_TOLERANCE = 1e-4

#: Difference below which two distances of a point agree, relative to the scene's diagonal.
POINT_TOLERANCE = 1e-6


class Agreement(NamedTuple):
    """How a peer's result compares with raystream's.

    Parameters
    ----------
    differing : float
        Share of rays whose results differ: in hit or miss; for first hits, also in t by
        more than `T_TOLERANCE`; for all hits, in their number. Share of points whose distances
        differ by more than `POINT_TOLERANCE`.
    hits : int
        Number of rays that hit; for all hits, number of hits.
    """

    differing: float
    hits: int


def outcome(result: Result, rays: Rays | Points | None = None) -> NDArray[Any]:
    """The part of a result that is compared, one number per ray or point.

    Parameters
    ----------
    result : FirstHits, AllHits, Closest or ndarray of bool
    rays : Rays or Points, optional
        Of the query; needed for `Closest`.

    Returns
    -------
    ndarray of shape (N,)
        For first hits t, inf for a miss; for any hits whether there is one; for all hits their
        number; for points their distances, in `Points.unit`.
    """
    if isinstance(result, Closest):
        assert isinstance(rays, Points), "distances are of points"
        distance = result.distance
        if distance is None:
            assert result.positions is not None, "expected a distance or positions"
            away = result.positions.astype(np.float64) - rays.points
            distance = np.sqrt(np.einsum("ij,ij->i", away, away))
        return np.asarray(distance, np.float64) / rays.unit
    if isinstance(result, FirstHits):
        t = np.ravel(result.t)
        return np.where(t < MISS_T, t, np.inf)
    if isinstance(result, AllHits):
        return np.diff(result.ray_splits.astype(np.int64))
    return np.ravel(result)


def compare(query: Query, ours: NDArray[Any], theirs: NDArray[Any]) -> Agreement:
    """Compare a peer's result with raystream's for the same query and rays.

    Parameters
    ----------
    query : {"first", "any", "multi", "closest"}
    ours, theirs : ndarray of shape (N,)
        See `outcome`.
    """
    if query == "closest":
        differs = ~(np.abs(ours - theirs) <= POINT_TOLERANCE)
    else:
        differs = _first_differs(ours, theirs) if query == "first" else ours != theirs
    share = float(np.count_nonzero(differs)) / max(1, differs.size)
    return Agreement(share, count_hits(query, theirs))


def count_hits(query: Query, result: NDArray[Any]) -> int:
    """Count the rays that hit; for all hits, count the hits; or points with a distance.

    See `outcome`.
    """
    if query in ("first", "closest"):
        return int(np.count_nonzero(np.isfinite(result)))
    return int(np.sum(result, dtype=np.int64))


def _first_differs(ours: NDArray[Any], theirs: NDArray[Any]) -> NDArray[np.bool_]:
    hit_a, hit_b = np.isfinite(ours), np.isfinite(theirs)
    a = np.where(hit_a, ours, 0.0).astype(np.float64)
    b = np.where(hit_b, theirs, 0.0).astype(np.float64)
    far = np.abs(a - b) > T_TOLERANCE * np.maximum(np.abs(a), np.abs(b))
    return (hit_a != hit_b) | (hit_a & hit_b & far)
