"""The steps of the triangle test: numbers, triangles of a ray side by side, or rays of a packet.

Each function takes vectors of any width, or numbers, and does the same operations in the same
order, so the bits are the same. See `kernels.triangle` for why the test is watertight; nothing here
may be fused or reordered.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.jit.constants import ZERO_F32, ZERO_F64, ZERO_U64
from raystream.jit.cpu import device
from raystream.jit.simd import any_lane, as_float32, fma, maximum, minimum, select, widen


class ShearedVertices(NamedTuple):
    """Vertices a, b, c of triangles in the rays' frame: the ray is the z axis.

    Attributes
    ----------
    ax, ay, az, bx, by, bz, cx, cy, cz : float32 vector or number
    """

    ax: object
    ay: object
    az: object
    bx: object
    by: object
    bz: object
    cx: object
    cy: object
    cz: object


@device
def shear_vertices(a, b, c, origin, shear):
    """Translate and shear vertices so that the ray is the z axis.

    Parameters
    ----------
    a, b, c, origin : tuple of three float32 vectors or numbers
        In the order of the ray's axes: kx, ky, kz.
    shear : tuple of two float32 vectors or numbers
        For x and y.

    Returns
    -------
    ShearedVertices
    """
    az, bz, cz = a[2] - origin[2], b[2] - origin[2], c[2] - origin[2]
    ax = (a[0] - origin[0]) - shear[0] * az
    ay = (a[1] - origin[1]) - shear[1] * az
    bx = (b[0] - origin[0]) - shear[0] * bz
    by = (b[1] - origin[1]) - shear[1] * bz
    cx = (c[0] - origin[0]) - shear[0] * cz
    cy = (c[1] - origin[1]) - shear[1] * cz
    return ShearedVertices(ax, ay, az, bx, by, bz, cx, cy, cz)


@device
def _edge(ax, ay, bx, by):
    """Twice the signed area of the triangle (origin, b, a), in the frame's x and y."""
    return ax * by - ay * bx


@device
def signs_agree(sheared):
    """Mask of the lanes, or bool, whose edge functions may have one sign; NaN is culled."""
    U = _edge(sheared.cx, sheared.cy, sheared.bx, sheared.by)
    V = _edge(sheared.ax, sheared.ay, sheared.cx, sheared.cy)
    W = _edge(sheared.bx, sheared.by, sheared.ax, sheared.ay)
    low = minimum(minimum(U, V), W)
    high = maximum(maximum(U, V), W)
    return (low >= ZERO_F32) | (high <= ZERO_F32)


@device
def slab_interval(planes, inv, near, far):
    """Padded slab interval of boxes: `kernels.slab.box_interval` with the planes chosen.

    Parameters
    ----------
    planes : tuple of six float32 vectors
        Near x, y, z and far x, y, z planes along the ray; see `planes_along`.
    inv, near, far : tuple of three float32 vectors or numbers
        Reciprocal direction and slab constants of each axis.

    Returns
    -------
    t_in, t_out : float32 vector
    """
    t_in = maximum(
        maximum(fma(planes[0], inv[0], near[0]), fma(planes[1], inv[1], near[1])),
        fma(planes[2], inv[2], near[2]),
    )
    t_out = minimum(
        minimum(fma(planes[3], inv[0], far[0]), fma(planes[4], inv[1], far[1])),
        fma(planes[5], inv[2], far[2]),
    )
    return t_in, t_out


@device
def planes_along(low, high, back):
    """The planes of boxes as rays of a direction meet them.

    Parameters
    ----------
    low, high : tuple of three float32 vectors or numbers
        Corners.
    back : tuple of three bool
        Whether the rays' directions are negative.

    Returns
    -------
    tuple of six float32 vectors or numbers
        Near x, y, z and far x, y, z planes.
    """
    return (
        select(back[0], high[0], low[0]),
        select(back[1], high[1], low[1]),
        select(back[2], high[2], low[2]),
        select(back[0], low[0], high[0]),
        select(back[1], low[1], high[1]),
        select(back[2], low[2], high[2]),
    )


@device
def boxes_interval(ray, low, high):
    """Padded slab interval of boxes for one `kernels.ray.Ray`; `low` and `high` are corners."""
    back = ray.inv_x < ZERO_F32, ray.inv_y < ZERO_F32, ray.inv_z < ZERO_F32
    return slab_interval(
        planes_along(low, high, back),
        (ray.inv_x, ray.inv_y, ray.inv_z),
        (ray.near_x, ray.near_y, ray.near_z),
        (ray.far_x, ray.far_y, ray.far_z),
    )


@device
def extents(a, b, c):
    """Low and high corners of the boxes of triangles, whose corners are given."""
    low_x, high_x = minimum(minimum(a[0], b[0]), c[0]), maximum(maximum(a[0], b[0]), c[0])
    low_y, high_y = minimum(minimum(a[1], b[1]), c[1]), maximum(maximum(a[1], b[1]), c[1])
    low_z, high_z = minimum(minimum(a[2], b[2]), c[2]), maximum(maximum(a[2], b[2]), c[2])
    return (low_x, low_y, low_z), (high_x, high_y, high_z)


@device
def plane_distance(a, b, c, o, d):
    """Distance to the triangles' planes; see step 3 of `kernels.triangle.intersect`.

    The corners' images would do for small triangles. But they are rounded at the size of the
    triangle: on a ground plane of many kilometres a distance of a metre would lose all digits.

    Parameters
    ----------
    a, b, c, o, d : tuple of three float32 vectors or numbers
        Corners, origin and direction, in the order of the frame.

    Returns
    -------
    float32 vector or number
        Not clamped; not finite for a triangle seen edge-on.
    """
    return distance_along(a, plane_normal(a, b, c), o, d)


@device
def plane_normal(a, b, c):
    """Normals of the triangles' planes, not of unit length.

    Parameters
    ----------
    a, b, c : tuple of three float32 vectors or numbers
        Corners, along any three axes in cyclic order: along the same axes, the numbers are the same
        in each of the three orders.

    Returns
    -------
    tuple of three float64 vectors or numbers
    """
    ax, ay, az = widen(a[0]), widen(a[1]), widen(a[2])
    px, py, pz = widen(b[0]) - ax, widen(b[1]) - ay, widen(b[2]) - az
    qx, qy, qz = widen(c[0]) - ax, widen(c[1]) - ay, widen(c[2]) - az
    return py * qz - pz * qy, pz * qx - px * qz, px * qy - py * qx


@device
def distance_along(a, n, o, d):
    """Distance to planes of known normals: the second half of `plane_distance`.

    Parameters
    ----------
    a, o, d : tuple of three float32 vectors or numbers
        A point of the plane, origin and direction, in the order of the frame.
    n : tuple of three float64 vectors or numbers
        `plane_normal`, in the order of the frame.

    Returns
    -------
    float32 vector or number
    """
    ax, ay, az = widen(a[0]), widen(a[1]), widen(a[2])
    nx, ny, nz = n
    along = (ax - widen(o[0])) * nx + (ay - widen(o[1])) * ny + (az - widen(o[2])) * nz
    return as_float32(along / (widen(d[0]) * nx + widen(d[1]) * ny + widen(d[2]) * nz))


@device
def _top_left_sign(ax, ay, bx, by):
    """Sign of a zero edge function once the ray moves by (e, e*e), e to 0: the top-left rule."""
    return select(ay == by, bx - ax, ay - by)


@device
def barycentrics(sheared, surfaces):
    """Barycentric weights from float64; see step 2 of `kernels.triangle.intersect`.

    Parameters
    ----------
    sheared : ShearedVertices
    surfaces : bool

    Returns
    -------
    hit : mask or bool
    u, v : float32 vector or number
    """
    ax, ay = widen(sheared.ax), widen(sheared.ay)
    bx, by = widen(sheared.bx), widen(sheared.by)
    cx, cy = widen(sheared.cx), widen(sheared.cy)
    U = _edge(cx, cy, bx, by)
    V = _edge(ax, ay, cx, cy)
    W = _edge(bx, by, ax, ay)
    low = minimum(minimum(U, V), W)
    high = maximum(maximum(U, V), W)
    hit = ((low >= ZERO_F64) & (high > ZERO_F64)) | ((high <= ZERO_F64) & (low < ZERO_F64))
    if surfaces:
        sign_u = select(U == ZERO_F64, _top_left_sign(cx, cy, bx, by), U)
        sign_v = select(V == ZERO_F64, _top_left_sign(ax, ay, cx, cy), V)
        sign_w = select(W == ZERO_F64, _top_left_sign(bx, by, ax, ay), W)
        least = minimum(minimum(sign_u, sign_v), sign_w)
        most = maximum(maximum(sign_u, sign_v), sign_w)
        hit = hit & ((least > ZERO_F64) | (most < ZERO_F64))
    scale = np.float64(1.0) / (U + V + W)
    return hit, as_float32(V * scale) + ZERO_F32, as_float32(W * scale) + ZERO_F32


@device
def intersect_lanes(sheared, signs, box, limits, plane, surfaces, then):
    """Intersect triangles with rays whose edge functions agree in sign.

    Parameters
    ----------
    sheared : ShearedVertices
    signs : mask
        See `signs_agree`.
    box : tuple of two float32 vectors
        Where the rays enter and leave the triangles' padded boxes.
    limits : tuple of two float32 vectors or numbers
        Closed intervals in which hits are wanted.
    plane : tuple
        The tuple of a device function's arguments, and the function: the distance to the
        triangles' planes. (Numba warns of a tuple that begins with a function.)
    surfaces : bool
    then : tuple
        Likewise: ``function(hit, t, u, v, *arguments)`` takes the hits of the lanes of a mask, if
        there may be any; returns a uint64.

    Returns
    -------
    uint64
        What `then` returns; 0 without a hit.
    """
    (t_in, t_out), (t_min, t_far) = box, limits
    (of_plane, distance), (others, take) = plane, then
    hit = signs & (t_in <= t_out) & (t_in <= t_far) & (t_out >= t_min)
    if not any_lane(hit):
        return ZERO_U64
    # The distance before the barycentrics, which a ray that leaves a surface does not need: it
    # meets the surface's triangle behind its origin. (Single bounce, ambient occlusion and shadow
    # rays on the bunny and conference, one thread of a Zen 5: 1.03 to 1.05 times as fast; primary
    # rays: the same.)
    t = minimum(maximum(distance(*of_plane), t_in), t_out) + ZERO_F32
    hit = hit & (t >= t_min) & (t <= t_far)
    if not any_lane(hit):
        return ZERO_U64
    inside, u, v = barycentrics(sheared, surfaces)
    return take(hit & inside, t, u, v, *others)
