"""Clipping the box of a triangle in a cell to the triangle's plane.

A reference is a triangle in a cell, with a box around the part of it that is there. For the
same bits as `brute`, a cell must list every triangle whose hit may have its t in the cell; and
hits do not lie only *in* the triangle. A ray almost in its plane that passes its edge within
rounding is accepted, and intersects the plane far away; the clamp then leaves the hit in the
triangle's own box, on or near its plane, but outside its edges by any distance. So cells are
not clipped to the triangle but to its plane inside its box, both grown by `BOUND`: that
contains every hit, proved by the bounds below, and is as tight wherever the box is small.

References
----------
Wald and Havran, "On building fast kd-Trees for Ray Tracing, and on doing that in O(N log N)",
IEEE Symposium on Interactive Ray Tracing 2006: "perfect splits", there of the triangle itself.
"""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device, device_call
from raystream.jit.simd import load, store

#: How far triangles' boxes and planes are grown, in units of the scene's largest coordinate E.
#: Origins have coordinates of up to 5 E (`kernels.ray.FAR`), so rounded lengths are up to 6 E.
#: A hit lies outside its triangle's box by at most the padding, 6 E * 2**-20 (`ray.PAD`), and
#: off its plane by the rounding of images, 12 * 6 E * 2**-24; its t, and the t of a split
#: plane, are rounded, 5 * 6 E * 2**-24 together. That is less than 8 E * 2**-20 for both.
BOUND = 2.0**-17

#: Below this sine of the angle between two sides a triangle's plane is too uncertain, even in
#: float64, and only its box is used.
SLIVER = 2.0**-28

#: Bytes of a box (low x, y, z, high x, y, z: float32), of its low corner, and of a number.
BOX_BYTES = np.uint64(24)
HIGH = np.uint64(12)
WORD = np.uint64(4)

_Y = np.uint64(4)
_Z = np.uint64(8)
_SECOND = np.uint64(12)
_THIRD = np.uint64(24)


@device
def corner_at(at):
    """The three numbers at an address, in float64."""
    return (
        np.float64(load(np.float32, at)),
        np.float64(load(np.float32, at + _Y)),
        np.float64(load(np.float32, at + _Z)),
    )


@device
def _extent(box, axis, start, slope):
    """Minimum and maximum of slope * (x - start) over one axis of a box."""
    at_low = slope * (np.float64(load(np.float32, box + axis)) - start)
    at_high = slope * (np.float64(load(np.float32, box + axis + HIGH)) - start)
    return min(at_low, at_high), max(at_low, at_high)


@device
def _shrink(box, axis, start, slope, least, most):
    """Clip one axis of a box to where slope * (x - start) is from least to most."""
    if slope == 0.0:
        return
    one, other = start + least / slope, start + most / slope
    low_at, high_at = box + axis, box + axis + HIGH
    low = max(load(np.float32, low_at), np.float32(min(one, other)))
    high = min(load(np.float32, high_at), np.float32(max(one, other)))
    if low <= high:
        store(low_at, low)
        store(high_at, high)


@device_call
def clip_to_plane(triangle, bound, box):
    """Shrink a reference's box to its overlap with the triangle's plane.

    Parameters
    ----------
    triangle : uint64
        Address of its nine coordinates.
    bound : float64
        How far the plane is grown, in each axis: `BOUND` in the scene's unit.
    box : uint64
        Address of the box, inside the triangle's grown one. Changed in place.

    Returns
    -------
    bool
        Whether they overlap.
    """
    ax, ay, az = corner_at(triangle)
    bx, by, bz = corner_at(triangle + _SECOND)
    cx, cy, cz = corner_at(triangle + _THIRD)
    px, py, pz = bx - ax, by - ay, bz - az
    qx, qy, qz = cx - ax, cy - ay, cz - az
    nx = py * qz - pz * qy
    ny = pz * qx - px * qz
    nz = px * qy - py * qx
    normal = abs(nx) + abs(ny) + abs(nz)
    longest = (abs(px) + abs(py) + abs(pz)) * (abs(qx) + abs(qy) + abs(qz))
    if not normal > SLIVER * longest:
        return True
    reach = bound * normal
    x, y, z = np.uint64(0), _Y, _Z
    least_x, most_x = _extent(box, x, ax, nx)
    least_y, most_y = _extent(box, y, ay, ny)
    least_z, most_z = _extent(box, z, az, nz)
    if least_x + least_y + least_z > reach or most_x + most_y + most_z < -reach:
        return False
    # The plane is where the three terms add up to -reach to reach: two of them bound the third.
    _shrink(box, x, ax, nx, -reach - (most_y + most_z), reach - (least_y + least_z))
    _shrink(box, y, ay, ny, -reach - (most_z + most_x), reach - (least_z + least_x))
    _shrink(box, z, az, nz, -reach - (most_x + most_y), reach - (least_x + least_y))
    return True
