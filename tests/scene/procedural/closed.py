"""Measures of closed meshes."""

from __future__ import annotations

import numpy as np


def open_edges(faces):
    """Number of directed edges whose opposite is not there exactly as often."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64)
    span = int(faces.max()) + 1
    ahead, ahead_counts = np.unique(edges[:, 0] * span + edges[:, 1], return_counts=True)
    back, back_counts = np.unique(edges[:, 1] * span + edges[:, 0], return_counts=True)
    if not np.array_equal(ahead, back):
        return len(np.setdiff1d(ahead, back))
    return int(np.count_nonzero((ahead_counts != 1) | (back_counts != 1)))


def euler_characteristic(faces):
    """Vertices less edges plus faces; 2 for each closed surface without holes."""
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    return len(np.unique(faces)) - len(np.unique(edges, axis=0)) + len(faces)


def volume(vertices, faces):
    """Enclosed volume; positive if the fronts are outside."""
    a, b, c = vertices.astype(np.float64)[faces].transpose(1, 0, 2)
    return float(np.einsum("fk,fk->", a, np.cross(b, c)) / 6.0)


def front_agreement(vertices, faces, normals):
    """Least cosine between a face's own normal and its vertices' normals."""
    corners = vertices.astype(np.float64)[faces]
    own = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    own /= np.linalg.norm(own, axis=1)[:, None]
    return float(np.einsum("fk,fck->fc", own, normals[faces]).min())
