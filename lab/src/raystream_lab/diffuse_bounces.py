"""Cosine-weighted diffuse bounce rays."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.hits import Hits


def bounce_rays(
    hits: Hits, directions: Any, seed: int = 0
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Spawn one cosine-weighted ray per hit, on the side that the incoming ray came from.

    Parameters
    ----------
    hits : Hits
        Of any shape.
    directions : array_like of the hits' shape + (3,)
        Directions of the incoming rays.
    seed : int

    Returns
    -------
    origins, directions : ndarray of shape (K, 3), float64
        Of the K hits, in order.
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
    """Sample directions on the incoming side, with a density proportional to the cosine.

    Parameters
    ----------
    normals : ndarray of shape S + (3,)
        Unit length.
    incoming : array_like of shape S + (3,)
        Directions of the incoming rays.
    generator : Generator

    Returns
    -------
    ndarray of shape S + (3,), float64
        Not normalized.
    """
    is_behind = (normals * np.asarray(incoming)).sum(axis=-1, keepdims=True) > 0.0
    around = generator.normal(size=normals.shape)
    around /= np.linalg.norm(around, axis=-1, keepdims=True)
    # A point on a sphere around the tip of the normal, slightly smaller to avoid zero.
    away: NDArray[np.float64] = np.where(is_behind, -normals, normals) + 0.999999 * around
    return away
