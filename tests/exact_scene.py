"""A scene and rays in which distances to planes round alike on every device."""

from __future__ import annotations

from functools import cache

import numpy as np

import raystream as rs


@cache
def lattice_scene() -> rs.Scene:
    """Triangles whose corners are whole numbers."""
    rng = np.random.default_rng(8)
    first = rng.integers(0, 60, (300, 1, 3))
    corners = first + rng.integers(-4, 5, (300, 3, 3))
    return rs.Scene.from_arrays(corners.reshape(-1, 3), np.arange(900).reshape(-1, 3))


@cache
def exact_rays() -> tuple[np.ndarray, np.ndarray]:
    """Rays whose distances to planes round once at most, fused or not: their directions have
    reciprocals. Some go along an axis."""
    rng = np.random.default_rng(9)
    origins = rng.integers(-8, 72, (400, 3)).astype(np.float32)
    sizes = np.float32(2.0) ** rng.integers(-3, 1, (400, 3))
    directions = sizes * rng.choice([-1, 1], (400, 3)) * (rng.random((400, 3)) < 0.9)
    directions[(directions == 0).all(axis=1)] = [0, 0, 1]
    return origins, directions.astype(np.float32)
