"""Derivatives of crossings by central differences, with another formula than raystream's."""

from __future__ import annotations

import numpy as np

import raystream as rs


def crossing(origins, directions, corners):
    """t, u, v and the point, shape S + (6,), float64, of rays and the planes of triangles.

    By linear equations: first + u (second - first) + v (third - first) = origin + t direction.
    """
    first, second, third = np.moveaxis(np.asarray(corners, np.float64), -2, 0)
    edges = second - first, third - first
    matrix = np.stack([-np.asarray(directions, np.float64), *edges], axis=-1)
    offset = np.asarray(origins, np.float64) - first
    weights = np.linalg.solve(matrix, offset[..., None])[..., 0]
    points = first + weights[..., 1:2] * edges[0] + weights[..., 2:] * edges[1]
    return np.concatenate([weights, points], axis=-1)


def differences(origins, directions, corners):
    """Derivatives of `crossing`, shape S + (6, 15): by origin, direction and corners in turn."""
    shape = np.shape(origins)[:-1]
    parts = [np.reshape(one, (*shape, -1)) for one in (origins, directions, corners)]
    inputs = np.concatenate(parts, axis=-1).astype(float)

    def at(values):
        return crossing(values[..., :3], values[..., 3:6], values[..., 6:].reshape(*shape, 3, 3))

    columns = []
    for k in range(15):
        step = np.zeros(15)
        step[k] = 1e-6
        columns.append((at(inputs + step) - at(inputs - step)) / 2e-6)
    return np.stack(columns, axis=-1)


def check_slopes(corners, directions, hits, by_origin, by_direction):
    """Compare slopes of t, u and v with the inverse of a matrix, where that is well-conditioned.

    Parameters
    ----------
    corners : ndarray of shape (N, 3, 3)
        Of the triangles hit.
    directions : ndarray of shape (N, 3)
    hits : Hits
    by_origin, by_direction : ndarray of shape (N, 3, 3)
        Slopes of t, u and v by three coordinates.
    """
    assert np.isfinite(by_origin).all()
    assert np.isfinite(by_direction).all()
    is_hit = np.asarray(hits.prim_id) >= 0
    assert not by_origin[~is_hit].any()
    assert not by_direction[~is_hit].any()
    for k in np.flatnonzero(is_hit):
        first, second, third = corners[k].astype(float)
        matrix = np.stack([-directions[k].astype(float), second - first, third - first], axis=1)
        if np.linalg.cond(matrix / np.abs(matrix).max(axis=0)) < 1e5:
            expected = np.linalg.inv(matrix)
            assert relative_error(by_origin[k], expected) < 1e-5
            assert relative_error(by_direction[k], float(hits.t[k]) * expected) < 1e-5


def relative_error(found, expected):
    """Largest difference within each row, of the row's largest number."""
    scale = np.abs(expected).max(axis=-1, keepdims=True)
    return float((np.abs(found - expected) / np.maximum(scale, 1e-300)).max())


def open_mesh(seed=0, count=40):
    """A scene of two meshes of random triangles, and its vertices, (V, 3), float64."""
    rng = np.random.default_rng(seed)
    parts = []
    for part in (count // 2, count - count // 2):
        centers = rng.uniform(-1, 1, (part, 1, 3))
        vertices = (centers + rng.uniform(-0.7, 0.7, (part, 3, 3))).reshape(-1, 3)
        parts.append(rs.Mesh(vertices, np.arange(3 * part).reshape(-1, 3)))
    return rs.Scene(parts), np.concatenate([part.vertices for part in parts])


def hits_of(scene, count=60, seed=1):
    """Origins and directions, (count, 3) float64, of which most hit, and not at a grazing angle."""
    rng = np.random.default_rng(seed)
    origins = rng.uniform(-3, 3, (8 * count, 3))
    directions = rng.uniform(-0.7, 0.7, origins.shape) - origins
    hits = rs.Tracer(scene, "brute").first_hit(origins, directions)
    with np.errstate(invalid="ignore"):
        slope = np.abs((hits.normals * directions).sum(axis=1)) / np.linalg.norm(directions, axis=1)
    kept = np.flatnonzero(~(slope < 0.1))[:count]  # misses, whose normals are NaN, stay
    return origins[kept], directions[kept]
