"""Boxes by address, in kernels of builders: low x, y, z, high x, y, z, float32."""

from __future__ import annotations

import numpy as np

from raystream.jit.constants import ONE_U64, TWO_U64, ZERO_U64
from raystream.jit.cpu import device
from raystream.jit.simd import load, store
from raystream.structures.clip import HIGH, WORD


@device
def copy_box(to, source):
    """Copy a box between addresses."""
    for k in range(np.uint64(6)):
        store(to + k * WORD, load(np.float32, source + k * WORD))


@device
def length_along(box, axis):
    """Length of a box along an axis."""
    at = box + axis * WORD
    return np.float64(load(np.float32, at + HIGH)) - load(np.float32, at)


@device
def half_area(box):
    """Half of a box's surface area."""
    x, y, z = length_along(box, ZERO_U64), length_along(box, ONE_U64), length_along(box, TWO_U64)
    return x * y + y * z + z * x


@device
def face_area(box, axis):
    """Area of a face that is perpendicular to an axis."""
    other = axis + ONE_U64 if axis < TWO_U64 else ZERO_U64
    third = ONE_U64 + TWO_U64 - axis - other
    return length_along(box, other) * length_along(box, third)
