"""Rays aimed where counting is likely to fail on a convex mesh around the origin.

Each function returns origins and directions in float32, so that all structures trace the same
rays, and the correct number of crossings.
"""

from __future__ import annotations

import numpy as np


def _outside(rng, count):
    """Points one and a half to six radii away."""
    origins = rng.normal(size=(count, 3))
    return (
        origins / np.linalg.norm(origins, axis=1, keepdims=True) * rng.uniform(1.5, 6, (count, 1))
    )


def _aimed(vertices, faces, count, share, seed):
    """Rays to points of edges, less those that pass the silhouette.

    A ray that meets the smooth sphere at less than the angle between neighbouring faces may
    pass beside the mesh or touch it; the others go on towards the inside.
    """
    rng = np.random.default_rng(seed)
    corners = vertices.astype(float)
    longest = np.linalg.norm(corners[faces[:, 0]] - corners[faces[:, 1]], axis=1).max()
    origins, directions = np.empty((0, 3)), np.empty((0, 3))
    while len(origins) < count:
        chosen = faces[rng.integers(0, len(faces), count)]
        targets = corners[chosen[:, 0]] * (1 - share) + corners[chosen[:, 1]] * share
        start = _outside(rng, count)
        way = targets - start
        outward = targets / np.linalg.norm(targets, axis=1, keepdims=True)
        cosine = np.abs(np.einsum("nk,nk->n", way, outward)) / np.linalg.norm(way, axis=1)
        origins = np.vstack([origins, start[cosine > longest]])
        directions = np.vstack([directions, way[cosine > longest]])
    return np.float32(origins[:count]), np.float32(directions[:count]), [2]


def vertices(vertices, faces, count):
    return _aimed(vertices, faces, count, 0.0, 1)


def midpoints(vertices, faces, count):
    return _aimed(vertices, faces, count, 0.5, 2)


def face_planes(vertices, faces, count):
    """Rays in the plane of a face, through it: they touch a convex mesh there, or miss it."""
    rng = np.random.default_rng(3)
    corners = vertices.astype(float)[faces[rng.integers(0, len(faces), count)]]
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    weights = rng.dirichlet([1, 1, 1], count)
    targets = np.einsum("nk,nkx->nx", weights, corners)
    angle = rng.uniform(0, 2 * np.pi, (count, 1))
    a /= np.linalg.norm(a, axis=1, keepdims=True)
    b -= np.einsum("nk,nk->n", a, b)[:, None] * a
    b /= np.linalg.norm(b, axis=1, keepdims=True)
    directions = a * np.cos(angle) + b * np.sin(angle)
    origins = targets - directions * rng.uniform(1, 3, (count, 1))
    return np.float32(origins), np.float32(directions), [0, 2]


RAYS = {make.__name__: make for make in (vertices, midpoints, face_planes)}
