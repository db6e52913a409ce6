"""The triangle test of Möller and Trumbore, as printed in Purcell 2002, Figure 5."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.jit.cpu import device
from raystream.jit.simd import load

_Y, _Z = np.uint64(4), np.uint64(8)
_ZERO, _ONE = np.float32(0.0), np.float32(1.0)


class PrintedHit(NamedTuple):
    """The ``float4`` that the printed code takes and returns.

    Attributes
    ----------
    t, u, v : float32
    prim_id : int32
        -1 without a hit; in the paper a float.
    """

    t: np.float32
    u: np.float32
    v: np.float32
    prim_id: np.int32


@device
def vertex_at(at):
    """Three numbers at an address: a texel."""
    return load(np.float32, at), load(np.float32, at + _Y), load(np.float32, at + _Z)


@device
def _cross(a, b):
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


@device
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@device
def _difference(a, b):
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@device
def intersect_triangle(ro, rd, v0, v1, v2, tri_id, h):
    """Test a triangle, line by line as printed, without its fetches.

    Parameters
    ----------
    ro, rd : triple of float32
        Origin and direction.
    v0, v1, v2 : triple of float32
        Corners.
    tri_id : int32
    h : PrintedHit
        The nearest hit so far.

    Returns
    -------
    PrintedHit
        The same, or a nearer hit. Equal t: the first found wins, whatever its number.
    """
    edge1 = _difference(v1, v0)
    edge2 = _difference(v2, v0)
    pvec = _cross(rd, edge2)
    det = _dot(edge1, pvec)
    inv_det = _ONE / det
    tvec = _difference(ro, v0)
    u = _dot(tvec, pvec) * inv_det
    qvec = _cross(tvec, edge1)
    v = _dot(rd, qvec) * inv_det
    t = _dot(edge2, qvec) * inv_det
    is_valid = u >= _ZERO
    is_valid = is_valid & (v >= _ZERO)
    is_valid = is_valid & (u + v <= _ONE)
    is_valid = is_valid & (t < h.t)
    is_valid = is_valid & (t >= _ZERO)
    return PrintedHit(
        t if is_valid else h.t,
        u if is_valid else h.u,
        v if is_valid else h.v,
        tri_id if is_valid else h.prim_id,
    )
