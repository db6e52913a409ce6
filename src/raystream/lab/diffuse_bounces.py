"""Bounces: rays that leave surfaces in all directions, as the paths of light do."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.hits import Hits

__all__ = ["bounce_rays", "cosine_directions"]


def bounce_rays(
    hits: Hits, directions: Any, seed: int = 0
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """One ray from each hit, on the side that it was seen from, cosine-weighted.

    Parameters
    ----------
    hits : Hits
        Of N rays and any shape.
    directions : array_like of the hits' shape + (3,)
        Of the rays that found them.
    seed : int

    Returns
    -------
    origins, directions : ndarray of shape (K, 3), float64
        Of the K hits among the rays, in their order.
    """
    away = cosine_directions(
        np.asarray(hits.normals, np.float64), directions, np.random.default_rng(seed)
    )
    origins, _ = hits.spawn(away)
    kept = hits.is_hit
    return origins[kept], away[kept]


def cosine_directions(
    normals: NDArray[np.float64], incoming: Any, generator: np.random.Generator
) -> NDArray[np.float64]:
    """Random directions on the side from which rays came, with a density as the cosine.

    Parameters
    ----------
    normals : ndarray of shape S + (3,)
        Of unit length.
    incoming : array_like of shape S + (3,)
        Directions of the rays that came.
    generator : Generator

    Returns
    -------
    ndarray of shape S + (3,), float64
        Not of unit length.
    """
    is_behind = (normals * np.asarray(incoming)).sum(axis=-1, keepdims=True) > 0.0
    around = generator.normal(size=normals.shape)
    around /= np.linalg.norm(around, axis=-1, keepdims=True)
    # A point of the sphere around the normal's end; a little less, so that none is zero.
    away: NDArray[np.float64] = np.where(is_behind, -normals, normals) + 0.999999 * around
    return away
