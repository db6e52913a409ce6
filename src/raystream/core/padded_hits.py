"""Hits of each ray in rows of one length, for libraries that must know shapes beforehand."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.hits import MultiHits


class PaddedHits(NamedTuple):
    """The nearest hits of each ray, as NumPy arrays of shape S + (max_hits,); see `pad`."""

    t: NDArray[np.float32]
    u: NDArray[np.float32]
    v: NDArray[np.float32]
    prim_id: NDArray[np.int32]
    instance_id: NDArray[np.int32]


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
        Of the rays' shape + (max_hits,). Without a hit ``t`` is inf, ``u`` and ``v`` are 0, and
        ``prim_id`` and ``instance_id`` are -1.
    """
    shape = (*found.status.shape, max_hits)
    rank = np.arange(len(found.t)) - found.ray_splits[found.ray_id]
    place = found.ray_id * max_hits + rank
    columns = []
    for name, missing in zip(PaddedHits._fields, (np.inf, 0, 0, -1, -1), strict=True):
        values = getattr(found, name)
        padded = np.full(shape, missing, values.dtype)
        padded.reshape(-1)[place] = values
        columns.append(padded)
    return PaddedHits(*columns)
