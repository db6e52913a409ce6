"""Agreement: how many rays get the same answer from two contenders."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.bench.contenders.base import MISS_FROM, AllHits, Answer, FirstHits

__all__ = ["T_TOLERANCE", "Agreement", "compare", "count_hits"]

#: Relative difference of t below which two hits agree.
T_TOLERANCE = 1e-4


class Agreement(NamedTuple):
    """How an answer compares with raystream's.

    Parameters
    ----------
    differing : float
        Share of the rays whose answers differ: in hit or miss; for first hits, also in t by
        more than `T_TOLERANCE`; for all hits, in their number.
    hits : int
        Rays that hit; for all hits, hits.
    """

    differing: float
    hits: int


def compare(ours: Answer, theirs: Answer) -> Agreement:
    """Compare a peer's answer with raystream's to the same query of the same rays.

    Parameters
    ----------
    ours, theirs : FirstHits, AllHits or ndarray of bool
        Shapes may differ where the number of rays does not.
    """
    hits = count_hits(theirs)
    if isinstance(ours, FirstHits) and isinstance(theirs, FirstHits):
        return Agreement(_share(_first_differs(ours, theirs)), hits)
    if isinstance(ours, AllHits) and isinstance(theirs, AllHits):
        counts = (np.diff(answer.ray_splits.astype(np.int64)) for answer in (ours, theirs))
        return Agreement(_share(np.not_equal(*counts)), hits)
    return Agreement(_share(np.ravel(ours) != np.ravel(theirs)), hits)


def count_hits(answer: Answer) -> int:
    """Count the rays that hit; for all hits, the hits."""
    if isinstance(answer, FirstHits):
        return int(np.count_nonzero(np.less(answer.t, MISS_FROM)))
    if isinstance(answer, AllHits):
        return len(answer.t)
    return int(np.count_nonzero(answer))


def _first_differs(ours: FirstHits, theirs: FirstHits) -> NDArray[np.bool_]:
    a, b = (np.ravel(answer.t).astype(np.float64) for answer in (ours, theirs))
    hit_a, hit_b = a < MISS_FROM, b < MISS_FROM
    a, b = np.where(hit_a, a, 0.0), np.where(hit_b, b, 0.0)
    far = np.abs(a - b) > T_TOLERANCE * np.maximum(np.abs(a), np.abs(b))
    differs: NDArray[np.bool_] = (hit_a != hit_b) | (hit_a & hit_b & far)
    return differs


def _share(differs: NDArray[np.bool_]) -> float:
    return float(np.count_nonzero(differs)) / max(1, differs.size)
