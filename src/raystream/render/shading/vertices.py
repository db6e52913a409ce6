"""Triangles' vertices as shading kernels read them: positions, and attributes between them."""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device
from raystream.jit.simd import load

__all__ = ["attribute_number", "attribute_pair", "attribute_vector", "corner_of", "number_at"]

_NONE = np.uint64(0)
_ONE = np.uint64(1)
_TWO = np.uint64(2)
_THREE = np.uint64(3)
_WORD = np.uint64(4)
_PAIR = np.uint64(8)
_VECTOR = np.uint64(12)


@device
def number_at(at):
    """A float32 by its address, as float64."""
    return np.float64(load(np.float32, at))


@device
def corner_of(tables, prim, k):
    """A corner of a triangle, local frame, float64."""
    at = tables.corners + (prim * _THREE + k) * _VECTOR
    return number_at(at), number_at(at + _WORD), number_at(at + _WORD + _WORD)


@device
def attribute_number(tables, rows, width, column, prim, u, v):
    """A number of a triangle's vertices, between them; `rows` have so many numbers."""
    face, at, row = tables.faces + prim * _VECTOR, rows + column * _WORD, width * _WORD
    a = number_at(at + np.uint64(load(np.int32, face)) * row)
    b = number_at(at + np.uint64(load(np.int32, face + _WORD)) * row)
    c = number_at(at + np.uint64(load(np.int32, face + _WORD + _WORD)) * row)
    return (1.0 - u - v) * a + u * b + v * c


@device
def attribute_vector(tables, rows, prim, u, v):
    """Three numbers of a triangle's vertices, between them."""
    return (
        attribute_number(tables, rows, _THREE, _NONE, prim, u, v),
        attribute_number(tables, rows, _THREE, _ONE, prim, u, v),
        attribute_number(tables, rows, _THREE, _TWO, prim, u, v),
    )


@device
def attribute_pair(tables, rows, prim, k):
    """Two numbers of a triangle's vertex k."""
    vertex = load(np.int32, tables.faces + prim * _VECTOR + k * _WORD)
    at = rows + np.uint64(vertex) * _PAIR
    return number_at(at), number_at(at + _WORD)
