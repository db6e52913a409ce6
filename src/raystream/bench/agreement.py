"""Agreement: how many rays get the same result from two contenders."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.bench.contenders.base import MISS_T, AllHits, FirstHits, Result

__all__ = ["T_TOLERANCE", "Agreement", "compare", "count_hits"]

#: Relative difference of t below which two hits agree.
T_TOLERANCE = 1e-4


class Agreement(NamedTuple):
    """How a peer's result compares with raystream's.

    Parameters
    ----------
    differing : float
        Share of rays whose results differ: in hit or miss; for first hits, also in t by
        more than `T_TOLERANCE`; for all hits, in their number.
    hits : int
        Number of rays that hit; for all hits, number of hits.
    """

    differing: float
    hits: int


def compare(ours: Result, theirs: Result) -> Agreement:
    """Compare a peer's result with raystream's for the same query and rays.

    Parameters
    ----------
    ours, theirs : FirstHits, AllHits or ndarray of bool
        Shapes may differ, but not the number of rays.
    """
    hits = count_hits(theirs)
    if isinstance(ours, FirstHits) and isinstance(theirs, FirstHits):
        return Agreement(_share(_first_differs(ours, theirs)), hits)
    if isinstance(ours, AllHits) and isinstance(theirs, AllHits):
        counts = (np.diff(result.ray_splits.astype(np.int64)) for result in (ours, theirs))
        return Agreement(_share(np.not_equal(*counts)), hits)
    return Agreement(_share(np.ravel(ours) != np.ravel(theirs)), hits)


def count_hits(result: Result) -> int:
    """Count the rays that hit; for all hits, count the hits."""
    if isinstance(result, FirstHits):
        return int(np.count_nonzero(np.less(result.t, MISS_T)))
    if isinstance(result, AllHits):
        return len(result.t)
    return int(np.count_nonzero(result))


def _first_differs(ours: FirstHits, theirs: FirstHits) -> NDArray[np.bool_]:
    a, b = (np.ravel(result.t).astype(np.float64) for result in (ours, theirs))
    hit_a, hit_b = a < MISS_T, b < MISS_T
    a, b = np.where(hit_a, a, 0.0), np.where(hit_b, b, 0.0)
    far = np.abs(a - b) > T_TOLERANCE * np.maximum(np.abs(a), np.abs(b))
    differs: NDArray[np.bool_] = (hit_a != hit_b) | (hit_a & hit_b & far)
    return differs


def _share(differs: NDArray[np.bool_]) -> float:
    return float(np.count_nonzero(differs)) / max(1, differs.size)
