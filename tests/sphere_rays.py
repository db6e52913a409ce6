"""Rays at spheres: anywhere, grazing, from inside, from the surface, along axes, limited."""

from __future__ import annotations

import numpy as np


def unit_vectors(rng, count: int) -> np.ndarray:
    vectors = rng.normal(size=(count, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def aimed(rng, origins, centers, radii, miss_by) -> np.ndarray:
    """Directions that pass the centres at `miss_by` radii, of length 1."""
    to_center = centers - origins
    distance = np.linalg.norm(to_center, axis=1, keepdims=True)
    axis = to_center / np.maximum(distance, 1e-300)
    across = np.cross(axis, unit_vectors(rng, len(axis)))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    ratio = np.clip((radii * miss_by)[:, None] / np.maximum(distance, 1e-300), 0.0, 1.0)
    return axis * np.sqrt(1.0 - ratio * ratio) + across * ratio


def some_rays(rng, centers, radii, targets, spread):
    """Rays at targets: anywhere, grazing, from inside, from the surface, along axes, limited."""
    count = len(targets)
    centers, radii = centers[targets], radii[targets]
    origins = centers + unit_vectors(rng, count) * (radii + spread * rng.random(count))[:, None]
    miss_by = rng.uniform(0.0, 1.1, count)
    kind = rng.integers(0, 8, count)
    grazing = kind == 1
    miss_by[grazing] = 1.0 + rng.choice([0.0, 1e-16, 1e-12, 1e-8, -1e-12, -1e-8], grazing.sum())
    around = unit_vectors(rng, count)
    inside, on = kind == 2, kind == 3
    origins[inside] = centers[inside] + around[inside] * (radii * rng.random(count))[inside, None]
    origins[on] = centers[on] + around[on] * radii[on, None]
    directions = aimed(rng, origins, centers, radii, miss_by)
    directions[inside | on] = unit_vectors(rng, int((inside | on).sum()))
    axial = kind == 4
    axis = rng.integers(0, 3, count)
    along = np.eye(3)[axis] * rng.choice([-1.0, 1.0], count)[:, None]
    directions[axial] = along[axial]
    shift = rng.choice([0.0, 1.0, -1.0, 0.5], (count, 3)) * radii[:, None] * (1.0 - np.abs(along))
    origins[axial] = (centers + shift - along * (2.0 * radii[:, None] + spread))[axial]
    scaled = kind == 5
    directions[scaled] *= 10.0 ** rng.uniform(-20, 20, count)[scaled, None]
    t_min, t_max = np.zeros(count, np.float32), np.full(count, np.inf, np.float32)
    limited = kind == 6
    t_min[limited] = rng.uniform(-1.0, 1.0, count)[limited] * spread
    t_max[limited] = t_min[limited] + rng.uniform(0.0, 2.0, count)[limited] * spread
    t_min[kind == 7] = -np.inf
    return origins, directions, t_min, t_max


#: Name: number of spheres, of which scale, at which offset, radii, and how far origins are.
SETTINGS = {
    "ordinary": (60, 10.0, 0.0, (0.01, 1.0), 20.0),
    "a millimetre, a million away": (60, 1e6, 0.0, (1e-3, 2e-3), 1e6),
    "far from the origin": (60, 10.0, 1e7, (0.01, 1.0), 20.0),
    "huge": (20, 1.0, 0.0, (1e6, 1e8), 10.0),
    "tiny": (60, 1e-12, 0.0, (1e-15, 1e-13), 1e-11),
    "origins far outside": (60, 1.0, 0.0, (0.001, 0.1), 1e9),
}
