"""Vectors of three numbers, or of three SIMD vectors, as triples."""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device


@device
def minus(p, q):
    """Difference of two triples."""
    return p[0] - q[0], p[1] - q[1], p[2] - q[2]


@device
def dot(p, q):
    """Dot product."""
    return p[0] * q[0] + p[1] * q[1] + p[2] * q[2]


@device
def cross(p, q):
    """Cross product."""
    return p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]


@device
def corner_of(corners, prim_id, k):
    """Corner k of a triangle in an array of shape (F, 3, 3): three float64."""
    return (
        np.float64(corners[prim_id, k, 0]),
        np.float64(corners[prim_id, k, 1]),
        np.float64(corners[prim_id, k, 2]),
    )
