"""Vertices in shading kernels: positions of triangles, and interpolated attributes.

Of one triangle, or of 16: an int32 number, or an `i32x16`.
"""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device
from raystream.jit.simd import as_int32, gather, widen, widen_number

_1, _2, _3, _9 = np.int32(1), np.int32(2), np.int32(3), np.int32(9)
_WHOLE = np.float32(1.0)


@device
def corner_of(tables, prim, k):
    """Corner 0, 1 or 2 of a triangle, local frame, float64."""
    at = as_int32(as_int32(prim) * _9 + as_int32(as_int32(k) * _3))
    return (
        widen(gather(np.float32, tables.corners, at)),
        widen(gather(np.float32, tables.corners, as_int32(at + _1))),
        widen(gather(np.float32, tables.corners, as_int32(at + _2))),
    )


@device
def vertices_of(tables, prim):
    """Rows of a triangle's vertices in the attributes of `tables`."""
    at = as_int32(as_int32(prim) * _3)
    return (
        gather(np.int32, tables.faces, at),
        gather(np.int32, tables.faces, as_int32(at + _1)),
        gather(np.int32, tables.faces, as_int32(at + _2)),
    )


@device
def _number(rows, width, column, vertex):
    return widen_number(gather(np.float32, rows, as_int32(vertex * width + column)))


@device
def attribute_number(rows, width, column, vertices, u, v):
    """Interpolate a number between a triangle's vertices.

    Parameters
    ----------
    rows : uint64
        Address of rows of float32, one per vertex.
    width, column : int32
        Numbers per row, and the index of this one.
    vertices : tuple of three int32
        From `vertices_of`.
    u, v : float64, or f32x16
        Weights of vertices 1 and 2.
    """
    a = _number(rows, width, column, vertices[0])
    b = _number(rows, width, column, vertices[1])
    c = _number(rows, width, column, vertices[2])
    return (_WHOLE - u - v) * a + u * b + v * c


@device
def attribute_vector(rows, vertices, u, v):
    """Interpolate three numbers between vertices; see `attribute_number`."""
    return (
        attribute_number(rows, _3, np.int32(0), vertices, u, v),
        attribute_number(rows, _3, _1, vertices, u, v),
        attribute_number(rows, _3, _2, vertices, u, v),
    )


@device
def attribute_pair(rows, vertex):
    """Two numbers of a vertex."""
    return _number(rows, _2, np.int32(0), vertex), _number(rows, _2, _1, vertex)
