"""Closed meshes with known chords, for tests of `raystream.physics`."""

from __future__ import annotations

import numpy as np

import raystream as rs
from meshes import cube, icosphere


def box_mesh(low, high, *, flipped=False, **attributes):
    vertices, faces = cube()
    low, high = np.asarray(low, float), np.asarray(high, float)
    faces = faces[:, ::-1] if flipped else faces
    return rs.Mesh(low + vertices * (high - low), faces, **attributes)


def sphere_mesh(center=(0.0, 0.0, 0.0), radius=1.0, level=3, *, flipped=False, **attributes):
    vertices, faces = icosphere(level)
    faces = faces[:, ::-1] if flipped else faces
    return rs.Mesh(np.asarray(center) + radius * vertices, faces, **attributes)


def joined(*meshes, **attributes):
    """Merge several meshes into one."""
    starts = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes])
    faces = [mesh.faces + start for mesh, start in zip(meshes, starts, strict=False)]
    return rs.Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(faces), **attributes
    )


def tracer_of(*meshes, structure="bvh", **attributes):
    return rs.Tracer(rs.Scene(meshes, **attributes), structure)


def box_chords(origins, directions, low, high):
    """Lengths of lines within a box, by slabs, in float64."""
    with np.errstate(divide="ignore", invalid="ignore"):
        a = (np.asarray(low) - origins) / directions
        b = (np.asarray(high) - origins) / directions
    near, far = np.minimum(a, b).max(axis=-1), np.maximum(a, b).min(axis=-1)
    return np.maximum(far - near, 0.0) * np.linalg.norm(directions, axis=-1)


def sphere_chords(origins, directions, center, radius):
    unit = directions / np.linalg.norm(directions, axis=-1, keepdims=True)
    toward = np.asarray(center) - origins
    along = np.einsum("nk,nk->n", toward, unit)
    off = np.einsum("nk,nk->n", toward, toward) - along**2
    return 2 * np.sqrt(np.maximum(radius**2 - off, 0.0))


def rays_from_outside(rng, count, reach=1.0):
    """Rays from a sphere of radius 5 towards points in [-reach, reach]^3."""
    origins = rng.normal(size=(count, 3))
    origins *= 5 / np.linalg.norm(origins, axis=1, keepdims=True)
    return origins, rng.uniform(-reach, reach, (count, 3)) - origins
