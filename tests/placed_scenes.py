"""Rays, transforms and rows for tests of instances."""

from __future__ import annotations

from typing import Any

import numpy as np

import raystream as rs


def rays(count: int, seed: int = 3) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    origins = rng.normal(size=(count, 3)) * 12.0
    return origins, rng.normal(size=(count, 3)) * 2.0 - origins


def transforms(count: int, seed: int = 2, even: bool = False) -> np.ndarray:
    """Rotations with scales, of which every other one mirrors."""
    rng = np.random.default_rng(seed)
    matrices = np.zeros((count, 3, 4))
    for k in range(count):
        turned, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        scales = np.full(3, rng.uniform(0.5, 2.0)) if even else rng.uniform(0.3, 2.0, 3)
        scales[0] *= (-1.0) ** k
        matrices[k, :, :3] = turned @ np.diag(scales)
        matrices[k, :, 3] = rng.normal(size=3) * 4.0
    return matrices


def rows_of(hits: rs.MultiHits) -> list[tuple[Any, ...]]:
    """The ray, t, instance and primitive of each hit."""
    columns = hits.ray_id, hits.t, hits.instance_id, hits.prim_id
    return list(zip(*(one.tolist() for one in columns), strict=True))
