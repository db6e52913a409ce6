"""Small meshes for tests: closed ones, soups, and awkward ones."""

from __future__ import annotations

import numpy as np


def icosphere(level: int):
    """A closed convex mesh of 20 * 4**level triangles, vertices on the unit sphere."""
    golden = (1 + 5**0.5) / 2
    ring = [(0, s, t * golden) for s in (-1, 1) for t in (-1, 1)]
    vertices = np.array([np.roll(p, k) for k in range(3) for p in ring], float)
    vertices /= np.linalg.norm(vertices, axis=1, keepdims=True)
    near = np.linalg.norm(vertices[:, None] - vertices[None], axis=2) < 1.1
    faces = [
        (a, b, c)
        for a in range(12)
        for b in range(a + 1, 12)
        for c in range(b + 1, 12)
        if near[a, b] and near[b, c] and near[a, c]
    ]
    faces = np.array(faces)
    for _ in range(level):
        vertices, faces = _subdivided(vertices, faces)
        vertices /= np.linalg.norm(vertices, axis=1, keepdims=True)
    return vertices, _outward(vertices, faces)


def _subdivided(vertices, faces):
    edges = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    unique, inverse = np.unique(edges, axis=0, return_inverse=True)
    middles = vertices[unique].mean(axis=1)
    m = inverse.reshape(-1, 3) + len(vertices)
    a, b, c = faces.T
    parts = [(a, m[:, 0], m[:, 2]), (m[:, 0], b, m[:, 1]), (m[:, 2], m[:, 1], c), tuple(m.T)]
    return np.vstack([vertices, middles]), np.vstack([np.stack(p, axis=1) for p in parts])


def _outward(vertices, faces):
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = np.einsum("fk,fk->f", normals, corners.mean(axis=1)) < 0
    return np.where(inward[:, None], faces[:, ::-1], faces)


def dented_sphere(level: int, seed: int = 0):
    """A closed mesh, not convex, stretched and rotated."""
    vertices, faces = icosphere(level)
    x, y, z = vertices.T
    dent = 1 + 0.25 * np.sin(5 * x + 1) * np.sin(7 * y) * np.sin(6 * z + 2)
    rotation, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    return (vertices * dent[:, None] * [2.3, 0.7, 1.3]) @ rotation.T + [0.3, -2.0, 1.1], faces


def soup(count: int, seed: int = 0, size: float = 0.2):
    """Triangles anywhere in the unit cube, of all shapes."""
    rng = np.random.default_rng(seed)
    vertices = rng.random((count, 1, 3)) + rng.normal(size=(count, 3, 3)) * size
    return vertices.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3)


def lattice_soup(count: int, seed: int = 0):
    """Triangles on integer points, each twice with opposite winding: ties everywhere."""
    rng = np.random.default_rng(seed)
    vertices = rng.integers(-3, 4, (3 * count, 3)).astype(float)
    faces = np.arange(3 * count).reshape(-1, 3)
    return vertices, np.vstack([faces, faces[:, ::-1]])


def grid_floor(cells: int):
    """A flat square at y = 0 over [-1, 1]^2 of 2 * cells**2 triangles: a box without height."""
    line = np.linspace(-1, 1, cells + 1)
    x, z = np.meshgrid(line, line)
    vertices = np.stack([x.ravel(), np.zeros(x.size), z.ravel()], axis=1)
    row, column = np.divmod(np.arange(cells * cells), cells)
    a = row * (cells + 1) + column
    b, c, d = a + 1, a + cells + 1, a + cells + 2
    return vertices, np.concatenate([np.stack([a, c, b], 1), np.stack([b, c, d], 1)])


def cube():
    """A closed unit cube on integer corners: 12 triangles."""
    vertices = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return vertices, np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])


def sticks(count, width):
    """Long thin triangles, whose boxes overlap."""
    rng = np.random.default_rng(3)
    start = rng.random((count, 3))
    stop = start + rng.normal(size=(count, 3)) * 0.3
    corners = np.stack([start, stop, stop + rng.normal(size=(count, 3)) * width], axis=1)
    return corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3)
