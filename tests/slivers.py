"""Closed meshes that only triangles without area in float32 close, as in files of CAD."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

import raystream as rs
from meshes import cube, icosphere


def split_edge(vertices, faces, face=0, side=0, splits=1, off=1e-8):
    """Split an edge in one of its two triangles, and close the gap by slivers.

    The new vertices are `off` away from the edge, along all axes.
    """
    vertices = np.asarray(vertices, np.float64)
    a, b, c = np.roll(faces[face], -side)
    shares = np.arange(1, splits + 1)[:, None] / (splits + 1)
    added = vertices[a] * (1 - shares) + vertices[b] * shares + off
    middle = len(vertices) + np.arange(splits)
    along = [a, *middle, b]
    fan = [[p, q, c] for p, q in pairwise(along)]
    slivers = [[a, q, p] for p, q in pairwise(along[1:])]
    kept = np.delete(faces, face, axis=0)
    return np.vstack([vertices, added]), np.vstack([kept, fan, slivers]).astype(np.int32)


def split_box(splits=1, off=1e-8, edges=1):
    """The box [1, 2]^3, where float32 has no digits for `off`; some of its edges are split."""
    vertices, faces = cube()
    vertices = vertices + 1.0
    for _ in range(edges):
        vertices, faces = split_edge(vertices, faces, 0, 0, splits, off)
    return vertices, faces


def loose(vertices, faces):
    """As in STL files: each triangle has its own vertices."""
    return vertices[faces].reshape(-1, 3), np.arange(faces.size).reshape(-1, 3)


FORMS = {
    "split edge": lambda: split_box(),
    "vertex on the edge": lambda: split_box(off=0.0),
    "many splits": lambda: split_box(splits=9),
    "two edges": lambda: split_box(edges=2),
    "loose": lambda: loose(*split_box(splits=2)),
    "far away": lambda: (split_box()[0] + [1e6, -3e5, 2e6], split_box()[1]),
    "sphere": lambda: split_edge(*icosphere(2), face=7, splits=3, off=0.0),
}


def split_mesh(form, **attributes):
    return rs.Mesh(*FORMS[form](), **attributes)
