"""How far points are from shapes, by the distances of their users."""

from __future__ import annotations

import numpy as np

from raystream.jit.constants import INF_F64, ZERO_F64
from raystream.jit.cpu import device
from raystream.kernels.point_triangle import Foot
from raystream.kernels.shapes import distance_at, normal_at, place

#: The nearest point of a surface is found in steps along the normal, as distances may be rounded.
_STEPS = np.uint64(4)


@device
def in_world(point, frame):
    """A point of the local frame in world space."""
    (x, y, z), inverse = frame.center, 1.0 / np.float64(frame.scale)
    return point[0] * inverse + x, point[1] * inverse + y, point[2] * inverse + z


@device
def _beside(x, low, high):
    return max(max(low - x, x - high), ZERO_F64)


@device
def _box_squared(own, point):
    """The squared distance of a point from a shape's box, world space."""
    (a, b, c), (d, e, f) = own.low, own.high
    x, y, z = _beside(point[0], a, d), _beside(point[1], b, e), _beside(point[2], c, f)
    return x * x + y * y + z * z


@device
def shape_squared(own, point, frame):
    """The squared distance of a point from a shape, local frame; inf where it is NaN."""
    world, scale = in_world(point, frame), np.float64(frame.scale)
    distance = distance_at(own, world)
    squared = max(distance * distance, _box_squared(own, world)) * (scale * scale)
    return squared if squared == squared else INF_F64


@device
def shape_foot(own, point, frame):
    """The nearest point of a shape."""
    world, scale = in_world(point, frame), np.float64(frame.scale)
    x, y, z = world
    for _ in range(_STEPS):
        distance, normal = distance_at(own, (x, y, z)), normal_at(own, (x, y, z))
        dx, dy, dz = distance * normal[0], distance * normal[1], distance * normal[2]
        if not dx * dx + dy * dy + dz * dz < INF_F64:  # where the distance has no gradient
            break
        x, y, z = x - dx, y - dy, z - dz
    u, v = place(own, x, y, z)
    (a, b, c), squared = frame.center, shape_squared(own, point, frame)
    place_x, place_y, place_z = (x - a) * scale, (y - b) * scale, (z - c) * scale
    return Foot(squared, place_x, place_y, place_z, np.float64(u), np.float64(v))
