"""Arithmetic of vectors and colours: tuples of three numbers, or of three vectors of 16 lanes."""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device
from raystream.jit.simd import maximum, select

_TWO = np.float32(2.0)


@device
def dot(a, b):
    """Dot product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@device
def times(a, b):
    """Componentwise product."""
    return a[0] * b[0], a[1] * b[1], a[2] * b[2]


@device
def scaled(a, factor):
    """A vector times a number."""
    return a[0] * factor, a[1] * factor, a[2] * factor


@device
def added(a, b, factor):
    """A vector plus another times a number."""
    return a[0] + factor * b[0], a[1] + factor * b[1], a[2] + factor * b[2]


@device
def chosen(mask, a, b):
    """Select between two vectors by a mask or a bool."""
    return select(mask, a[0], b[0]), select(mask, a[1], b[1]), select(mask, a[2], b[2])


@device
def largest(a, b, c):
    """The largest of three numbers."""
    return maximum(maximum(a, b), c)


@device
def mirrored(back, normal):
    """The mirror direction of `back`; unit vectors."""
    along = _TWO * dot(back, normal)
    return (
        along * normal[0] - back[0],
        along * normal[1] - back[1],
        along * normal[2] - back[2],
    )
